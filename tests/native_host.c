/* A host of native FMUs with no Python in its process, for test_08_native.py.

   native_host TASK NL_LIBRARY NL_GUID LIN_LIBRARY LIN_GUID [ARGUMENT]

   run FILE   the paper's scenario with each FMU; payload.x_rel, payload.x, chain.mid_x_rel as CSV
   threads    8 instances of each FMU in 8 threads, against the same runs one after the other
   cycles N   load, instantiate, step, free, unload, N times
   save FILE  run for 1.3 s, save the states as bytes, run on and save what is seen
   load FILE  restore those states, on another platform, say, and see the same
   calls      state, log, status, input derivatives, errors, wrong arguments

   interface.h is the one in either FMU's sources folder: the two have the same interface. */

#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32) /* what is needed of windows.h, whose names are not ours to mix with */
__declspec(dllimport) void *__stdcall LoadLibraryA(const char *path);
__declspec(dllimport) void *__stdcall GetProcAddress(void *library, const char *name);
__declspec(dllimport) int __stdcall FreeLibrary(void *library);
__declspec(dllimport) void *__stdcall CreateThread(void *security, size_t stack,
                                                   unsigned long(__stdcall *start)(void *),
                                                   void *argument, unsigned long flags,
                                                   unsigned long *id);
__declspec(dllimport) unsigned long __stdcall WaitForSingleObject(void *thread, unsigned long ms);
#else
#include <dlfcn.h>
#include <pthread.h>
#endif

#include "check.h"
#include "fmi2Functions.h"
#include "interface.h"
#include "twins.h"

enum { THREADS = 8, MODELS = 2, STEPS = 800, SEEN = 3, LOG_SIZE = 1024 };

static const double H = 0.005, SPEED = 0.8, STOP_AT = 1.0;
static const fmi2ValueReference LOOK_AT[SEEN] = {VR_PAYLOAD_X_REL, VR_PAYLOAD_X,
                                                 VR_CHAIN_MID_X_REL};

/* ---- an FMU ---- */

#define FUNCTIONS(X)                                                                     \
    X(GetVersion) X(GetTypesPlatform) X(Instantiate) X(FreeInstance) X(SetDebugLogging)  \
    X(SetupExperiment) X(EnterInitializationMode) X(ExitInitializationMode)              \
    X(Terminate) X(Reset) X(GetReal) X(SetReal) X(GetInteger) X(SetInteger)              \
    X(GetBoolean) X(SetBoolean) X(GetString) X(SetString) X(DoStep) X(CancelStep)        \
    X(GetStatus) X(GetRealStatus) X(GetIntegerStatus) X(GetBooleanStatus)                \
    X(GetStringStatus) X(GetFMUstate) X(SetFMUstate) X(FreeFMUstate)                     \
    X(SerializedFMUstateSize) X(SerializeFMUstate) X(DeSerializeFMUstate)                \
    X(SetRealInputDerivatives) X(GetRealOutputDerivatives) X(GetDirectionalDerivative)

typedef struct {
    void *library;
    const char *guid;
#define MEMBER(name) fmi2##name##TYPE *name;
    FUNCTIONS(MEMBER)
} Fmu;

#if defined(_WIN32)
static void *open_library(const char *path) { return LoadLibraryA(path); }
static void *find(void *library, const char *name) { return GetProcAddress(library, name); }
static void unload(Fmu *fmu) { FreeLibrary(fmu->library); }
#else
static void *open_library(const char *path) { return dlopen(path, RTLD_NOW | RTLD_LOCAL); }
static void *find(void *library, const char *name) { return dlsym(library, name); }
static void unload(Fmu *fmu) { dlclose(fmu->library); }
#endif

