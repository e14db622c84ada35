/* FMI 2.0 co-simulation around a crane in C: what fmi_slave.py is around one in Python.

   It says the same words at the same places. What pythonfmu does not let a slave return, it returns:
   fmi2Error for a call that is refused, with nothing changed; fmi2Discard for a step that cannot be
   done, the state as it was; fmi2Error for bad start values where initialisation ends, until a reset.
   Nothing is shared between instances. */

#include "fmi2Functions.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "clock.h"
#include "crane.h"
#include "saved_state.h"
#include "start_values.h"
#include "text.h"

#if defined(FMI2_FUNCTION_PREFIX) /* as the standard has it; some copies of its header do not */
#undef fmi2FullName
#define PASTED(prefix, name) prefix##name
#define PREFIXED(prefix, name) PASTED(prefix, name)
#define fmi2FullName(name) PREFIXED(FMI2_FUNCTION_PREFIX, name)
#endif

/* Of a velocity: what a command on a slope may be off by at the end of a step and still go on from
   there without a jump. */
static const double CONTINUES = 1e-12;

typedef enum { INSTANTIATED, INITIALISING, STEPPING, TERMINATED } Phase;

static const char *const PHASES[] = {"instantiated", "initialising", "stepping", "terminated"};

/* One saved state in this process: its bytes, as they are serialised. */
typedef struct {
    size_t size, room;
    unsigned char *bytes;
} SavedState;

typedef struct {
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    char *name;
    unsigned logged; /* a bit for each of LOG_CATEGORY */
    Phase phase;
    double time; /* s, reached */
    double stop; /* s, beyond which no step may go */
    Values values;
    void *memory; /* the model's, or NULL: there is none */
    double *kept; /* room for a state of the model: before a step, or to be restored */
    int observed, noticed;
    Outputs seen;
    fmi2Status last_step;
} Instance;

/* ---- log ---- */

static fmi2Status say(const Instance *c, fmi2Status status, int category, const char *message) {
    char format[2 * MESSAGE_SIZE], *end = format; /* the logger takes a format: % is %% */
    if (!c->logger || !(c->logged & 1u << category)) return status;
    for (const char *at = message; *at && end < format + sizeof format - 2; at++) {
        if (*at == '%') *end++ = '%';
        *end++ = *at;
    }
    *end = '\0';
    c->logger(c->environment, c->name, status, LOG_CATEGORY[category], format);
    return status;
}

/* The call is refused, and nothing changed. */
static fmi2Status refuse(const Instance *c, const char *message) {
    return say(c, fmi2Error, LOG_STATUS_ERROR, message);
}

/* ---- the model ---- */

/* The first output that is not a finite number, in words; 0: all are. */
static int bad_output(const Outputs *outputs, const char *allowed, char message[MESSAGE_SIZE]) {
    if (are_finite(outputs)) return 0;
    const double *value = (const double *)outputs;
    int i = 0;
    while (is_finite(value[i])) i++;
    bad_number(message, VARIABLE[SETTABLE + i].name, value[i], allowed);
    return 1;
}

static void drop_model(Instance *c) {
    free(c->memory);
    free(c->kept);
    c->memory = NULL;
    c->kept = NULL;
    c->observed = 0;
}

/* Make the model from the parameters; 0, and no model, with a message, where that cannot be. */
static int build(Instance *c, char message[MESSAGE_SIZE]) {
    drop_model(c);
    if (bad_parameter(&c->values, message)) return 0;
    Settings chosen = settings_of(&c->values);
    c->memory = malloc(CRANE.memory(&chosen));
    c->kept = malloc(CRANE.state_count(&chosen) * sizeof(double));
    if (!c->memory || !c->kept) {
        drop_model(c);
        snprintf(message, MESSAGE_SIZE, "no memory for chain.elements = %.0f",
                 chosen.chain_elements);
        return 0;
    }
    CRANE.create(c->memory, &chosen);
    CRANE.outputs(c->memory, &c->seen);
    if (bad_output(&c->seen, "parameters that keep it finite", message)) {
        drop_model(c);
        return 0;
    }
    c->observed = 1;
    return 1;
}

/* Read the model's outputs; without a model they are not a number, and no zeros. */
static fmi2Status observe(Instance *c) {
    char message[MESSAGE_SIZE];
    if (c->memory) CRANE.outputs(c->memory, &c->seen);
    if (c->memory || build(c, message)) {
        c->observed = 1;
        return fmi2OK;
    }
    for (int i = 0; i < OUTPUTS; i++) ((double *)&c->seen)[i] = NAN;
    return refuse(c, message);
}

