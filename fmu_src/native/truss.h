/* The paper's chain of truss elements as a formulation; the twin of chaincrane/plant/truss.py. */

#ifndef TRUSS_H
#define TRUSS_H

#include "formulation.h"
#include "names.h"

HIDDEN

extern const Formulation TRUSS;

SHOWN

#endif
