/* The paper's scheme; the twin of chaincrane/plant/newmark.py. */

#ifndef NEWMARK_H
#define NEWMARK_H

#include "scheme.h"

Step newmark_step;

#endif
