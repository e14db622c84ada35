/* Numbers as Python writes them; see text.h. A host's locale may write a comma for the point. */

#include "text.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_DIGITS = 17, LARGEST_FIXED = 16, SMALLEST_FIXED = -4 };

/* nan, inf or -inf; NULL for a finite number. */
static const char *not_finite(double value) {
    if (value != value) return "nan";
    if (value - value == 0.0) return NULL;
    return value > 0.0 ? "inf" : "-inf";
}

/* The digits of |value|, first one before the point, and its decimal exponent. */
static int shortest_digits(double value, char digits[MOST_DIGITS + 1]) {
    char text[NUMBER_SIZE];
    for (int after_point = 0; after_point < MOST_DIGITS; after_point++) {
        snprintf(text, sizeof text, "%.*e", after_point, value);
        if (strtod(text, NULL) == value) break;
    }
    int count = 0;
    const char *at = text;
    for (; *at != 'e'; at++)
        if (*at >= '0' && *at <= '9') digits[count++] = *at;
    digits[count] = '\0';
    return (int)strtol(at + 1, NULL, 10);
}

char *text_repr(char out[NUMBER_SIZE], double value) {
    const char *word = not_finite(value);
    if (word) return strcpy(out, word);
    char digits[MOST_DIGITS + 1], *end = out;
    int exponent = shortest_digits(value, digits), count = (int)strlen(digits);
    if (value < 0.0 || 1.0 / value < 0.0) *end++ = '-';
    if (exponent < SMALLEST_FIXED || exponent >= LARGEST_FIXED) {
        *end++ = digits[0];
        if (count > 1) *end++ = '.';
        for (int i = 1; i < count; i++) *end++ = digits[i];
        snprintf(end, NUMBER_SIZE - MOST_DIGITS - 2, "e%+03d", exponent);
        return out;
    }
    int before_point = exponent + 1;
    if (before_point <= 0) *end++ = '0', *end++ = '.';
    for (int zeros = before_point; zeros < 0; zeros++) *end++ = '0';
    for (int i = 0; i < count || i < before_point; i++) {
        if (i > 0 && i == before_point) *end++ = '.';
        *end++ = i < count ? digits[i] : '0';
    }
    if (count <= before_point) *end++ = '.', *end++ = '0';
    *end = '\0';
    return out;
}

char *text_general(char out[NUMBER_SIZE], int digits, double value) {
    const char *word = not_finite(value);
    if (word) return strcpy(out, word);
    snprintf(out, NUMBER_SIZE, "%.*g", digits, value);
    for (char *at = out; *at; at++)
        if (!strchr("0123456789+-e", *at)) *at = '.';
    return out;
}

/* Bytes of the UTF-8 character at ``text``; 0: there is none. */
static int character_size(const char *text) {
    unsigned char first = (unsigned char)*text;
    int size = first < 0x80 ? 1 : first < 0xC2 ? 0 : first < 0xE0 ? 2 : first < 0xF0 ? 3 : 4;
    if (first >= 0xF5) return 0;
    for (int i = 1; i < size; i++)
        if (((unsigned char)text[i] & 0xC0) != 0x80) return 0;
    return size;
}

char *text_quoted(char out[QUOTED_SIZE], const char *text) {
    static const char more[] = "...";
    char *end = out, *last = out + QUOTED_SIZE - sizeof more - 1;
    *end++ = '\'';
    while (*text) {
        int size = character_size(text), bytes = size ? size : 1;
        if (end + bytes > last) {
            strcpy(end, more);
            end += strlen(more);
            break;
        }
        if (size) memcpy(end, text, (size_t)size);
        else *end = '?';
        end += bytes;
        text += bytes;
    }
    *end++ = '\'';
    *end = '\0';
    return out;
}