/* errors.py: why the model's step failed; ``start``: s, the host's time when the model's was 0. */
static void describe_failure(Outcome outcome, const Failure *failure, double start,
                             char message[MESSAGE_SIZE]) {
    char t[NUMBER_SIZE], h[NUMBER_SIZE], defect[NUMBER_SIZE], scale[NUMBER_SIZE];
    char allowed[NUMBER_SIZE];
    text_general(t, 6, start + failure->time);
    text_general(h, 3, failure->h);
    text_general(defect, 3, failure->defect);
    text_general(scale, 3, failure->scale);
    text_general(allowed, 6, failure->allowed);
    if (outcome == STEP_ENERGY)
        snprintf(message, MESSAGE_SIZE,
                 "at t = %s s: a step of %s s is off its energy balance by %s J of %s J;"
                 " allowed is %s of it",
                 t, h, defect, scale, allowed);
    else if (outcome == TOTAL_ENERGY)
        snprintf(message, MESSAGE_SIZE,
                 "at t = %s s: the energy balance since the start is off by %s J of %s J;"
                 " allowed is %s of it",
                 t, defect, scale, allowed);
    else if (outcome == SINGULAR)
        snprintf(message, MESSAGE_SIZE,
                 "at t = %s s: the effective stiffness is singular in a step of %s s", t, h);
    else
        snprintf(message, MESSAGE_SIZE,
                 "at t = %s s: the iteration for dynamic equilibrium did not converge in a step"
                 " of %s s",
                 t, h);
}

/* What the model's state begins with. */
static SharedState *shared(const Instance *c) { return CRANE.shared(c->memory); }

/* The command over dt, t after the step's start: inputs by their means, but v_cmd as it is at the
   start, whose slope acts as an acceleration, exactly. */
static Command command_at(const Instance *c, double t, double dt) {
    const double *input = c->values.number, *slope = c->values.slope;
    Command command;
    for (int i = 0; i < INPUTS; i++) {
        double when = i == VR_TROLLEY_V_CMD ? t : t + 0.5 * dt;
        ((double *)&command)[i] = input[i] + when * slope[i];
    }
    return command;
}

/* Whether an input's slope is taken as a mean over each internal step. */
static int has_mean_slopes(const Instance *c) {
    for (int i = 0; i < INPUTS; i++)
        if (i != VR_TROLLEY_V_CMD && c->values.slope[i] != 0.0) return 1;
    return 0;
}

/* trolley.py, checked_move: inputs and step size that are not allowed, in words; 0: all are. */
static int bad_step(const Instance *c, double h, char message[MESSAGE_SIZE]) {
    const double *input = c->values.number, *slope = c->values.slope;
    for (int i = 0; i < INPUTS; i++) {
        double end = input[i] + h * slope[i];
        if (is_finite(input[i]) && (slope[i] == 0.0 || !is_finite(h) || is_finite(end))) continue;
        double value = is_finite(input[i]) ? end : input[i];
        bad_number(message, VARIABLE[i].name, value, "a finite number");
        return 1;
    }
    if (!(h > 0.0 && is_finite(h))) {
        bad_number(message, "step size", h, "a finite number above 0, s");
        return 1;
    }
    if (h > MAX_INTERNAL_STEPS * c->values.number[VR_SOLVER_MAX_STEP]) {
        char allowed[NUMBER_SIZE + 64];
        snprintf(allowed, sizeof allowed, "at most %d internal steps of solver.max_step",
                 MAX_INTERNAL_STEPS);
        bad_number(message, "step size", h, allowed);
        return 1;
    }
    SharedState after = *shared(c);
    Command command = command_at(c, 0.0, h);
    command.trolley_a_cmd =
        slope[VR_TROLLEY_V_CMD] + input[VR_TROLLEY_A_CMD] + h * slope[VR_TROLLEY_A_CMD];
    move_trolley(&after, h, &command);
    if (!is_finite(after.trolley_x) || !is_finite(after.trolley_v)) {
        bad_number(message, VARIABLE[VR_TROLLEY_V_CMD].name, input[VR_TROLLEY_V_CMD],
                   "a command that keeps the trolley's motion finite");
        return 1;
    }
    return 0;
}

