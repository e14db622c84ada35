/* Values of inputs and parameters; see start_values.h. */

#include "start_values.h"

#include <stdio.h>
#include <string.h>

#include "text.h"

static int is_finite(double value) { return value - value == 0.0; }

void take_start_values(Values *values) {
    memset(values, 0, sizeof *values);
    values->tolerance = NAN;
    for (int i = 0; i < SETTABLE; i++) {
        values->number[i] = VARIABLE[i].start;
        if (VARIABLE[i].kind == STRING)
            strcpy(values->text[VARIABLE[i].text], VARIABLE[i].start_text);
    }
}

void not_allowed(char message[MESSAGE_SIZE], const char *name, const char *value,
                 const char *allowed) {
    snprintf(message, MESSAGE_SIZE, "%s = %s is not allowed: %s", name, value, allowed);
}

void bad_number(char message[MESSAGE_SIZE], const char *name, double value, const char *allowed) {
    char number[NUMBER_SIZE];
    not_allowed(message, name, text_repr(number, value), allowed);
}

/* Place of a text among those that are allowed; -1 if it is none of them. */
static int choice(const Values *values, int variable) {
    const char *const *choices = VARIABLE[variable].choices;
    for (int i = 0; choices[i]; i++)
        if (strcmp(values->text[VARIABLE[variable].text], choices[i]) == 0) return i;
    return -1;
}

/* parameters.py: EA, N, whose tension moves by a thousandth of the weight with a position's last
   digit. */
static double stiffest(const double *number) {
    double weight = number[VR_GRAVITY] * (number[VR_CHAIN_MASS] + number[VR_PAYLOAD_MASS]);
    return UNSTEADY * weight / (LAST_DIGIT * number[VR_CHAIN_ELEMENTS]);
}

static int too_stiff(const Values *values, char message[MESSAGE_SIZE]) {
    const double *number = values->number;
    char most[NUMBER_SIZE], allowed[NUMBER_SIZE + 64];
    if (choice(values, VR_CHAIN_FORMULATION) != CHAIN_FORMULATION_TRUSS) return 0;
    if (!(stiffest(number) < number[VR_CHAIN_EA])) return 0;
    snprintf(allowed, sizeof allowed,
             "at most %s N: beyond, round-off outweighs these masses and elements",
             text_general(most, 3, stiffest(number)));
    bad_number(message, VARIABLE[VR_CHAIN_EA].name, number[VR_CHAIN_EA], allowed);
    return 1;
}

/* What chain.formulation = inextensible does not take. */
static int not_inextensible(const Values *values, char message[MESSAGE_SIZE]) {
    static const char *const words = "with chain.formulation = inextensible";
    const double *number = values->number;
    double most = MAX_MASS_RATIO * number[VR_CHAIN_MASS];
    char text[NUMBER_SIZE], allowed[NUMBER_SIZE + 64];
    if (choice(values, VR_CHAIN_FORMULATION) != CHAIN_FORMULATION_INEXTENSIBLE) return 0;
    if (number[VR_CHAIN_ELEMENTS] > MAX_POINTS) {
        snprintf(allowed, sizeof allowed, "at most %d %s", MAX_POINTS, words);
        snprintf(text, sizeof text, "%.0f", number[VR_CHAIN_ELEMENTS]);
        not_allowed(message, VARIABLE[VR_CHAIN_ELEMENTS].name, text, allowed);
        return 1;
    }
    if (!(number[VR_PAYLOAD_MASS] > most)) return 0;
    snprintf(allowed, sizeof allowed, "at most %s kg %s", text_general(text, 3, most), words);
    bad_number(message, VARIABLE[VR_PAYLOAD_MASS].name, number[VR_PAYLOAD_MASS], allowed);
    return 1;
}

static int asks_for_experiment(const Values *values) {
    return choice(values, VR_SOLVER_TOLERANCE_FROM) == SOLVER_TOLERANCE_FROM_EXPERIMENT;
}

/* interface.py: the experiment's tolerance where it is asked for. */
static int bad_tolerance(const Values *values, char message[MESSAGE_SIZE]) {
    double relative = values->tolerance;
    char number[NUMBER_SIZE];
    if (!asks_for_experiment(values) || (relative > 0.0 && relative < 1.0)) return 0;
    not_allowed(message, "tolerance of the experiment",
                relative == relative ? text_repr(number, relative) : "None",
                EXPERIMENT_TOLERANCE_ALLOWED);
    return 1;
}

int bad_parameter(const Values *values, char message[MESSAGE_SIZE]) {
    for (int i = INPUTS; i < SETTABLE; i++) {
        const Variable *variable = &VARIABLE[i];
        double value = values->number[i];
        char text[QUOTED_SIZE];
        if (variable->kind == STRING) {
            if (choice(values, i) >= 0) continue;
            text_quoted(text, values->text[variable->text]);
        } else {
            if (is_finite(value) && value >= variable->minimum && value <= variable->maximum) {
                if (i == VR_CHAIN_ELEMENTS && too_stiff(values, message)) return 1;
                continue;
            }
            if (variable->kind == INTEGER) snprintf(text, sizeof text, "%.0f", value);
            else text_repr(text, value);
        }
        not_allowed(message, variable->name, text, variable->allowed);
        return 1;
    }
    return not_inextensible(values, message) || bad_tolerance(values, message);
}

Settings settings_of(const Values *values) {
    Settings settings;
    double *member = (double *)&settings;
    for (int i = INPUTS; i < SETTABLE; i++) {
        int text = VARIABLE[i].kind == STRING;
        member[i - INPUTS] = text ? choice(values, i) : values->number[i];
    }
    if (asks_for_experiment(values))
        settings.solver_tolerance = values->tolerance * settings.chain_length;
    return settings;
}
