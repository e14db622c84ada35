/* The chain that does not stretch; the twin of chaincrane/plant/inextensible.py, where sketch, signs
   and sources are. */

#ifndef INEXTENSIBLE_H
#define INEXTENSIBLE_H

#include "formulation.h"
#include "names.h"

HIDDEN

extern const Formulation INEXTENSIBLE;
extern const Scheme INEXTENSIBLE_SCHEME;

SHOWN

#endif
