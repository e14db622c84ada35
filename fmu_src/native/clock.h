/* A host's times, which come with round-off: the twin of chaincrane/clock.py. */

#ifndef CLOCK_H
#define CLOCK_H

#include "names.h"

HIDDEN

/* Whether a step of h s that begins ``at`` begins at the time ``reached``, s. */
int is_now(double at, double reached, double h);

/* Whether a step of h s to ``end`` goes beyond the time ``stop``, s. */
int is_beyond(double end, double stop, double h);

/* h s as it was meant: a whole number of ``unit`` s where it is one but for the round-off of the
   times ``at`` and at + h; else h. */
double meant_step(double at, double h, double unit);

SHOWN

#endif