static Fmu load(const char *path, const char *guid) {
    Fmu fmu;
    fmu.library = open_library(path);
    fmu.guid = guid;
    CHECK(fmu.library);
#define FIND(name)                                                                       \
    {                                                                                    \
        void *found = find(fmu.library, "fmi2" #name);                                   \
        CHECK(found);                                                                    \
        memcpy(&fmu.name, &found, sizeof found);                                         \
    }
    FUNCTIONS(FIND)
    return fmu;
}

/* The last message of an instance, as "status category: text"; the environment points here. */
typedef struct {
    int count;
    char text[LOG_SIZE];
} Log;

static void keep(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                 fmi2String category, fmi2String message, ...) {
    Log *log = environment;
    CHECK(name && category && message);
    int used = snprintf(log->text, sizeof log->text, "%d %s: ", (int)status, category);
    va_list arguments;
    va_start(arguments, message);
    vsnprintf(log->text + used, sizeof log->text - (size_t)used, message, arguments);
    va_end(arguments);
    log->count++;
}

static fmi2Component instantiate(const Fmu *fmu, Log *log) {
    fmi2CallbackFunctions functions = {keep, NULL, NULL, NULL, log};
    fmi2Component c = fmu->Instantiate("crane", fmi2CoSimulation, fmu->guid, "file:///no%20where",
                                       &functions, fmi2False, fmi2True);
    CHECK(c);
    return c;
}

static void initialise(const Fmu *fmu, fmi2Component c, double payload) {
    const fmi2ValueReference mass = VR_PAYLOAD_MASS;
    CHECK(fmu->SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0) == fmi2OK);
    CHECK(fmu->SetReal(c, &mass, 1, &payload) == fmi2OK);
    CHECK(fmu->EnterInitializationMode(c) == fmi2OK);
    CHECK(fmu->ExitInitializationMode(c) == fmi2OK);
}

static double get(const Fmu *fmu, fmi2Component c, fmi2ValueReference reference) {
    double value = NAN;
    CHECK(fmu->GetReal(c, &reference, 1, &value) == fmi2OK);
    return value;
}

static void set(const Fmu *fmu, fmi2Component c, fmi2ValueReference reference, double value) {
    CHECK(fmu->SetReal(c, &reference, 1, &value) == fmi2OK);
}

/* Steps from step `first` to step `last` of the paper's motion; rows of what is looked at. */
static void paper_steps(const Fmu *fmu, fmi2Component c, int first, int last,
                        double (*rows)[SEEN]) {
    for (int i = first; i < last; i++) {
        set(fmu, c, VR_TROLLEY_V_CMD, i * H < STOP_AT - 1e-9 ? SPEED : 0.0);
        CHECK(fmu->DoStep(c, i * H, H, fmi2True) == fmi2OK);
        CHECK(fmu->GetReal(c, LOOK_AT, SEEN, rows[i]) == fmi2OK);
    }
}

static void paper_run(const Fmu *fmu, double payload, double (*rows)[SEEN]) {
    Log log = {0, ""};
    fmi2Component c = instantiate(fmu, &log);
    initialise(fmu, c, payload);
    paper_steps(fmu, c, 0, STEPS, rows);
    CHECK(fmu->Terminate(c) == fmi2OK);
    fmu->FreeInstance(c);
    CHECK(log.count == 0);
}

/* ---- tasks ---- */

static void run(const Fmu *fmus, const char *path) {
    static double rows[MODELS][STEPS][SEEN];
    FILE *file = fopen(path, "w");
    CHECK(file);
    for (int m = 0; m < MODELS; m++) paper_run(&fmus[m], 0.42, rows[m]);
    for (int i = 0; i < STEPS; i++) {
        fprintf(file, "%.17g", (i + 1) * H);
        for (int m = 0; m < MODELS; m++)
            for (int k = 0; k < SEEN; k++) fprintf(file, ",%.17g", rows[m][i][k]);
        fprintf(file, "\n");
    }
    CHECK(fclose(file) == 0);
}

typedef struct {
    const Fmu *fmu;
    double payload, alone[STEPS][SEEN], together[STEPS][SEEN];
} Work;

#if defined(_WIN32)
static unsigned long __stdcall work(void *argument) {
    Work *w = argument;
    paper_run(w->fmu, w->payload, w->together);
    return 0;
}

static void in_threads(Work *all) {
    void *threads[THREADS];
    for (int i = 0; i < THREADS; i++) {
        threads[i] = CreateThread(NULL, 0, work, &all[i], 0, NULL);
        CHECK(threads[i]);
    }
    for (int i = 0; i < THREADS; i++) CHECK(WaitForSingleObject(threads[i], ~0ul) == 0);
}
#else
static void *work(void *argument) {
    Work *w = argument;
    paper_run(w->fmu, w->payload, w->together);
    return NULL;
}

static void in_threads(Work *all) {
    pthread_t threads[THREADS];
    for (int i = 0; i < THREADS; i++) CHECK(pthread_create(&threads[i], NULL, work, &all[i]) == 0);
    for (int i = 0; i < THREADS; i++) CHECK(pthread_join(threads[i], NULL) == 0);
}
#endif

