/* The paper's scheme; the twin of chaincrane/plant/newmark.py. */

#ifndef NEWMARK_H
#define NEWMARK_H

#include "names.h"
#include "scheme.h"

HIDDEN

extern const Scheme NEWMARK_SCHEME;

SHOWN

#endif
