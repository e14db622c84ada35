/* Times a native FMU from C, for native_speed.py.

   native_speed FMU_LIBRARY GUID BARE_LIBRARY COMMANDS ROUNDS [REFERENCE=VALUE ...]

   COMMANDS is a text file, a line a step of 1 ms: v_cmd a_cmd fx. Each step is run in every round,
   and its time is the least one of the rounds: what the computer itself did in between is left
   out. Printed, in us and numbers: median and largest of these; the largest time of any round; the
   most iterations and internal steps of a step; then, in ns a step of a whole run, each second of
   it by its least time: FMU with 3 inputs set and 7 outputs read; bare model, steps alone; bare
   model, steps and outputs. */

#include <dlfcn.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmi2Functions.h"
#include "interface.h"
#include "crane.h"

enum { LOOKED_AT = 7, PART = 1000, PARTS = 200 };

static const double H = 1e-3;
static const fmi2ValueReference COMMANDED[INPUTS] = {VR_TROLLEY_V_CMD, VR_TROLLEY_A_CMD,
                                                     VR_PAYLOAD_FX};
static const fmi2ValueReference SEEN[LOOKED_AT] = {
    VR_TROLLEY_X,     VR_TROLLEY_V,       VR_PAYLOAD_X,        VR_PAYLOAD_Y,
    VR_PAYLOAD_X_REL, VR_CHAIN_MID_X_REL, VR_CHAIN_TENSION_TOP};
static const fmi2ValueReference EFFORT[2] = {VR_SOLVER_STEPS, VR_SOLVER_ITERATIONS};

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void fail(const char *what) {
    fprintf(stderr, "native_speed: %s\n", what);
    exit(1);
}

static void *symbol(void *library, const char *name) {
    void *found = dlsym(library, name);
    if (!found) fail(name);
    return found;
}

static void silent(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    (void)environment, (void)name, (void)status;
    fprintf(stderr, "%s: %s\n", category, message);
}

typedef struct {
    fmi2InstantiateTYPE *instantiate;
    fmi2SetRealTYPE *set_real;
    fmi2SetIntegerTYPE *set_integer;
    fmi2GetRealTYPE *get_real;
    fmi2GetIntegerTYPE *get_integer;
    fmi2DoStepTYPE *do_step;
    fmi2ResetTYPE *reset;
    fmi2EnterInitializationModeTYPE *enter;
    fmi2ExitInitializationModeTYPE *leave;
} Fmu;

static void begin(const Fmu *fmu, fmi2Component c, int count, char **starts) {
    fmu->reset(c);
    for (int i = 0; i < count; i++) {
        fmi2ValueReference reference = (fmi2ValueReference)atoi(starts[i]);
        double value = atof(strchr(starts[i], '=') + 1);
        int whole = (int)value;
        if (VARIABLE[reference].kind == INTEGER) fmu->set_integer(c, &reference, 1, &whole);
        else fmu->set_real(c, &reference, 1, &value);
    }
    fmu->enter(c);
    if (fmu->leave(c) != fmi2OK) fail("start values");
}

static void fmu_step(const Fmu *fmu, fmi2Component c, int i, const double *commands) {
    double seen[LOOKED_AT];
    fmu->set_real(c, COMMANDED, INPUTS, commands);
    if (fmu->do_step(c, i * H, H, fmi2True) != fmi2OK) fail("doStep");
    fmu->get_real(c, SEEN, LOOKED_AT, seen);
}

/* The parameters as the FMU has them; of a String its first choice. */
static Settings chosen(const Fmu *fmu, fmi2Component c) {
    Settings settings = {0.0};
    double *member = (double *)&settings;
    for (fmi2ValueReference i = INPUTS; i < SETTABLE; i++) {
        int whole;
        if (VARIABLE[i].kind == REAL) fmu->get_real(c, &i, 1, &member[i - INPUTS]);
        if (VARIABLE[i].kind != INTEGER) continue;
        fmu->get_integer(c, &i, 1, &whole);
        member[i - INPUTS] = whole;
    }
    return settings;
}

/* The least time of each part of a run, s. */
typedef struct {
    double least[PARTS], started;
} Parts;

/* A part ends before step i, or at the end of the run. */
static void end_part(Parts *parts, int i) {
    double at = now();
    int part = (i - 1) / PART;
    if (i > 0) parts->least[part] = fmin(parts->least[part], at - parts->started);
    parts->started = now();
}

static double nanoseconds_a_step(const Parts *parts, int steps) {
    double sum = 0.0;
    for (int part = 0; part * PART < steps; part++) sum += parts->least[part];
    return 1e9 * sum / steps;
}

