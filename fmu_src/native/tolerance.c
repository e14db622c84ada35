/* A crane that keeps a tolerance, over the nonlinear one; the twin of chaincrane/plant/tolerance.py. */

#include <string.h>

#include "crane.h"
#include "nonlinear.h"

typedef struct {
    Settings settings;
    ToleranceState head;
    PastStep *past; /* communication steps since the start; NULL: no tolerance is asked for */
    double *kept;   /* the crane's state during a run with shorter steps */
    void *crane;
} TolerantCrane;

static size_t rounded(size_t bytes) { return (bytes + 15) / 16 * 16; }

static int has_tolerance(const Settings *settings) { return settings->solver_tolerance > 0.0; }

static size_t past_size(const Settings *settings) {
    return has_tolerance(settings) ? rounded(MAX_REMEMBERED * sizeof(PastStep)) : 0;
}

static size_t kept_size(const Settings *settings) {
    size_t count = has_tolerance(settings) ? NONLINEAR.state_count(settings) : 0;
    return rounded(count * sizeof(double));
}

static size_t memory_size(const Settings *settings) {
    return rounded(sizeof(TolerantCrane)) + past_size(settings) + kept_size(settings) +
           NONLINEAR.memory(settings);
}

/* The crane at its start, with the step of the present level. */
static void make(TolerantCrane *tolerant) {
    Settings settings = tolerant->settings;
    for (double i = 0.0; i < tolerant->head.level; i += 1.0) settings.solver_max_step *= 0.5;
    NONLINEAR.create(tolerant->crane, &settings);
}

static void create(void *memory, const Settings *settings) {
    TolerantCrane *tolerant = memory;
    char *next = (char *)memory + rounded(sizeof *tolerant);
    memset(tolerant, 0, sizeof *tolerant);
    tolerant->settings = *settings;
    tolerant->past = has_tolerance(settings) ? (PastStep *)next : NULL;
    tolerant->kept = (double *)(next + past_size(settings));
    tolerant->crane = next + past_size(settings) + kept_size(settings);
    make(tolerant);
}

static SharedState *shared(void *memory) {
    return NONLINEAR.shared(((TolerantCrane *)memory)->crane);
}

/* Whether the estimate exceeds a share of the tolerance. */
static int exceeds(const TolerantCrane *tolerant, double share) {
    return tolerant->past &&
           estimated_error(tolerant->crane) > share * tolerant->settings.solver_tolerance;
}

/* Run all that was anew, with steps half as long; as it was where that fails. */
static void refine(TolerantCrane *tolerant) {
    Failure failure;
    SharedState *now = NONLINEAR.shared(tolerant->crane);
    double steps = now->steps, iterations = now->iterations;
    size_t count = NONLINEAR.save(tolerant->crane, tolerant->kept);
    tolerant->head.level += 1.0;
    make(tolerant);
    for (size_t i = 0; i < (size_t)tolerant->head.remembered; i++) {
        const PastStep *past = &tolerant->past[i];
        now->trolley_v = past->trolley_v;
        now->trolley_gained = past->trolley_gained;
        if (NONLINEAR.step(tolerant->crane, past->h, &past->command, &failure) != DONE) {
            tolerant->head.level -= 1.0;
            tolerant->head.gave_up = 1.0;
            make(tolerant);
            NONLINEAR.load(tolerant->crane, tolerant->kept, count);
            break;
        }
        steps += now->steps;
        iterations += now->iterations;
    }
    now->steps = steps;
    now->iterations = iterations;
}

static Outcome step(void *memory, double h, const Command *command, Failure *failure) {
    TolerantCrane *tolerant = memory;
    ToleranceState *head = &tolerant->head;
    const SharedState *now = shared(memory);
    PastStep past = {h, *command, now->trolley_v, now->trolley_gained};
    Outcome outcome = NONLINEAR.step(tolerant->crane, h, command, failure);
    if (outcome != DONE || !tolerant->past) return outcome;
    if (head->remembered == MAX_REMEMBERED) {
        head->gave_up = 1.0;
        head->remembered = 0.0;
    }
    if (head->gave_up != 0.0) return DONE;
    tolerant->past[(size_t)head->remembered] = past;
    head->remembered += 1.0;
    while (exceeds(tolerant, ESTIMATED_SHARE) && head->level < MAX_REFINEMENTS &&
           head->gave_up == 0.0)
        refine(tolerant);
    return DONE;
}

static void outputs(const void *memory, Outputs *o) {
    NONLINEAR.outputs(((const TolerantCrane *)memory)->crane, o);
}

static const char *notice(const void *memory) {
    const TolerantCrane *tolerant = memory;
    return exceeds(tolerant, 1.0) ? TOLERANCE_NOT_KEPT : NONLINEAR.notice(tolerant->crane);
}

static double longest_part(const Settings *settings) { return NONLINEAR.longest_part(settings); }

/* ---- the state: the crane's, how it was refined, and the steps so far ---- */

enum { HEAD = sizeof(ToleranceState) / sizeof(double), PAST = sizeof(PastStep) / sizeof(double) };

static size_t state_count(const Settings *settings) {
    return NONLINEAR.state_count(settings) +
           (has_tolerance(settings) ? HEAD + (size_t)MAX_REMEMBERED * PAST : 0);
}

/* All but the steps so far. */
static size_t keep(const void *memory, double *state) {
    const TolerantCrane *tolerant = memory;
    size_t own = NONLINEAR.save(tolerant->crane, state);
    if (!tolerant->past) return own;
    if (state) memcpy(state + own, &tolerant->head, sizeof tolerant->head);
    return own + HEAD;
}

static int undo(void *memory, const double *state, size_t count) {
    TolerantCrane *tolerant = memory;
    size_t own = tolerant->past ? count - HEAD : count;
    double level = tolerant->head.level;
    if (tolerant->past) memcpy(&tolerant->head, state + own, sizeof tolerant->head);
    if (tolerant->head.level != level) make(tolerant);
    return NONLINEAR.load(tolerant->crane, state, own);
}

static size_t save(const void *memory, double *state) {
    const TolerantCrane *tolerant = memory;
    size_t kept = keep(memory, state), past = (size_t)tolerant->head.remembered * PAST;
    if (state && past) memcpy(state + kept, tolerant->past, past * sizeof(double));
    return kept + past;
}

static int is_whole(double number, double most) {
    return number >= 0.0 && number <= most && floor(number) == number;
}

static int load(void *memory, const double *state, size_t count) {
    TolerantCrane *tolerant = memory;
    size_t own = NONLINEAR.state_count(&tolerant->settings);
    if (!tolerant->past) return NONLINEAR.load(tolerant->crane, state, count);
    if (count < own + HEAD) return 0;
    ToleranceState head;
    memcpy(&head, state + own, sizeof head);
    if (!is_whole(head.level, MAX_REFINEMENTS) || !is_whole(head.remembered, MAX_REMEMBERED) ||
        count != own + HEAD + (size_t)head.remembered * PAST)
        return 0;
    tolerant->head = head;
    make(tolerant);
    memcpy(tolerant->past, state + own + HEAD, (size_t)head.remembered * sizeof(PastStep));
    return NONLINEAR.load(tolerant->crane, state, own);
}

const CraneModel CRANE = {.memory = memory_size,
                          .create = create,
                          .step = step,
                          .outputs = outputs,
                          .notice = notice,
                          .shared = shared,
                          .state_count = state_count,
                          .save = save,
                          .load = load,
                          .keep = keep,
                          .undo = undo,
                          .longest_part = longest_part};
