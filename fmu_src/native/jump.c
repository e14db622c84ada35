/* A jump of the trolley's velocity; see jump.h. */

#include "jump.h"

/* Frequency of the payload's bounce on the chain, rad/s. */
static double bounce(const Settings *p) {
    return sqrt(p->chain_EA / (p->chain_length * (p->payload_mass + p->chain_mass / 3.0)));
}

/* x^4, x = omega_1 JUMP_TIME, omega_1 the bounce. */
static double stiffness_number(const Settings *p) {
    double x = bounce(p) * JUMP_TIME;
    return x * x * x * x;
}

/* T, s, of a crane: JUMP_TIME x^4/(1 + x^4). */
static double filter_time(const Chain *c) {
    double x4 = stiffness_number(&c->settings);
    return JUMP_TIME * x4 / (1.0 + x4);
}

/* Speed of an axial wave, m/s: sqrt(EA L/m). */
static double wave_speed(const Settings *p) {
    return sqrt(p->chain_EA * p->chain_length / p->chain_mass);
}

double wave_step(const Chain *c) {
    double x4 = stiffness_number(&c->settings);
    return WAVE_STEP * c->L0 / wave_speed(&c->settings) + JUMP_TIME * x4 * (1.0 + x4);
}

double wave_time(const Chain *c, double dv) {
    const Settings *p = &c->settings;
    double speed = wave_speed(p), pull = fabs(dv) * speed * p->chain_mass / p->chain_length;
    if (pull < WAVE_SHARE * p->gravity * c->total_mass) return 0.0;
    return smaller(WAVE_TURN / bounce(p), WAVE_TRAVELS * p->chain_length / speed);
}

/* M_ff dw = -b dv into work->unknown. */
static void impulse(Workspace *work, double dv) {
    const Chain *c = &work->chain;
    Vector *dw = work->unknown;
    for (int i = 0; i < c->n; i++) dw[i] = (Vector){-row_mass(c, i) * dv, 0.0};
    mass_solve(c, work->l0, dw);
}

static void add(Vector *w, const Vector *dw, int n) {
    for (int i = 0; i < n; i++) w[i] = (Vector){w[i].x + dw[i].x, w[i].y + dw[i].y};
}

int plain_jump(Workspace *work, Motion *motion, const Command *command, double trolley_v,
               double dv) {
    (void)command, (void)trolley_v;
    impulse(work, dv);
    add(motion->w, work->unknown, work->chain.n);
    return 0;
}

/* Unit vectors of the elements into work->d0, lengths into work->l0, and the filter's factors. */
static void prepare_filter(Workspace *work, const Motion *motion, double stiffness) {
    const Chain *c = &work->chain;
    for (int e = 0; e < c->n; e++) {
        Vector d = along(motion->r, e);
        double length = norm(d);
        Vector unit = {d.x / length, d.y / length};
        work->l0[e] = length;
        work->d0[e] = unit;
        work->banded.tangent[e] = (Block){stiffness * unit.x * unit.x, stiffness * unit.x * unit.y,
                                          stiffness * unit.y * unit.x, stiffness * unit.y * unit.y};
    }
    factor(&work->banded, c, 1.0); /* M and what is added are positive definite */
}

int filtered_jump(Workspace *work, Motion *motion, const Command *command, double trolley_v,
                  double dv) {
    const Chain *c = &work->chain;
    int n = c->n;
    double T = filter_time(c), stiffness = T * T * c->axial, air = c->settings.damping_air;
    Vector *dw = work->unknown, *other = work->moved;
    double *tension = work->end.tension, *turning = work->lag;
    impulse(work, dv);
    prepare_filter(work, motion, stiffness);
    for (int pass = 0; pass < JUMP_PASSES; pass++) {
        for (int i = 0; i < n; i++) other[i] = mass_times(c, dw, i);
        for (int i = 0; i < n; i++) dw[i] = other[i];
        solve(&work->banded, n, dw);
    }
    add(motion->w, dw, n);
    for (int e = 0; e < n; e++) {
        double across = cross(work->d0[e], along(motion->w, e));
        turning[e] = across * across / work->l0[e];
        tension[e] = axial_force(c, work->l0[e]);
    }
    Vector *a = work->moved;
    for (int pass = 0; pass < JUMP_PASSES; pass++) {
        for (int i = 0; i < n; i++) {
            Vector drag = mass_times(c, motion->w, i);
            double pull = tension[i] + stiffness * turning[i];
            a[i] = minus(applied_force(c, command, trolley_v, i),
                         (Vector){air * drag.x, air * drag.y});
            a[i] = minus(a[i], (Vector){pull * work->d0[i].x, pull * work->d0[i].y});
            if (i) {
                a[i - 1].x += pull * work->d0[i].x;
                a[i - 1].y += pull * work->d0[i].y;
            }
        }
        solve(&work->banded, n, a);
        for (int e = 0; e < n; e++)
            tension[e] += stiffness * (dot(work->d0[e], along(a, e)) + turning[e]);
    }
    return 1;
}

void settled(Workspace *work, const Motion *motion, double share) {
    const Chain *c = &work->chain;
    const Motion *end = &work->end;
    Vector moved = {0.0, 0.0}, turned = {0.0, 0.0};
    for (int e = 0; e < c->n; e++) {
        Vector d = along(motion->r, e), dw = along(motion->w, e);
        double length = norm(d), now = axial_force(c, length);
        double new = hanging_length(c, now + share * (end->tension[e] - now));
        Vector unit = {d.x / length, d.y / length};
        double rate = dot(unit, dw), slower = length / new, longer = new - length;
        Vector axial = {rate * unit.x, rate * unit.y};
        moved = (Vector){moved.x + unit.x * longer, moved.y + unit.y * longer};
        turned = (Vector){turned.x + (axial.x + (dw.x - axial.x) * slower),
                          turned.y + (axial.y + (dw.y - axial.y) * slower)};
        end->r[e] = (Vector){motion->r[e].x + moved.x, motion->r[e].y + moved.y};
        end->w[e] = turned;
    }
}
