/* Numbers as Python writes them, so that both kinds of FMU say the same words. */

#ifndef TEXT_H
#define TEXT_H

#include "names.h"

HIDDEN

enum { NUMBER_SIZE = 40, QUOTED_SIZE = 80 };

/* repr(value): the fewest digits that read back as the same number. Returns `out`. */
char *text_repr(char out[NUMBER_SIZE], double value);

/* f"{value:.{digits}g}". Returns `out`. */
char *text_general(char out[NUMBER_SIZE], int digits, double value);

/* A text in quotation marks, as much of it as fits, in whole characters of UTF-8; a byte that belongs
   to none is a question mark. Returns `out`. */
char *text_quoted(char out[QUOTED_SIZE], const char *text);

SHOWN

#endif
