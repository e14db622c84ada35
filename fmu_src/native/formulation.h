/* What the nonlinear crane asks of a formulation of its chain; the twin of
   chaincrane/plant/formulation.py. */

#ifndef FORMULATION_H
#define FORMULATION_H

#include <stddef.h>

#include "crane.h"
#include "scheme.h"

typedef struct {
    /* Bytes of its own that a workspace needs besides what all have. */
    size_t (*memory)(const Settings *settings);
    /* Lay them out, once work->chain is there, and compute what is constant. */
    void (*prepare)(Workspace *work, void *memory);
    /* s, what the scheme can take. */
    double (*longest_step)(const Workspace *work);
    /* s, what resolves the waves after a jump; infinite where any step does. */
    double (*wave_step)(const Workspace *work);
    double step_energy_tolerance; /* of the energy put in so far, what a step may be off by */
    /* Of the payloads' distance in two solutions, what the time error is told to be. */
    double (*error_share)(int slack);
    /* The straight chain held at the sway angle, about to be released. */
    void (*straight)(Workspace *work, double sway_angle, Motion *motion);
    /* J, above the hanging equilibrium. */
    double (*potential)(const Workspace *work, const Vector *r);
    /* J, mechanical, above the rest position. */
    double (*energy)(const Workspace *work, const Motion *motion, double trolley_v);
    /* kg m/s, horizontal, relative to the trolley. */
    double (*momentum)(const Workspace *work, const Vector *w);
    /* N, of the drive in the instant of release. */
    double (*released_force)(Workspace *work, const Motion *motion, double trolley_v);
    /* Positions and velocities relative to the trolley. */
    void (*posture)(const Workspace *work, const Motion *motion, Posture *posture);
} Formulation;

#endif