static void threads(const Fmu *fmus) {
    static Work all[THREADS];
    for (int m = 0; m < MODELS; m++) {
        for (int i = 0; i < THREADS; i++) {
            all[i].fmu = &fmus[m];
            all[i].payload = 0.07 + 0.05 * i;
            paper_run(all[i].fmu, all[i].payload, all[i].alone);
        }
        in_threads(all);
        for (int i = 0; i < THREADS; i++)
            CHECK(memcmp(all[i].alone, all[i].together, sizeof all[i].alone) == 0);
    }
}

static void cycles(char **arguments, int count) {
    static double rows[STEPS][SEEN];
    for (int i = 0; i < count; i++)
        for (int m = 0; m < MODELS; m++) {
            Log log = {0, ""};
            Fmu fmu = load(arguments[2 * m], arguments[2 * m + 1]);
            fmi2Component c = instantiate(&fmu, &log);
            initialise(&fmu, c, 0.42);
            paper_steps(&fmu, c, 0, 2, rows);
            fmu.FreeInstance(c);
            unload(&fmu);
        }
}

enum { SAVED_AT = 260, RUN_TO = 360, ROOM = 1 << 16 };

static FILE *open_part(const char *path, int model, const char *part, const char *mode) {
    char name[1000];
    snprintf(name, sizeof name, "%s.%d.%s", path, model, part);
    FILE *file = fopen(name, mode);
    CHECK(file);
    return file;
}

static size_t serialise(const Fmu *fmu, fmi2Component c, fmi2Byte *bytes) {
    fmi2FMUstate state = NULL;
    size_t size;
    CHECK(fmu->GetFMUstate(c, &state) == fmi2OK);
    CHECK(fmu->SerializedFMUstateSize(c, state, &size) == fmi2OK && size <= ROOM);
    CHECK(fmu->SerializeFMUstate(c, state, bytes, size) == fmi2OK);
    CHECK(fmu->FreeFMUstate(c, &state) == fmi2OK);
    return size;
}

static void save(const Fmu *fmus, const char *path) {
    static double rows[STEPS][SEEN];
    static fmi2Byte bytes[ROOM];
    for (int m = 0; m < MODELS; m++) {
        Log log = {0, ""};
        fmi2Component c = instantiate(&fmus[m], &log);
        initialise(&fmus[m], c, 0.42);
        paper_steps(&fmus[m], c, 0, SAVED_AT, rows);
        size_t size = serialise(&fmus[m], c, bytes);
        FILE *file = open_part(path, m, "state", "wb");
        CHECK(fwrite(bytes, 1, size, file) == size && fclose(file) == 0);
        paper_steps(&fmus[m], c, SAVED_AT, RUN_TO, rows);
        file = open_part(path, m, "rows", "w");
        for (int i = SAVED_AT; i < RUN_TO; i++)
            for (int k = 0; k < SEEN; k++) fprintf(file, "%.17g\n", rows[i][k]);
        CHECK(fclose(file) == 0);
        fmus[m].FreeInstance(c);
    }
}

static void resume(const Fmu *fmus, const char *path) {
    static double rows[STEPS][SEEN];
    static fmi2Byte bytes[ROOM], again[ROOM];
    for (int m = 0; m < MODELS; m++) {
        Log log = {0, ""};
        fmi2Component c = instantiate(&fmus[m], &log);
        fmi2FMUstate state = NULL;
        FILE *file = open_part(path, m, "state", "rb");
        size_t size = fread(bytes, 1, ROOM, file);
        CHECK(fclose(file) == 0);
        CHECK(fmus[m].DeSerializeFMUstate(c, bytes, size, &state) == fmi2OK);
        CHECK(fmus[m].SetFMUstate(c, state) == fmi2OK);
        CHECK(fmus[m].FreeFMUstate(c, &state) == fmi2OK);
        CHECK(serialise(&fmus[m], c, again) == size && memcmp(bytes, again, size) == 0);
        paper_steps(&fmus[m], c, SAVED_AT, RUN_TO, rows);
        file = open_part(path, m, "rows", "r");
        for (int i = SAVED_AT; i < RUN_TO; i++)
            for (int k = 0; k < SEEN; k++) {
                double there;
                CHECK(fscanf(file, "%lf", &there) == 1 && fabs(there - rows[i][k]) < 1e-9);
            }
        CHECK(fclose(file) == 0);
        fmus[m].FreeInstance(c);
    }
}

