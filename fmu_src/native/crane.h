/* A crane in C: what its hosts ask of it, and what both cranes share. The twin of crane.py and
   trolley.py in chaincrane/plant.

   A crane lives in memory of the caller's, ``memory(settings)`` bytes, and allocates nothing; its
   whole state can be had as doubles, which begin with a SharedState. Each library has one CRANE. */

#ifndef CRANE_H
#define CRANE_H

#include <stddef.h>

#include "chain.h"
#include "names.h"

HIDDEN

typedef struct {
    size_t (*memory)(const Settings *settings);
    /* Make a crane at its initial state; the caller has checked the settings. */
    void (*create)(void *memory, const Settings *settings);
    /* Advance by h seconds under a held command: DONE, or else the state is as it was. */
    Outcome (*step)(void *memory, double h, const Command *command, Failure *failure);
    void (*outputs)(const void *memory, Outputs *outputs);
    /* What a user should be told of the motion, once; NULL: nothing. */
    const char *(*notice)(const void *memory);
    /* What the state begins with, in place. */
    SharedState *(*shared)(void *memory);
    size_t (*state_count)(const Settings *settings); /* most doubles that a state can have */
    /* Write the state; the count of its doubles. ``state`` NULL: only count them. */
    size_t (*save)(const void *memory, double *state);
    /* Restore what ``save`` gave; 0, the crane as it was, where it is of other settings. */
    int (*load)(void *memory, const double *state, size_t count);
    /* The same for what the next step changes, which is less where a state holds its past. */
    size_t (*keep)(const void *memory, double *kept);
    int (*undo)(void *memory, const double *kept, size_t count);
    /* Longest part, s, of a communication step that is stepped in one go: an input that changes within
       the step is held at its mean over each such part. */
    double (*longest_part)(const Settings *settings);
} CraneModel;

extern const CraneModel CRANE;

/* save and load of a crane whose state is one array of ``own`` doubles. */
size_t save_plain(const double *own, size_t count, double *state);
int load_plain(double *own, size_t own_count, const double *state, size_t count);

/* ---- trolley.py ---- */

/* Number of equal parts of h seconds, none longer than ``longest``; a ratio that is whole but for
   round-off counts as whole. */
double equal_parts(double h, double longest);

/* Velocity, m/s, that a command asks for at this instant. */
double commanded(const SharedState *now, const Command *command);

/* Whether h and the command are allowed: finite, and a motion of the trolley that stays so. */
int is_allowed(const SharedState *now, const Settings *settings, double h, const Command *command);

/* The trolley after h seconds of a held command. */
void move_trolley(SharedState *state, double h, const Command *command);

/* ---- ledger.py ---- */

/* Mechanical energy that must be there now, J. */
double expected_energy(const SharedState *state);

/* ---- crane.py ---- */

/* What is seen of a crane, relative to its trolley. */
typedef struct {
    Vector points[POINTS]; /* m, ten material points from the top, then the middle */
    Vector node1, payload; /* m */
    Vector payload_w;      /* m/s */
} Posture;

/* All outputs but those that each crane has in its own way, which stay not a number. */
void shared_outputs(const SharedState *state, const Posture *posture, double energy,
                    Outputs *outputs);

/* Whether all outputs are finite numbers. */
int are_finite(const Outputs *outputs);

SHOWN

#endif
