/* The nonlinear crane; see nonlinear.c. */

#ifndef NONLINEAR_H
#define NONLINEAR_H

#include "crane.h"
#include "names.h"

HIDDEN

extern const CraneModel NONLINEAR;

/* Estimated time error of the payload's place, m, the largest since the start. */
double estimated_error(const void *memory);

SHOWN

#endif
