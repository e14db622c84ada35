/* The nonlinear crane for the FMI layer: chain_kernel.c, under the names of model.h. */

#include "model.h"

static void create(void *memory, const ChainSettings *settings) { chain_create(memory, settings); }

static int step(void *memory, double h, double v_cmd, double a_cmd, double payload_fx,
                ChainFailure *failure) {
    return chain_step(memory, h, v_cmd, a_cmd, payload_fx, failure);
}

static void outputs(const void *memory, double values[CHAIN_OUTPUTS]) {
    chain_outputs(memory, values);
}

static double *state(void *memory) { return chain_state(memory); }

const CraneModel CRANE = {chain_memory, create, step, outputs, chain_state_count, state};