/* Advance by dt, t after the step's start; where that fails the caller has the state before. */
static Outcome advance(Instance *c, double t, double dt, Failure *failure) {
    SharedState *state = shared(c);
    Command command = command_at(c, t, dt);
    double slope = c->values.slope[VR_TROLLEY_V_CMD], a_cmd = command.trolley_a_cmd;
    double gained = state->trolley_gained;
    double v = commanded(state, &command), away = fabs(v - state->trolley_v);
    if (away > 0.0 && away <= CONTINUES * fabs(v)) state->trolley_v = v; /* round-off */
    command.trolley_a_cmd += slope;
    Outcome outcome = CRANE.step(c->memory, dt, &command, failure);
    if (outcome == DONE && slope != 0.0) state->trolley_gained = gained + dt * a_cmd;
    return outcome;
}

/* Advance in equal parts, for inputs whose slope is taken as a mean over each. */
static Outcome advance_in_parts(Instance *c, double h, Failure *failure) {
    SharedState *state = shared(c);
    double steps = 0.0, iterations = 0.0, impulse = 0.0;
    Settings settings = settings_of(&c->values);
    double count = equal_parts(h, CRANE.longest_part(&settings));
    for (double i = 0.0; i < count; i += 1.0) {
        Outcome outcome = advance(c, i * h / count, h / count, failure);
        if (outcome != DONE) return outcome;
        if (i == 0.0)
            impulse = state->trolley_impulse; /* where the step's jump is, if there is one */
        steps += state->steps;
        iterations += state->iterations;
    }
    state->steps = steps;
    state->iterations = iterations;
    state->trolley_impulse = impulse;
    return DONE;
}

/* Advance by h, with its outputs; 0, in words, the state as it was, where that cannot be done. */
static int step(Instance *c, double h, char message[MESSAGE_SIZE]) {
    SharedState *state = shared(c);
    Failure failure = {0.0, h, 0.0, 0.0, 0.0};
    size_t count = CRANE.keep(c->memory, c->kept);
    Outcome outcome =
        has_mean_slopes(c) ? advance_in_parts(c, h, &failure) : advance(c, 0.0, h, &failure);
    if (outcome == DONE) {
        CRANE.outputs(c->memory, &c->seen);
        c->observed = 1;
        if (!bad_output(&c->seen, "inputs and a step that keep it finite", message)) return 1;
    }
    CRANE.undo(c->memory, c->kept, count);
    c->observed = 0;
    if (outcome != DONE) describe_failure(outcome, &failure, c->time - state->time, message);
    return 0;
}

/* ---- creation, and the phases of an instance ---- */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

static void start_anew(Instance *c) {
    drop_model(c);
    take_start_values(&c->values);
    c->phase = INSTANTIATED;
    c->time = 0.0;
    c->stop = INFINITY;
    c->noticed = 0;
    c->last_step = fmi2OK;
}

static void release(Instance *c) {
    if (!c) return;
    drop_model(c);
    free(c->name);
    free(c);
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean loggingOn) {
    (void)fmuResourceLocation, (void)visible;
    Instance *c = calloc(1, sizeof *c);
    if (!c) return NULL;
    const char *name = instanceName ? instanceName : "", *wrong = NULL;
    if (functions) {
        c->logger = functions->logger;
        c->environment = functions->componentEnvironment;
    }
    c->logged = loggingOn ? ~0u : 1u << LOG_STATUS_DISCARD | 1u << LOG_STATUS_ERROR;
    c->name = malloc(strlen(name) + 1);
    if (!c->name) {
        free(c);
        return NULL;
    }
    strcpy(c->name, name);
    if (!functions) wrong = "fmi2Instantiate needs callback functions";
    else if (!*name) wrong = "fmi2Instantiate needs an instance name";
    else if (fmuType != fmi2CoSimulation) wrong = "this FMU is for co-simulation alone";
    else if (!fmuGUID || strcmp(fmuGUID, MODEL_GUID) != 0)
        wrong = "the guid is not this FMU's, " MODEL_GUID ": XML and binary do not belong together";
    if (wrong) {
        refuse(c, wrong);
        release(c);
        return NULL;
    }
    start_anew(c);
    return c;
}

void fmi2FreeInstance(fmi2Component component) { release(component); }

fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[]) {
    Instance *c = component;
    unsigned named = 0;
    if (!c || (nCategories && !categories)) return fmi2Error;
    for (size_t i = 0; i < nCategories; i++) {
        unsigned bit = 0;
        for (int known = 0; known < LOG_CATEGORIES; known++)
            if (categories[i] && strcmp(categories[i], LOG_CATEGORY[known]) == 0)
                bit = known == LOG_ALL ? ~0u : 1u << known;
        if (!bit) return refuse(c, "fmi2SetDebugLogging names a category that is not in the XML");
        named |= bit;
    }
    if (!nCategories) named = ~0u;
    c->logged = loggingOn ? named : c->logged & ~named;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean toleranceDefined,
                               fmi2Real tolerance, fmi2Real startTime, fmi2Boolean stopTimeDefined,
                               fmi2Real stopTime) {
    Instance *c = component;
    char message[MESSAGE_SIZE];
    if (!c) return fmi2Error;
    if (c->phase != INSTANTIATED)
        return refuse(c, "an experiment can be set up only before initialisation mode");
    if (!is_finite(startTime)) {
        bad_number(message, "start time", startTime, "a finite number, s");
        return refuse(c, message);
    }
    if (stopTimeDefined && !(is_finite(stopTime) && stopTime >= startTime)) {
        bad_number(message, "stop time", stopTime, "a finite number, s, not before the start time");
        return refuse(c, message);
    }
    c->time = startTime;
    c->stop = stopTimeDefined ? stopTime : INFINITY;
    c->values.tolerance = toleranceDefined ? tolerance : NAN;
    drop_model(c); /* one may have been made to be looked at */
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component) {
    Instance *c = component;
    if (!c) return fmi2Error;
    if (c->phase != INSTANTIATED)
        return refuse(c, "initialisation mode can be entered once, before the first step");
    c->phase = INITIALISING;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component) {
    Instance *c = component;
    char message[MESSAGE_SIZE];
    if (!c) return fmi2Error;
    if (c->phase != INITIALISING)
        return refuse(c, "initialisation mode was left without being entered");
    c->phase = STEPPING;
    if (c->memory || build(c, message)) return fmi2OK;
    return refuse(c, message);
}

fmi2Status fmi2Terminate(fmi2Component component) {
    Instance *c = component;
    char message[MESSAGE_SIZE];
    if (!c) return fmi2Error;
    if (c->phase != STEPPING) {
        snprintf(message, sizeof message,
                 "only an initialised instance can be terminated; this one is %s",
                 PHASES[c->phase]);
        return refuse(c, message);
    }
    c->phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component component) {
    Instance *c = component;
    if (!c) return fmi2Error;
    start_anew(c);
    return fmi2OK;
}

/* ---- variables ---- */

static fmi2Status no_variable(const Instance *c, Kind kind, fmi2ValueReference reference) {
    char message[MESSAGE_SIZE];
    snprintf(message, sizeof message, "no %s variable has the value reference %u", KIND_NAME[kind],
             reference);
    return refuse(c, message);
}

static int is_kind(Kind kind, fmi2ValueReference reference) {
    return reference < VARIABLES && VARIABLE[reference].kind == kind;
}

static fmi2Status get_numbers(Instance *c, Kind kind, const fmi2ValueReference vr[], size_t nvr,
                              fmi2Real real[], fmi2Integer whole[]) {
    fmi2Status status = fmi2OK;
    if (!c || (nvr && (!vr || (!real && !whole)))) return fmi2Error;
    for (size_t i = 0; i < nvr; i++)
        if (!is_kind(kind, vr[i])) return no_variable(c, kind, vr[i]);
    for (size_t i = 0; i < nvr; i++) {
        if (vr[i] >= SETTABLE && !c->observed && status == fmi2OK) status = observe(c);
        double value = vr[i] < SETTABLE ? c->values.number[vr[i]]
                                        : ((const double *)&c->seen)[vr[i] - SETTABLE];
        if (real) real[i] = value;
        else whole[i] = is_finite(value) ? (fmi2Integer)value : 0;
    }
    return status;
}

fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference vr[], size_t nvr,
                       fmi2Real value[]) {
    return get_numbers(component, REAL, vr, nvr, value, NULL);
}

fmi2Status fmi2GetInteger(fmi2Component component, const fmi2ValueReference vr[], size_t nvr,
                          fmi2Integer value[]) {
    return get_numbers(component, INTEGER, vr, nvr, NULL, value);
}

