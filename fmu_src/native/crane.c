/* What both cranes share; see crane.h. */

#include "crane.h"

#include <string.h>

/* ---- trolley.py ---- */

double equal_parts(double h, double longest) {
    return larger(1.0, ceil(h / longest * (1.0 - WHOLE)));
}

double commanded(const SharedState *now, const Command *command) {
    return command->trolley_v_cmd + now->trolley_gained;
}

int is_allowed(const SharedState *now, const Settings *settings, double h, const Command *command) {
    const double *input = (const double *)command;
    SharedState after = *now;
    for (int i = 0; i < INPUTS; i++)
        if (!is_finite(input[i])) return 0;
    if (!(h > 0.0 && h <= MAX_INTERNAL_STEPS * settings->solver_max_step)) return 0;
    move_trolley(&after, h, command);
    return is_finite(after.trolley_x) && is_finite(after.trolley_v);
}

void move_trolley(SharedState *state, double h, const Command *command) {
    double v = commanded(state, command), a = command->trolley_a_cmd;
    state->trolley_x = state->trolley_x + h * v + 0.5 * h * h * a;
    state->trolley_gained += h * a;
    state->trolley_v = command->trolley_v_cmd + state->trolley_gained;
}

/* ---- ledger.py ---- */

double expected_energy(const SharedState *state) {
    return state->ledger_start + state->ledger_trolley + state->ledger_payload -
           state->ledger_dissipated;
}

/* ---- crane.py ---- */

void shared_outputs(const SharedState *state, const Posture *posture, double energy,
                    Outputs *outputs) {
    Outputs *o = outputs;
    Vector payload = posture->payload, node1 = posture->node1;
    for (int i = 0; i < OUTPUTS; i++) ((double *)o)[i] = NAN;
    o->trolley_x = state->trolley_x;
    o->trolley_v = state->trolley_v;
    o->trolley_impulse = state->trolley_impulse;
    o->payload_x = state->trolley_x + payload.x;
    o->payload_y = payload.y;
    o->payload_vx = state->trolley_v + posture->payload_w.x;
    o->payload_vy = posture->payload_w.y;
    o->payload_x_rel = payload.x;
    o->payload_sway_angle = atan2(payload.x, -payload.y);
    o->chain_mid_x_rel = posture->points[MATERIAL_POINTS].x;
    o->chain_top_angle = atan2(node1.x, -node1.y);
    for (int i = 0; i < MATERIAL_POINTS; i++) {
        o->chain_x[i] = state->trolley_x + posture->points[i].x;
        o->chain_y[i] = posture->points[i].y;
    }
    o->energy_total = energy;
    o->energy_dissipated = state->ledger_dissipated;
    o->energy_error = energy - expected_energy(state);
    o->solver_steps = state->steps;
    o->solver_iterations = state->iterations;
}

int are_finite(const Outputs *outputs) {
    int strange = 0; /* no early end: a loop for vectors */
    for (int i = 0; i < OUTPUTS; i++) strange |= !is_finite(((const double *)outputs)[i]);
    return !strange;
}

size_t save_plain(const double *own, size_t count, double *state) {
    if (state) memcpy(state, own, count * sizeof(double));
    return count;
}

int load_plain(double *own, size_t own_count, const double *state, size_t count) {
    if (count != own_count) return 0;
    memcpy(own, state, count * sizeof(double));
    return 1;
}