/* Save, run on, restore, run on: the same bits; through bytes and in another instance, too. */
static void states(const Fmu *fmu) {
    static double rows[STEPS][SEEN], again[STEPS][SEEN];
    Log log = {0, ""};
    fmi2Component c = instantiate(fmu, &log), other = instantiate(fmu, &log);
    fmi2FMUstate state = NULL, copy = NULL;
    fmi2ValueReference elements = VR_CHAIN_ELEMENTS;
    fmi2Integer n = 3;
    size_t size = 0;
    initialise(fmu, c, 0.42);
    paper_steps(fmu, c, 0, 30, rows);
    CHECK(fmu->GetFMUstate(c, &state) == fmi2OK);
    CHECK(fmu->GetFMUstate(c, &state) == fmi2OK); /* into the same one */
    paper_steps(fmu, c, 30, 60, rows);
    CHECK(fmu->SetFMUstate(c, state) == fmi2OK);
    paper_steps(fmu, c, 30, 60, again);
    CHECK(memcmp(rows[30], again[30], 30 * sizeof rows[0]) == 0);

    CHECK(fmu->SerializedFMUstateSize(c, state, &size) == fmi2OK);
    fmi2Byte *bytes = malloc(size);
    CHECK(bytes);
    CHECK(fmu->SerializeFMUstate(c, state, bytes, size) == fmi2OK);
    CHECK(fmu->SerializeFMUstate(c, state, bytes, size - 1) == fmi2Error);
    CHECK(fmu->SetInteger(other, &elements, 1, &n) == fmi2OK);
    initialise(fmu, other, 0.07);
    CHECK(fmu->DeSerializeFMUstate(other, bytes, size, &copy) == fmi2OK);
    CHECK(fmu->SetFMUstate(other, copy) == fmi2OK);
    memset(again, 0, sizeof again);
    paper_steps(fmu, other, 30, 60, again);
    CHECK(memcmp(rows[30], again[30], 30 * sizeof rows[0]) == 0);
    CHECK(fmu->GetInteger(other, &elements, 1, &n) == fmi2OK && n == 10);

    for (size_t at = 0; at < size; at++) { /* each byte counts */
        bytes[at] ^= 1;
        CHECK(fmu->DeSerializeFMUstate(other, bytes, size, &copy) == fmi2Error);
        CHECK(strstr(log.text, "damaged"));
        bytes[at] ^= 1;
    }
    for (size_t less = 0; less < size; less++)
        CHECK(fmu->DeSerializeFMUstate(other, bytes, less, &copy) == fmi2Error);
    paper_steps(fmu, other, 60, 61, again);
    free(bytes);
    CHECK(fmu->FreeFMUstate(other, &copy) == fmi2OK && copy == NULL);
    CHECK(fmu->FreeFMUstate(c, &copy) == fmi2OK);
    CHECK(fmu->FreeFMUstate(c, &state) == fmi2OK);
    fmu->FreeInstance(other);
    fmu->FreeInstance(c);
}

