/* What a time-stepping scheme takes and gives; the twin of chaincrane/plant/scheme.py. A scheme knows
   nothing of communication steps. */

#ifndef SCHEME_H
#define SCHEME_H

#include "banded.h"
#include "chain.h"

/* Motion of the free nodes relative to the trolley: m, m/s, m/s2, N. */
typedef struct {
    Vector *r, *w;
    Vector *a; /* not a number at a start */
    double *tension;
    double *stretched; /* m, by the last step; 0 at a start */
    double last_h;     /* s, that step's length; 0 at a start */
} Motion;

/* What drives the crane during an internal step. */
typedef struct {
    double trolley_v; /* m/s, at the step's start */
    Command command;  /* its acceleration and forces are constant */
} Load;

/* Velocity of the trolley, m/s, t seconds into the step. */
static inline double trolley_v_after(const Load *load, double t) {
    return load->trolley_v + t * load->command.trolley_a_cmd;
}

/* Energy terms of a step that converged; its motion stands in the workspace's ``end``. */
typedef struct {
    double trolley_fx, work_trolley, work_payload, dissipated; /* N, J */
    int iterations;
} StepResult;

struct GaussChain;

/* A chain, and the memory that a scheme works in. */
typedef struct {
    Chain chain;
    struct GaussChain *gauss;     /* of an inextensible one */
    Banded banded;                /* its matrix, and the elements' tangents */
    Motion end;                   /* of the step */
    Vector *a0, *d0, *d1, *moved; /* accelerations at its start; element vectors; displacements */
    double *l0;                   /* m, elements' lengths at its start */
    double *lag;                  /* N, viscous tension of a stretch like the last step's */
    Vector *unknown;              /* residual, then correction */
} Workspace;

/* A jump of the trolley's velocity by dv to trolley_v, m/s: changes motion's velocities, by what stands
   in work->unknown then. Not 0: and the motion after it requires the tension in work->end.tension. */
typedef int Jump(Workspace *work, Motion *motion, const Command *command, double trolley_v,
                 double dv);

/* One step of h seconds from ``from``: DONE, or why not. */
typedef Outcome Step(Workspace *work, const Motion *from, const Load *load, double h,
                     StepResult *result);

/* A time-stepping scheme. */
typedef struct {
    Jump *jump;
    Step *step;
} Scheme;

#endif
