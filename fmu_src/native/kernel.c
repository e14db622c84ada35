/* A crane for chaincrane/plant/kernel.py, which calls it from Python. */

#include "crane.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

EXPORT const char *crane_layout(void);
EXPORT size_t crane_memory(const Settings *settings);
EXPORT void crane_create(void *memory, const Settings *settings);
EXPORT int crane_step(void *memory, double h, const Command *command, Failure *failure);
EXPORT void crane_outputs(const void *memory, Outputs *outputs);
EXPORT const char *crane_notice(const void *memory);
EXPORT SharedState *crane_shared(void *memory);
EXPORT size_t crane_save(const void *memory, double *state);
EXPORT int crane_load(void *memory, const double *state, size_t count);

/* Of what the two hand each other, for kernel.py to compare with its own. */
const char *crane_layout(void) { return LAYOUT; }

size_t crane_memory(const Settings *settings) { return CRANE.memory(settings); }

void crane_create(void *memory, const Settings *settings) { CRANE.create(memory, settings); }

int crane_step(void *memory, double h, const Command *command, Failure *failure) {
    return CRANE.step(memory, h, command, failure);
}

void crane_outputs(const void *memory, Outputs *outputs) { CRANE.outputs(memory, outputs); }

const char *crane_notice(const void *memory) { return CRANE.notice(memory); }

SharedState *crane_shared(void *memory) { return CRANE.shared(memory); }

size_t crane_save(const void *memory, double *state) { return CRANE.save(memory, state); }

int crane_load(void *memory, const double *state, size_t count) {
    return CRANE.load(memory, state, count);
}