static void fmu_run(const Fmu *fmu, fmi2Component c, double (*commands)[INPUTS], int steps,
                    Parts *parts) {
    for (int i = 0; i < steps; i++) {
        if (i % PART == 0) end_part(parts, i);
        fmu_step(fmu, c, i, commands[i]);
    }
    end_part(parts, steps);
}

static void bare_run(const CraneModel *crane, void *memory, const Settings *settings,
                     double (*commands)[INPUTS], int steps, int with_outputs, Parts *parts) {
    Outputs outputs;
    Failure failure;
    crane->create(memory, settings);
    for (int i = 0; i < steps; i++) {
        const Command *command = (const Command *)commands[i];
        if (i % PART == 0) end_part(parts, i);
        if (crane->step(memory, H, command, &failure) != DONE) fail("bare step");
        if (with_outputs) crane->outputs(memory, &outputs);
    }
    end_part(parts, steps);
}

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

int main(int count, char **arguments) {
    if (count < 6) fail("arguments are missing");
    void *library = dlopen(arguments[1], RTLD_NOW), *bare = dlopen(arguments[3], RTLD_NOW);
    FILE *file = fopen(arguments[4], "r");
    if (!library || !bare || !file) fail("a file cannot be read");
    Fmu fmu = {(fmi2InstantiateTYPE *)symbol(library, "fmi2Instantiate"),
               (fmi2SetRealTYPE *)symbol(library, "fmi2SetReal"),
               (fmi2SetIntegerTYPE *)symbol(library, "fmi2SetInteger"),
               (fmi2GetRealTYPE *)symbol(library, "fmi2GetReal"),
               (fmi2GetIntegerTYPE *)symbol(library, "fmi2GetInteger"),
               (fmi2DoStepTYPE *)symbol(library, "fmi2DoStep"),
               (fmi2ResetTYPE *)symbol(library, "fmi2Reset"),
               (fmi2EnterInitializationModeTYPE *)symbol(library, "fmi2EnterInitializationMode"),
               (fmi2ExitInitializationModeTYPE *)symbol(library, "fmi2ExitInitializationMode")};
    const CraneModel *crane = symbol(bare, "CRANE");
    int steps = 0, room = PART * PARTS, rounds = atoi(arguments[5]), starts = count - 6;
    double (*commands)[INPUTS] = malloc((size_t)room * sizeof *commands);
    double *least = malloc((size_t)room * sizeof *least);
    if (!commands || !least) fail("no memory");
    while (steps < room && fscanf(file, "%lf %lf %lf", &commands[steps][0], &commands[steps][1],
                                  &commands[steps][2]) == 3)
        least[steps++] = INFINITY;
    fmi2CallbackFunctions functions = {silent, NULL, NULL, NULL, NULL};
    fmi2Component c = fmu.instantiate("crane", fmi2CoSimulation, arguments[2], "", &functions,
                                      fmi2False, fmi2False);
    if (!c) fail("the guid");

    double largest = 0.0;
    static Parts whole, alone, seen;
    for (int part = 0; part < PARTS; part++)
        whole.least[part] = alone.least[part] = seen.least[part] = INFINITY;
    double most_steps = 0.0, most_iterations = 0.0;
    for (int round = 0; round < rounds; round++) {
        begin(&fmu, c, starts, arguments + 6);
        for (int i = 0; i < steps; i++) { /* each step by itself */
            double effort[2];
            double started = now();
            fmu_step(&fmu, c, i, commands[i]);
            double took = now() - started;
            if (took < least[i]) least[i] = took;
            if (took > largest) largest = took;
            fmu.get_real(c, EFFORT, 2, effort);
            if (effort[0] > most_steps) most_steps = effort[0];
            if (effort[1] > most_iterations) most_iterations = effort[1];
        }
        begin(&fmu, c, starts, arguments + 6);
        Settings settings = chosen(&fmu, c);
        void *memory = malloc(crane->memory(&settings));
        if (!memory) fail("no memory");
        fmu_run(&fmu, c, commands, steps, &whole);
        bare_run(crane, memory, &settings, commands, steps, 0, &alone);
        bare_run(crane, memory, &settings, commands, steps, 1, &seen);
        free(memory);
    }
    qsort(least, (size_t)steps, sizeof *least, ascending);
    printf("%g %g %g %g %g %g %g %g\n", 1e6 * least[steps / 2], 1e6 * least[steps - 1],
           1e6 * largest, most_iterations, most_steps, nanoseconds_a_step(&whole, steps),
           nanoseconds_a_step(&alone, steps), nanoseconds_a_step(&seen, steps));
    return 0;
}
