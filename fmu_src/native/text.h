/* Numbers as Python writes them, so that both kinds of FMU say the same words. */

#ifndef TEXT_H
#define TEXT_H

enum { NUMBER_SIZE = 40 };

/* repr(value): the fewest digits that read back as the same number. Returns `out`. */
char *text_repr(char out[NUMBER_SIZE], double value);

/* f"{value:.{digits}g}". Returns `out`. */
char *text_general(char out[NUMBER_SIZE], int digits, double value);

#endif
