/* Values of inputs and parameters, and what they may be: the twin of chaincrane/variables.py and of
   parameters.py's checks, from the same table. */

#ifndef START_VALUES_H
#define START_VALUES_H

#include "interface.h"
#include "names.h"
#include "twins.h"

HIDDEN

/* Bytes, ends included: of a String's value, of a message. */
enum { TEXT_SIZE = 64, MESSAGE_SIZE = 512 };

/* Values of inputs and parameters by value reference, as numbers or texts, and the inputs' slopes:
   their first derivatives during a step. */
typedef struct {
    double number[SETTABLE];
    double slope[INPUTS];
    char text[STRINGS][TEXT_SIZE];
    double tolerance; /* of the host's experiment; not a number: it has none */
} Values;

void take_start_values(Values *values);

/* "name = value is not allowed: allowed", in words. */
void not_allowed(char message[MESSAGE_SIZE], const char *name, const char *value,
                 const char *allowed);
void bad_number(char message[MESSAGE_SIZE], const char *name, double value, const char *allowed);

/* The first parameter that is not allowed, in words; 0 where all are. */
int bad_parameter(const Values *values, char message[MESSAGE_SIZE]);

/* The parameters as a crane takes them. */
Settings settings_of(const Values *values);

SHOWN

#endif