/* A velocity ramp by v_cmd's derivative is the one by a_cmd, whatever the step. */
static void ramp(const Fmu *fmu) {
    const fmi2ValueReference v_cmd = VR_TROLLEY_V_CMD, fx = VR_PAYLOAD_FX;
    const fmi2Integer first = 1, second = 2;
    const double slope = -0.8, none = 0.0;
    Log log = {0, ""};
    fmi2Component c = instantiate(fmu, &log), truth = instantiate(fmu, &log);
    double t = 0.0;
    initialise(fmu, c, 0.42);
    initialise(fmu, truth, 0.42);
    set(fmu, truth, VR_TROLLEY_V_CMD, SPEED);
    set(fmu, truth, VR_TROLLEY_A_CMD, slope);
    for (int i = 0; i < 100; i++) {
        double h = i % 2 ? 0.003 : 0.017;
        set(fmu, c, VR_TROLLEY_V_CMD, SPEED + t * slope);
        CHECK(fmu->SetRealInputDerivatives(c, &v_cmd, 1, &first, &slope) == fmi2OK);
        CHECK(fmu->DoStep(c, t, h, fmi2True) == fmi2OK);
        CHECK(fmu->DoStep(truth, t, h, fmi2True) == fmi2OK);
        t += h;
        for (fmi2ValueReference out = SETTABLE; out < VR_SOLVER_STEPS; out++) {
            if (VARIABLE[out].kind != REAL) continue;
            int force =
                out == VR_TROLLEY_FX || out == VR_CHAIN_TENSION_TOP || out == VR_CHAIN_TENSION_MIN;
            CHECK(fabs(get(fmu, c, out) - get(fmu, truth, out)) < (force ? 1e-5 : 1e-9));
        }
    }
    CHECK(fabs(get(fmu, c, VR_TROLLEY_V)) < 1e-12);
    CHECK(fabs(get(fmu, c, VR_TROLLEY_X) - 0.4) < 1e-12);
    CHECK(fmu->SetRealInputDerivatives(c, &v_cmd, 1, &first, &none) == fmi2OK);

    CHECK(fmu->SetRealInputDerivatives(c, &v_cmd, 1, &second, &slope) == fmi2Error);
    CHECK(fmu->SetRealInputDerivatives(c, LOOK_AT, 1, &first, &slope) == fmi2Error);
    CHECK(fmu->GetRealOutputDerivatives(c, LOOK_AT, 1, &first, &t) == fmi2Error);

    /* a force that grows from 0 to 1 N in 0.1 s gives its impulse, in one step or in ten */
    set(fmu, c, VR_TROLLEY_V_CMD, 0.0);
    fmi2FMUstate state = NULL;
    CHECK(fmu->GetFMUstate(c, &state) == fmi2OK);
    double slope_fx = 10.0, one, ten;
    CHECK(fmu->SetRealInputDerivatives(c, &fx, 1, &first, &slope_fx) == fmi2OK);
    CHECK(fmu->DoStep(c, t, 0.1, fmi2True) == fmi2OK);
    one = get(fmu, c, VR_PAYLOAD_X);
    CHECK(fmu->SetFMUstate(c, state) == fmi2OK);
    for (int i = 0; i < 10; i++) {
        set(fmu, c, VR_PAYLOAD_FX, 0.1 * i);
        CHECK(fmu->SetRealInputDerivatives(c, &fx, 1, &first, &slope_fx) == fmi2OK);
        CHECK(fmu->DoStep(c, t + 0.01 * i, 0.01, fmi2True) == fmi2OK);
    }
    ten = get(fmu, c, VR_PAYLOAD_X);
    CHECK(fabs(one - ten) < 1e-9);

    /* and a jump's impulse is told, though such a step is done in parts */
    set(fmu, c, VR_TROLLEY_V_CMD, 0.1);
    CHECK(fmu->DoStep(c, t + 0.1, 0.01, fmi2True) == fmi2OK);
    CHECK(get(fmu, c, VR_TROLLEY_IMPULSE) > 0.0);
    CHECK(fmu->FreeFMUstate(c, &state) == fmi2OK);
    fmu->FreeInstance(truth);
    fmu->FreeInstance(c);
}

