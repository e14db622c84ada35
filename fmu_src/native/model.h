/* What the FMI layer asks of a crane in C: each model's file defines one CRANE.

   A model lives in memory of the caller's, `memory(elements)` bytes, and allocates nothing; its
   whole state is one flat array of doubles whose first ones are the same in every model. */

#ifndef MODEL_H
#define MODEL_H

#include "chain_kernel.h"

/* The state's first doubles, in the order of CraneModel.save() in chaincrane/crane.py. */
enum {
    STATE_TIME,           /* s since the start */
    STATE_TROLLEY_X,      /* m */
    STATE_TROLLEY_V,      /* m/s */
    STATE_TROLLEY_GAINED, /* m/s, integral of a_cmd */
    STATE_STEPS,          /* of the last communication step */
    STATE_ITERATIONS
};

typedef struct {
    size_t (*memory)(int elements);
    void (*create)(void *memory, const ChainSettings *settings);
    /* Advance by h seconds under held commands: CHAIN_OK, or else the state is as it was. */
    int (*step)(void *memory, double h, double v_cmd, double a_cmd, double payload_fx,
                ChainFailure *failure);
    void (*outputs)(const void *memory, double outputs[CHAIN_OUTPUTS]);
    size_t (*state_count)(int elements);
    double *(*state)(void *memory);
} CraneModel;

extern const CraneModel CRANE;

#endif
