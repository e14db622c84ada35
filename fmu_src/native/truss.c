/* The paper's chain of truss elements as a formulation; see truss.h. */

#include "truss.h"

#include "jump.h"

static size_t memory(const Settings *settings) {
    (void)settings;
    return 0;
}

static void prepare(Workspace *work, void *none) {
    (void)none;
    Chain *c = &work->chain;
    straight_chain(c, 0.0, work->end.r);
    c->rest_potential = potential_energy(c, work->end.r);
}

static double longest_step(const Workspace *work) {
    (void)work;
    return INFINITY;
}

/* newmark keeps every axial vibration, whatever the step. */
static double waves_resolved(const Workspace *work) {
    int filters = work->chain.settings.solver_scheme == SOLVER_SCHEME_ENERGY_MOMENTUM;
    return filters ? wave_step(&work->chain) : INFINITY;
}

static double error_share(int slack) { return slack ? SLACK_SHARE : TAUT_SHARE; }

static void straight(Workspace *work, double sway_angle, Motion *motion) {
    const Chain *c = &work->chain;
    straight_chain(c, sway_angle, motion->r);
    for (int e = 0; e < c->n; e++) motion->tension[e] = axial_force(c, norm(along(motion->r, e)));
}

static double potential(const Workspace *work, const Vector *r) {
    return potential_energy(&work->chain, r);
}

static double energy(const Workspace *work, const Motion *motion, double trolley_v) {
    const Chain *c = &work->chain;
    return kinetic_energy(c, motion->w, trolley_v) + potential_energy(c, motion->r);
}

static double momentum(const Workspace *work, const Vector *w) {
    double sum = 0.0;
    for (int i = 0; i < work->chain.n; i++) sum += row_mass(&work->chain, i) * w[i].x;
    return sum;
}

/* Node 0's row of dynamic equilibrium. */
static double released_force(Workspace *work, const Motion *motion, double trolley_v) {
    static const Command idle;
    const Chain *c = &work->chain;
    int n = c->n, hangs = motion->r[n - 1].x == 0.0; /* in balance */
    double v = trolley_v;
    Vector *a = work->unknown;
    for (int i = 0; i < n; i++) {
        Vector d = along(motion->r, i), weight = {0.0, i < n - 1 ? c->inner_weight : c->end_weight};
        double pull = motion->tension[i] / norm(d);
        a[i] = applied_force(c, &idle, v, i);
        a[i] = minus(a[i], hangs ? weight : (Vector){pull * d.x, pull * d.y});
        if (i && !hangs) {
            a[i - 1].x += pull * d.x;
            a[i - 1].y += pull * d.y;
        }
    }
    mass_solve(c, work->l0, a);
    double carried = carried_force(c, &idle, v, a[0].x, a[n - 1].x);
    return carried - motion->tension[0] * motion->r[0].x / norm(motion->r[0]);
}

static void posture(const Workspace *work, const Motion *motion, Posture *posture) {
    const Chain *c = &work->chain;
    posture->node1 = motion->r[0];
    posture->payload = motion->r[c->n - 1];
    posture->payload_w = motion->w[c->n - 1];
    for (int i = 0; i < POINTS; i++) {
        double fraction = material_fraction(i);
        posture->points[i] = (Vector){interpolate(c, &motion->r->x, 2, fraction),
                                      interpolate(c, &motion->r->y, 2, fraction)};
    }
}

const Formulation TRUSS = {.memory = memory,
                           .prepare = prepare,
                           .longest_step = longest_step,
                           .wave_step = waves_resolved,
                           .step_energy_tolerance = STEP_ENERGY_TOLERANCE,
                           .error_share = error_share,
                           .straight = straight,
                           .potential = potential,
                           .energy = energy,
                           .momentum = momentum,
                           .released_force = released_force,
                           .posture = posture};
