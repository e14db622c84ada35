/* The paper's scheme; the twin of chaincrane/plant/newmark.py. */

#ifndef NEWMARK_H
#define NEWMARK_H

#include "scheme.h"

extern const Scheme NEWMARK_SCHEME;

#endif