static void logs_and_status(const Fmu *fmu) {
    const fmi2String discard = "logStatusDiscard", strange = "logStrange";
    const fmi2ValueReference mass = VR_PAYLOAD_MASS, output = VR_PAYLOAD_X, none = 4711;
    const fmi2ValueReference scheme = VR_SOLVER_SCHEME;
    Log log = {0, ""};
    double value = 1.0, time = -1.0;
    fmi2Status status = fmi2Pending;
    fmi2Boolean terminated = fmi2True;
    fmi2Integer whole;
    fmi2String text;
    fmi2CallbackFunctions functions = {keep, NULL, NULL, NULL, &log};
    CHECK(!fmu->Instantiate("crane", fmi2CoSimulation, "{no guid}", "", &functions, 0, 0));
    CHECK(strstr(log.text, "3 logStatusError: the guid"));
    CHECK(!fmu->Instantiate("crane", fmi2ModelExchange, fmu->guid, "", &functions, 0, 0));
    CHECK(!fmu->Instantiate(NULL, fmi2CoSimulation, fmu->guid, "", &functions, 0, 0));
    CHECK(!fmu->Instantiate("crane", fmi2CoSimulation, fmu->guid, "", NULL, 0, 0));
    CHECK(strcmp(fmu->GetVersion(), "2.0") == 0);
    CHECK(strcmp(fmu->GetTypesPlatform(), "default") == 0);

    fmi2Component c = instantiate(fmu, &log);
    CHECK(fmu->DoStep(c, 0.0, H, fmi2True) == fmi2Error);
    CHECK(strcmp(log.text, "3 logStatusError: a step needs an initialised instance;"
                           " this one is instantiated") == 0);
    initialise(fmu, c, 0.42);
    CHECK(fmu->EnterInitializationMode(c) == fmi2Error);
    CHECK(fmu->DoStep(c, 0.0, H, fmi2True) == fmi2OK);
    CHECK(fmu->SetReal(c, &mass, 1, &value) == fmi2Error);
    CHECK(strcmp(log.text, "3 logStatusError: payload.mass is a parameter: it is fixed when"
                           " initialisation ends, and cannot be set to 1.0 now") == 0);
    CHECK(fmu->SetReal(c, &output, 1, &value) == fmi2Error);
    CHECK(fmu->SetReal(c, &none, 1, &value) == fmi2Error);
    CHECK(fmu->GetReal(c, &none, 1, &value) == fmi2Error);
    CHECK(strcmp(log.text, "3 logStatusError: no Real variable has the value reference 4711") == 0);
    CHECK(fmu->GetInteger(c, &mass, 1, &whole) == fmi2Error);
    CHECK(fmu->GetBoolean(c, &mass, 1, &terminated) == fmi2Error);
    CHECK(fmu->GetString(c, &scheme, 1, &text) == fmi2OK && strcmp(text, "energy_momentum") == 0);

    CHECK(fmu->DoStep(c, 0.5, H, fmi2True) == fmi2Discard);
    CHECK(strcmp(log.text, "2 logStatusDiscard: current communication point = 0.5 is not allowed:"
                           " the time reached, 0.005 s") == 0);
    CHECK(fmu->GetStatus(c, fmi2DoStepStatus, &status) == fmi2OK && status == fmi2Discard);
    CHECK(fmu->GetRealStatus(c, fmi2LastSuccessfulTime, &time) == fmi2OK && time == H);
    CHECK(fmu->GetBooleanStatus(c, fmi2Terminated, &terminated) == fmi2OK && !terminated);
    CHECK(fmu->GetStringStatus(c, fmi2PendingStatus, &text) == fmi2Discard);
    CHECK(fmu->GetIntegerStatus(c, fmi2DoStepStatus, &whole) == fmi2Discard);
    CHECK(fmu->GetRealStatus(c, fmi2Terminated, &time) == fmi2Discard);
    CHECK(fmu->CancelStep(c) == fmi2Error);
    CHECK(fmu->GetDirectionalDerivative(c, &output, 1, &mass, 1, &value, &value) == fmi2Error);

    int before = log.count;
    CHECK(fmu->SetDebugLogging(c, fmi2True, 1, &discard) == fmi2OK);
    CHECK(fmu->CancelStep(c) == fmi2Error && log.count == before);
    CHECK(fmu->DoStep(c, 0.5, H, fmi2True) == fmi2Discard && log.count == before + 1);
    CHECK(fmu->SetDebugLogging(c, fmi2False, 0, NULL) == fmi2OK);
    CHECK(fmu->DoStep(c, 0.5, H, fmi2True) == fmi2Discard && log.count == before + 1);
    CHECK(fmu->SetDebugLogging(c, fmi2True, 0, NULL) == fmi2OK);
    CHECK(fmu->SetDebugLogging(c, fmi2True, 1, &strange) == fmi2Error);
    CHECK(log.count == before + 2);

    CHECK(fmu->DoStep(c, H, H, fmi2True) == fmi2OK);
    CHECK(fmu->GetStatus(c, fmi2DoStepStatus, &status) == fmi2OK && status == fmi2OK);
    CHECK(fmu->Terminate(c) == fmi2OK);
    CHECK(fmu->DoStep(c, 2 * H, H, fmi2True) == fmi2Error);
    CHECK(get(fmu, c, VR_TROLLEY_X) == 0.0);
    CHECK(fmu->Reset(c) == fmi2OK);

    char longest[2000]; /* of a String, and with what a format would take */
    memset(longest, '%', sizeof longest - 1);
    longest[sizeof longest - 1] = '\0';
    text = longest;
    CHECK(fmu->SetString(c, &scheme, 1, &text) == fmi2Error);
    text = "%s%n";
    CHECK(fmu->SetString(c, &scheme, 1, &text) == fmi2OK);
    CHECK(fmu->EnterInitializationMode(c) == fmi2OK);
    CHECK(fmu->GetReal(c, &output, 1, &value) == fmi2Error && value != value);
    CHECK(fmu->ExitInitializationMode(c) == fmi2Error);
    CHECK(strcmp(log.text, "3 logStatusError: solver.scheme = '%s%n' is not allowed: one of"
                           " energy_momentum, newmark") == 0);
    CHECK(fmu->DoStep(c, 0.0, H, fmi2True) == fmi2Error);
    CHECK(fmu->Reset(c) == fmi2OK);
    initialise(fmu, c, 0.42);
    CHECK(fmu->DoStep(c, 0.0, H, fmi2True) == fmi2OK);
    fmu->FreeInstance(c);
}