fmi2Status fmi2GetBoolean(fmi2Component component, const fmi2ValueReference vr[], size_t nvr,
                          fmi2Boolean value[]) {
    (void)value;
    if (!component || (nvr && !vr)) return fmi2Error;
    return nvr ? no_variable(component, BOOLEAN, vr[0]) : fmi2OK;
}

fmi2Status fmi2GetString(fmi2Component component, const fmi2ValueReference vr[], size_t nvr,
                         fmi2String value[]) {
    Instance *c = component;
    if (!c || (nvr && (!vr || !value))) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        if (!is_kind(STRING, vr[i])) return no_variable(c, STRING, vr[i]);
        value[i] = c->values.text[VARIABLE[vr[i]].text];
    }
    return fmi2OK;
}

/* Refuse what must not be set, or not now; `value` as Python writes it. */
static fmi2Status check_set(const Instance *c, Kind kind, fmi2ValueReference reference,
                            const char *value) {
    char message[MESSAGE_SIZE];
    if (!is_kind(kind, reference)) return no_variable(c, kind, reference);
    const char *name = VARIABLE[reference].name;
    if (reference >= SETTABLE)
        snprintf(message, sizeof message, "%s is an output: it cannot be set", name);
    else if (reference >= INPUTS && (c->phase == STEPPING || c->phase == TERMINATED))
        snprintf(message, sizeof message,
                 "%s is a parameter: it is fixed when initialisation ends, and cannot be set to"
                 " %s now",
                 name, value);
    else return fmi2OK;
    return refuse(c, message);
}

static void set_number(Instance *c, fmi2ValueReference reference, double value) {
    c->values.number[reference] = value;
    if (reference >= INPUTS) drop_model(c);
}

fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference vr[], size_t nvr,
                       const fmi2Real value[]) {
    Instance *c = component;
    if (!c || (nvr && (!vr || !value))) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        if (vr[i] < INPUTS) continue; /* the way of every step */
        char text[NUMBER_SIZE];
        fmi2Status status = check_set(c, REAL, vr[i], text_repr(text, value[i]));
        if (status != fmi2OK) return status;
    }
    for (size_t i = 0; i < nvr; i++) set_number(c, vr[i], value[i]);
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component component, const fmi2ValueReference vr[], size_t nvr,
                          const fmi2Integer value[]) {
    Instance *c = component;
    if (!c || (nvr && (!vr || !value))) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        char text[NUMBER_SIZE];
        snprintf(text, sizeof text, "%d", value[i]);
        fmi2Status status = check_set(c, INTEGER, vr[i], text);
        if (status != fmi2OK) return status;
    }
    for (size_t i = 0; i < nvr; i++) set_number(c, vr[i], value[i]);
    return fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component component, const fmi2ValueReference vr[], size_t nvr,
                          const fmi2Boolean value[]) {
    (void)value;
    if (!component || (nvr && !vr)) return fmi2Error;
    return nvr ? no_variable(component, BOOLEAN, vr[0]) : fmi2OK;
}

fmi2Status fmi2SetString(fmi2Component component, const fmi2ValueReference vr[], size_t nvr,
                         const fmi2String value[]) {
    Instance *c = component;
    if (!c || (nvr && (!vr || !value))) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        char text[QUOTED_SIZE], message[MESSAGE_SIZE];
        const char *given = value[i] ? value[i] : "";
        fmi2Status status = check_set(c, STRING, vr[i], text_quoted(text, given));
        if (status != fmi2OK) return status;
        if (strlen(given) >= TEXT_SIZE) {
            not_allowed(message, VARIABLE[vr[i]].name, text, VARIABLE[vr[i]].allowed);
            return refuse(c, message);
        }
    }
    for (size_t i = 0; i < nvr; i++) {
        strcpy(c->values.text[VARIABLE[vr[i]].text], value[i] ? value[i] : "");
        drop_model(c);
    }
    return fmi2OK;
}

