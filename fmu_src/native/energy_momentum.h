/* The default scheme; the twin of chaincrane/plant/energy_momentum.py. */

#ifndef ENERGY_MOMENTUM_H
#define ENERGY_MOMENTUM_H

#include "names.h"
#include "scheme.h"

HIDDEN

extern const Scheme ENERGY_MOMENTUM_SCHEME;

SHOWN

#endif