/* No argument that is NULL, no instance that is NULL, takes the host down. */
static void nothing(const Fmu *fmu) {
    const fmi2ValueReference mass = VR_PAYLOAD_MASS;
    Log log = {0, ""};
    fmi2FMUstate state = NULL;
    fmi2Component c = instantiate(fmu, &log);
    fmu->FreeInstance(NULL);
    CHECK(fmu->DoStep(NULL, 0.0, H, fmi2True) == fmi2Error);
    CHECK(fmu->GetReal(NULL, &mass, 1, NULL) == fmi2Error);
    CHECK(fmu->GetReal(c, &mass, 1, NULL) == fmi2Error);
    CHECK(fmu->SetReal(c, NULL, 1, NULL) == fmi2Error);
    CHECK(fmu->GetReal(c, NULL, 0, NULL) == fmi2OK);
    CHECK(fmu->SetBoolean(c, NULL, 0, NULL) == fmi2OK);
    CHECK(fmu->SetFMUstate(c, NULL) == fmi2Error);
    CHECK(fmu->GetFMUstate(c, NULL) == fmi2Error);
    CHECK(fmu->SerializeFMUstate(c, NULL, NULL, 0) == fmi2Error);
    CHECK(fmu->DeSerializeFMUstate(c, NULL, 0, &state) == fmi2Error);
    CHECK(fmu->SetDebugLogging(c, fmi2True, 1, NULL) == fmi2Error);
    CHECK(fmu->GetFMUstate(c, &state) == fmi2OK); /* before there is a model */
    CHECK(fmu->SetFMUstate(c, state) == fmi2OK);
    CHECK(fmu->FreeFMUstate(c, &state) == fmi2OK);
    fmu->FreeInstance(c);
}

/* A state of the other model is refused, in words. */
static void foreign(const Fmu *fmus) {
    Log log = {0, ""};
    fmi2Component a = instantiate(&fmus[0], &log), b = instantiate(&fmus[1], &log);
    fmi2FMUstate state = NULL, other = NULL;
    size_t size;
    CHECK(fmus[1].GetFMUstate(b, &state) == fmi2OK);
    CHECK(fmus[1].SerializedFMUstateSize(b, state, &size) == fmi2OK);
    fmi2Byte *bytes = malloc(size);
    CHECK(bytes && fmus[1].SerializeFMUstate(b, state, bytes, size) == fmi2OK);
    CHECK(fmus[0].DeSerializeFMUstate(a, bytes, size, &other) == fmi2Error);
    CHECK(strstr(log.text, "the saved state is of crane_lin_native, sources "));
    free(bytes);
    CHECK(fmus[1].FreeFMUstate(b, &state) == fmi2OK);
    fmus[0].FreeInstance(a);
    fmus[1].FreeInstance(b);
}

int main(int count, char **arguments) {
    CHECK(count >= 6);
    const char *task = arguments[1], *more = count > 6 ? arguments[6] : "";
    if (strcmp(task, "cycles") == 0) {
        cycles(arguments + 2, atoi(more));
    } else {
        Fmu fmus[MODELS] = {load(arguments[2], arguments[3]), load(arguments[4], arguments[5])};
        if (strcmp(task, "run") == 0) run(fmus, more);
        if (strcmp(task, "save") == 0) save(fmus, more);
        if (strcmp(task, "load") == 0) resume(fmus, more);
        if (strcmp(task, "threads") == 0) threads(fmus);
        if (strcmp(task, "calls") == 0) {
            for (int m = 0; m < MODELS; m++) {
                states(&fmus[m]);
                ramp(&fmus[m]);
                logs_and_status(&fmus[m]);
                nothing(&fmus[m]);
            }
            foreign(fmus);
        }
        for (int m = 0; m < MODELS; m++) unload(&fmus[m]);
    }
    printf("%s: done\n", task);
    return 0;
}