/* First derivatives of inputs: like values they hold until they are set anew. */
fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference vr[],
                                       size_t nvr, const fmi2Integer order[],
                                       const fmi2Real value[]) {
    Instance *c = component;
    if (!c || (nvr && (!vr || !order || !value))) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        char message[MESSAGE_SIZE];
        if (vr[i] >= INPUTS)
            snprintf(message, sizeof message, "no input has the value reference %u", vr[i]);
        else if (order[i] != 1)
            snprintf(message, sizeof message, "%s: a derivative of order %d is not taken, only 1",
                     VARIABLE[vr[i]].name, order[i]);
        else if (!is_finite(value[i]))
            snprintf(message, sizeof message, "%s: a derivative must be a finite number",
                     VARIABLE[vr[i]].name);
        else continue;
        return refuse(c, message);
    }
    for (size_t i = 0; i < nvr; i++) c->values.slope[vr[i]] = value[i];
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference vr[],
                                        size_t nvr, const fmi2Integer order[], fmi2Real value[]) {
    (void)vr, (void)order, (void)value;
    if (!component) return fmi2Error;
    return nvr ? refuse(component, "outputs have no derivatives: maxOutputDerivativeOrder is 0")
               : fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component component,
                                        const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown,
                                        const fmi2Real dvKnown[], fmi2Real dvUnknown[]) {
    (void)vUnknown_ref, (void)nUnknown, (void)vKnown_ref, (void)nKnown;
    (void)dvKnown, (void)dvUnknown;
    if (!component) return fmi2Error;
    return refuse(component, "there are no directional derivatives");
}

/* ---- steps ---- */

/* Say, once, what the model has to tell of its motion. */
static void give_notice(Instance *c) {
    const char *notice = CRANE.notice(c->memory);
    char message[MESSAGE_SIZE], t[NUMBER_SIZE];
    if (!notice || c->noticed) return;
    snprintf(message, sizeof message, "at t = %s s: %s", text_general(t, 6, c->time), notice);
    say(c, fmi2Warning, LOG_STATUS_WARNING, message);
    c->noticed = 1;
}

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real currentCommunicationPoint,
                      fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    Instance *c = component;
    double at = currentCommunicationPoint, h = communicationStepSize;
    char message[MESSAGE_SIZE];
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!c) return fmi2Error;
    if (c->phase != STEPPING) {
        snprintf(message, sizeof message, "a step needs an initialised instance; this one is %s",
                 PHASES[c->phase]);
        return c->last_step = refuse(c, message);
    }
    if (!c->memory && !build(c, message)) return c->last_step = refuse(c, message);
    if (!is_now(at, c->time, h)) {
        char reached[NUMBER_SIZE], allowed[NUMBER_SIZE + 32];
        snprintf(allowed, sizeof allowed, "the time reached, %s s", text_repr(reached, c->time));
        bad_number(message, "current communication point", at, allowed);
        return c->last_step = say(c, fmi2Discard, LOG_STATUS_DISCARD, message);
    }
    if (is_beyond(at + h, c->stop, h)) {
        char stop[NUMBER_SIZE], allowed[NUMBER_SIZE + 64];
        snprintf(allowed, sizeof allowed, "at most the stop time, %s s", text_repr(stop, c->stop));
        bad_number(message, "end of the step", at + h, allowed);
        return c->last_step = refuse(c, message);
    }
    double meant = meant_step(at, h, c->values.number[VR_SOLVER_MAX_STEP]);
    if (bad_step(c, h, message) || !step(c, meant, message))
        return c->last_step = say(c, fmi2Discard, LOG_STATUS_DISCARD, message);
    c->time = at + h;
    give_notice(c);
    return c->last_step = fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component component) {
    if (!component) return fmi2Error;
    return refuse(component, "there is no step to cancel: fmi2DoStep ends before it returns");
}

fmi2Status fmi2GetStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Status *value) {
    Instance *c = component;
    if (!c || !value) return fmi2Error;
    if (kind != fmi2DoStepStatus) return fmi2Discard;
    *value = c->last_step;
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Real *value) {
    Instance *c = component;
    if (!c || !value) return fmi2Error;
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = c->time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component component, const fmi2StatusKind kind,
                                fmi2Integer *value) {
    (void)kind;
    return component && value ? fmi2Discard : fmi2Error; /* the standard has none */
}

fmi2Status fmi2GetBooleanStatus(fmi2Component component, const fmi2StatusKind kind,
                                fmi2Boolean *value) {
    if (!component || !value) return fmi2Error;
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = fmi2False; /* a discarded step is no wish to end */
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component component, const fmi2StatusKind kind,
                               fmi2String *value) {
    (void)kind;
    return component && value ? fmi2Discard : fmi2Error; /* fmi2PendingStatus: none is pending */
}

/* ---- state ---- */

