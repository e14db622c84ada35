/* A jump of the trolley's velocity; the twin of chaincrane/plant/jump.py. */

#ifndef JUMP_H
#define JUMP_H

#include "names.h"
#include "scheme.h"

HIDDEN

Jump plain_jump;
Jump filtered_jump;

/* ``motion`` with the elements at the lengths of now + share (tension - now), N, into work->end; now
   is the elastic tension, and tension stands in work->end.tension. */
void settled(Workspace *work, const Motion *motion, double share);

SHOWN

#endif
