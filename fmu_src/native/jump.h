/* A jump of the trolley's velocity; the twin of chaincrane/plant/jump.py. */

#ifndef JUMP_H
#define JUMP_H

#include "names.h"
#include "scheme.h"

HIDDEN

/* Longest step, s, that resolves the waves which a jump leaves: L0/(4 c) + JUMP_TIME x^4 (1 + x^4). */
double wave_step(const Chain *c);

/* How long, s, the waves of a jump by ``dv`` m/s are followed: 6/omega_1, at most 40 L/c; 0: a small jump. */
double wave_time(const Chain *c, double dv);

Jump plain_jump;
Jump filtered_jump;

/* ``motion`` with the elements at the lengths of now + share (tension - now), N, into work->end; now
   is the elastic tension, and tension stands in work->end.tension. */
void settled(Workspace *work, const Motion *motion, double share);

SHOWN

#endif
