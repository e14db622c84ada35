/* An instance's whole state as bytes, the same on every platform: little-endian doubles and whole
   numbers of eight bytes each, a checksum, and the model and sources that they belong to. */

#ifndef SAVED_STATE_H
#define SAVED_STATE_H

#include <stddef.h>

#include "names.h"
#include "start_values.h"

HIDDEN

typedef struct {
    int phase;
    double time; /* s */
    Values values;
} Snapshot;

/* Bytes that a snapshot with so many doubles of model state takes; 0 doubles: there is no model. */
size_t saved_size(size_t model_count);

/* Write a snapshot and the model's state into saved_size(model_count) bytes. */
void save_state(const Snapshot *snapshot, const double *model, size_t model_count,
                unsigned char *bytes);

/* Read a snapshot; *model points at the model's state, for read_doubles. NULL, or what is wrong:
   then nothing was written. `foreign` has room for that text. */
const char *load_state(const unsigned char *bytes, size_t size, Snapshot *snapshot,
                       const unsigned char **model, size_t *model_count, char foreign[256]);

void read_doubles(const unsigned char *bytes, double *values, size_t count);

SHOWN

#endif
