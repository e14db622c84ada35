/* A crane for chaincrane/plant/kernel.py, which calls it from Python. */

#include "crane.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* What the two hand each other at a step. */
typedef struct {
    void *memory;
    double *kept;       /* room for as many doubles as crane_keep counts */
    Command command;    /* of the next step */
    Outputs outputs;    /* now; of a step that was NOT_FINITE, then */
    const char *notice; /* what a user should be told of the motion now, or NULL */
    Failure failure;    /* of a step that failed */
} Exchange;

EXPORT const char *crane_layout(void);
EXPORT size_t crane_memory(const Settings *settings);
EXPORT void crane_create(void *memory, const Settings *settings);
EXPORT size_t crane_keep(const void *memory, double *kept);
EXPORT void crane_look(Exchange *exchange);
EXPORT int crane_step(Exchange *exchange, double h);
EXPORT SharedState *crane_shared(void *memory);
EXPORT size_t crane_save(const void *memory, double *state);
EXPORT int crane_load(void *memory, const double *state, size_t count);

/* Of what the two hand each other, for kernel.py to compare with its own. */
const char *crane_layout(void) { return LAYOUT; }

size_t crane_memory(const Settings *settings) { return CRANE.memory(settings); }

void crane_create(void *memory, const Settings *settings) { CRANE.create(memory, settings); }

/* CRANE's; ``kept`` NULL: only count. */
size_t crane_keep(const void *memory, double *kept) { return CRANE.keep(memory, kept); }

/* Read what is to be seen now. */
void crane_look(Exchange *exchange) {
    CRANE.outputs(exchange->memory, &exchange->outputs);
    exchange->notice = CRANE.notice(exchange->memory);
}

/* Advance by h seconds to finite outputs: DONE, or else the state is as it was. */
int crane_step(Exchange *exchange, double h) {
    Exchange *e = exchange;
    size_t count = CRANE.keep(e->memory, e->kept);
    Outcome outcome = CRANE.step(e->memory, h, &e->command, &e->failure);
    if (outcome != DONE) return outcome;
    crane_look(e);
    if (are_finite(&e->outputs)) return DONE;
    CRANE.undo(e->memory, e->kept, count);
    return NOT_FINITE;
}

SharedState *crane_shared(void *memory) { return CRANE.shared(memory); }

size_t crane_save(const void *memory, double *state) { return CRANE.save(memory, state); }

int crane_load(void *memory, const double *state, size_t count) {
    return CRANE.load(memory, state, count);
}
