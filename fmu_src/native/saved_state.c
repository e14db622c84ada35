/* An instance's whole state as bytes; see saved_state.h.

   Layout: magic, checksum of what follows, model, sources, count of the model's doubles, phase,
   time, the experiment's tolerance, values, slopes, texts, the model's state. */

#include "saved_state.h"

#include <stdint.h>
#include <stdio.h>
#include <string.h>

enum { WORD = 8, MODEL_SIZE = 32, SOURCES_SIZE = 64 };

static const char MAGIC[2 * WORD + 1] = "chaincrane C  1\n";

enum {
    CHECKSUM_AT = 2 * WORD,
    MODEL_AT = CHECKSUM_AT + WORD,
    SOURCES_AT = MODEL_AT + MODEL_SIZE,
    COUNT_AT = SOURCES_AT + SOURCES_SIZE,
    PHASE_AT = COUNT_AT + WORD,
    TIME_AT = PHASE_AT + WORD,
    TOLERANCE_AT = TIME_AT + WORD,
    VALUES_AT = TOLERANCE_AT + WORD,
    SLOPES_AT = VALUES_AT + SETTABLE * WORD,
    TEXTS_AT = SLOPES_AT + INPUTS * WORD,
    STATE_AT = TEXTS_AT + STRINGS * TEXT_SIZE
};

static void put_word(unsigned char *at, uint64_t word) {
    for (int i = 0; i < WORD; i++) at[i] = (unsigned char)(word >> (8 * i));
}

static uint64_t get_word(const unsigned char *at) {
    uint64_t word = 0;
    for (int i = 0; i < WORD; i++) word |= (uint64_t)at[i] << (8 * i);
    return word;
}

static void put_doubles(unsigned char *at, const double *values, size_t count) {
    for (size_t i = 0; i < count; i++) {
        uint64_t word;
        memcpy(&word, &values[i], WORD);
        put_word(at + i * WORD, word);
    }
}

void read_doubles(const unsigned char *bytes, double *values, size_t count) {
    for (size_t i = 0; i < count; i++) {
        uint64_t word = get_word(bytes + i * WORD);
        memcpy(&values[i], &word, WORD);
    }
}

/* FNV-1a, 64 bits. */
static uint64_t checksum(const unsigned char *bytes, size_t size) {
    uint64_t sum = 0xcbf29ce484222325u;
    for (size_t i = 0; i < size; i++) sum = (sum ^ bytes[i]) * 0x100000001b3u;
    return sum;
}

size_t saved_size(size_t model_count) { return STATE_AT + model_count * WORD; }

void save_state(const Snapshot *snapshot, const double *model, size_t model_count,
                unsigned char *bytes) {
    const Values *values = &snapshot->values;
    memset(bytes, 0, STATE_AT);
    memcpy(bytes, MAGIC, CHECKSUM_AT);
    memcpy(bytes + MODEL_AT, MODEL_IDENTIFIER, strlen(MODEL_IDENTIFIER));
    memcpy(bytes + SOURCES_AT, MODEL_SOURCES, SOURCES_SIZE);
    put_word(bytes + COUNT_AT, model_count);
    put_word(bytes + PHASE_AT, (uint64_t)snapshot->phase);
    put_doubles(bytes + TIME_AT, &snapshot->time, 1);
    put_doubles(bytes + TOLERANCE_AT, &values->tolerance, 1);
    put_doubles(bytes + VALUES_AT, values->number, SETTABLE);
    put_doubles(bytes + SLOPES_AT, values->slope, INPUTS);
    memcpy(bytes + TEXTS_AT, values->text, sizeof values->text);
    put_doubles(bytes + STATE_AT, model, model_count);
    size_t size = saved_size(model_count) - MODEL_AT;
    put_word(bytes + CHECKSUM_AT, checksum(bytes + MODEL_AT, size));
}

const char *load_state(const unsigned char *bytes, size_t size, Snapshot *snapshot,
                       const unsigned char **model, size_t *model_count, char foreign[256]) {
    if (size < STATE_AT || memcmp(bytes, MAGIC, CHECKSUM_AT) != 0 ||
        get_word(bytes + CHECKSUM_AT) != checksum(bytes + MODEL_AT, size - MODEL_AT) ||
        (size - STATE_AT) % WORD != 0 || get_word(bytes + COUNT_AT) != (size - STATE_AT) / WORD)
        return "the saved state is damaged, or not a chaincrane state";
    const char *name = (const char *)bytes + MODEL_AT, *sources = (const char *)bytes + SOURCES_AT;
    if (strncmp(name, MODEL_IDENTIFIER, MODEL_SIZE) != 0 ||
        memcmp(sources, MODEL_SOURCES, SOURCES_SIZE) != 0) {
        snprintf(foreign, 256, "the saved state is of %.*s, sources %.*s; this is %s, sources %s",
                 MODEL_SIZE, name, SOURCES_SIZE, sources, MODEL_IDENTIFIER, MODEL_SOURCES);
        return foreign;
    }
    Values *values = &snapshot->values;
    snapshot->phase = (int)get_word(bytes + PHASE_AT);
    read_doubles(bytes + TIME_AT, &snapshot->time, 1);
    read_doubles(bytes + TOLERANCE_AT, &values->tolerance, 1);
    read_doubles(bytes + VALUES_AT, values->number, SETTABLE);
    read_doubles(bytes + SLOPES_AT, values->slope, INPUTS);
    memcpy(values->text, bytes + TEXTS_AT, sizeof values->text);
    for (int i = 0; i < STRINGS; i++) values->text[i][TEXT_SIZE - 1] = '\0';
    *model = bytes + STATE_AT;
    *model_count = (size - STATE_AT) / WORD;
    return NULL;
}