/* Room for so many bytes in *state, made if there is none; 0 without memory. */
static int make_room(fmi2FMUstate *state, size_t size) {
    SavedState *s = *state;
    if (!s) s = calloc(1, sizeof *s);
    if (!s) return 0;
    if (s->room < size) {
        unsigned char *bytes = realloc(s->bytes, size);
        if (!bytes) {
            if (!*state) free(s);
            return 0;
        }
        s->bytes = bytes;
        s->room = size;
    }
    s->size = size;
    *state = s;
    return 1;
}

fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *FMUstate) {
    Instance *c = component;
    if (!c || !FMUstate) return fmi2Error;
    size_t count = c->memory ? CRANE.save(c->memory, c->kept) : 0;
    if (!make_room(FMUstate, saved_size(count))) return refuse(c, "no memory for a saved state");
    Snapshot snapshot = {(int)c->phase, c->time, c->values};
    save_state(&snapshot, c->kept, count, ((SavedState *)*FMUstate)->bytes);
    return fmi2OK;
}

/* The model's part of a saved state; 0, the model as it was, where it does not fit. */
static int restore_model(Instance *c, const unsigned char *model, size_t count) {
    Settings settings = settings_of(&c->values);
    if (count > CRANE.state_count(&settings)) return 0;
    read_doubles(model, c->kept, count);
    return CRANE.load(c->memory, c->kept, count);
}

/* Restore a state, all or nothing. */
fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate FMUstate) {
    Instance *c = component;
    const SavedState *state = FMUstate;
    char message[MESSAGE_SIZE], foreign[256];
    Snapshot snapshot;
    const unsigned char *model;
    size_t count;
    if (!c || !state) return fmi2Error;
    const char *wrong = load_state(state->bytes, state->size, &snapshot, &model, &count, foreign);
    if (!wrong && (unsigned)snapshot.phase > TERMINATED)
        wrong = "the saved state is damaged, or not a chaincrane state";
    if (wrong) return refuse(c, wrong);
    size_t parameters = (SETTABLE - INPUTS) * sizeof(double);
    int same =
        c->memory &&
        memcmp(c->values.number + INPUTS, snapshot.values.number + INPUTS, parameters) == 0 &&
        memcmp(c->values.text, snapshot.values.text, sizeof c->values.text) == 0 &&
        memcmp(&c->values.tolerance, &snapshot.values.tolerance, sizeof(double)) == 0;
    Instance made = {.values = snapshot.values, .memory = c->memory, .kept = c->kept};
    if (!same) made.memory = NULL, made.kept = NULL;
    if (count && !same && !build(&made, message)) return refuse(c, message);
    if (count && !restore_model(&made, model, count)) {
        if (!same) drop_model(&made);
        return refuse(c, "the saved state is of other chain.elements, solver.error_estimate or"
                         " solver.tolerance");
    }
    if (!count || !same) drop_model(c);
    if (count) c->memory = made.memory, c->kept = made.kept;
    c->values = snapshot.values;
    c->noticed = count && CRANE.notice(c->memory) != NULL;
    c->phase = (Phase)snapshot.phase;
    c->time = snapshot.time;
    c->observed = 0;
    c->last_step = fmi2OK;
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *FMUstate) {
    if (!component || !FMUstate) return fmi2Error;
    SavedState *state = *FMUstate;
    if (state) free(state->bytes);
    free(state);
    *FMUstate = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate FMUstate,
                                      size_t *size) {
    const SavedState *state = FMUstate;
    if (!component || !state || !size) return fmi2Error;
    *size = state->size;
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate FMUstate,
                                 fmi2Byte serializedState[], size_t size) {
    const SavedState *state = FMUstate;
    if (!component || !state || !serializedState) return fmi2Error;
    if (size < state->size) return refuse(component, "too little room for the saved state");
    memcpy(serializedState, state->bytes, state->size);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte serializedState[],
                                   size_t size, fmi2FMUstate *FMUstate) {
    char foreign[256];
    Snapshot snapshot;
    const unsigned char *model, *bytes = (const unsigned char *)serializedState;
    size_t count;
    if (!component || !serializedState || !FMUstate) return fmi2Error;
    const char *wrong = load_state(bytes, size, &snapshot, &model, &count, foreign);
    if (wrong) return refuse(component, wrong);
    if (!make_room(FMUstate, size)) return refuse(component, "no memory for a saved state");
    memcpy(((SavedState *)*FMUstate)->bytes, bytes, size);
    return fmi2OK;
}
