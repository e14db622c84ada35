/* The energy-momentum scheme; see energy_momentum.h. */

#include "energy_momentum.h"

#include "jump.h"

/* An element's force on its lower node over a step, its derivative, and its tension. */
typedef struct {
    Vector pull;
    Block tangent;
    double tension;
} ElementForce;

/* The chain's own damping, on the stretch, and the scheme's, on its change between steps: the viscous
   tension is eta (l1 - l0) - lag. Sets the lags; eta, N/m. */
static double viscosity_of(Workspace *work, const Motion *from, double h) {
    const Chain *c = &work->chain;
    double again = from->last_h > 0.0 ? smaller(1.0, h / from->last_h) : 0.0;
    for (int e = 0; e < c->n; e++)
        work->lag[e] = c->axial * AXIAL_DISSIPATION * (again * from->stretched[e]);
    return c->axial * (c->settings.damping_chain / h + AXIAL_DISSIPATION);
}

/* pull = k (d0 + d1)/2, k = [EA/L0 (l0 + l1 - 2 L0) + 2 V]/(l0 + l1), V the viscous tension. */
static inline ElementForce element_force(const Workspace *work, double eta, int e) {
    const Chain *c = &work->chain;
    ElementForce f;
    Vector d0 = work->d0[e], d1 = work->d1[e];
    double l0 = work->l0[e], l1 = norm(d1), total = l0 + l1;
    f.tension = 0.5 * (axial_force(c, l0) + axial_force(c, l1)) + (eta * (l1 - l0) - work->lag[e]);
    double stiffness = 2.0 * f.tension / total;
    double slope = (c->axial + 2.0 * eta - stiffness) / (total * l1);
    Vector middle = {0.5 * (d0.x + d1.x), 0.5 * (d0.y + d1.y)};
    f.pull = (Vector){stiffness * middle.x, stiffness * middle.y};
    f.tangent = (Block){slope * middle.x * d1.x + 0.5 * stiffness, slope * middle.x * d1.y,
                        slope * middle.y * d1.x, slope * middle.y * d1.y + 0.5 * stiffness};
    return f;
}

/* An element's vector turned by about ``angle`` and stretched by ``factor``, exact in length:
   the turn is 2 atan(angle/2), which is what the scheme itself makes of a steady rotation. */
static inline Vector turned(Vector d, double angle, double factor) {
    double t = 0.5 * angle, scale = factor / (1.0 + t * t);
    double cosine = (1.0 - t * t) * scale, sine = 2.0 * t * scale;
    return (Vector){cosine * d.x - sine * d.y, sine * d.x + cosine * d.y};
}

/* Stretch factor of element e that would leave its tension as it was in the last step. */
static inline double expected_stretch(const Workspace *work, const Motion *from, double eta,
                                      int e) {
    const Chain *c = &work->chain;
    double change = from->tension[e] - axial_force(c, work->l0[e]) + work->lag[e];
    double factor = 1.0 + change / ((0.5 * c->axial + eta) * work->l0[e]);
    return larger(factor, LEAST_STRETCH);
}

/* Velocities and the step's energy terms, once the positions at its end are known. */
static void step_result(Workspace *work, const Motion *from, const Load *load, double h, double eta,
                        StepResult *result) {
    const Chain *c = &work->chain;
    Motion *end = &work->end;
    const Vector *moved = work->moved;
    double air = c->settings.damping_air;
    double trolley_v = trolley_v_after(load, 0.5 * h), trolley_dx = h * trolley_v;
    double dissipated = 0.0;
    Vector top_pull = {0.0, 0.0};
    for (int i = 0; i < c->n; i++) {
        ElementForce f = element_force(work, eta, i);
        double stretch = norm(work->d1[i]) - work->l0[i];
        dissipated += (eta * stretch - work->lag[i]) * stretch;
        end->stretched[i] = stretch;
        end->tension[i] = f.tension;
        if (i == 0) top_pull = f.pull;
        end->w[i] =
            (Vector){2.0 / h * moved[i].x - from->w[i].x, 2.0 / h * moved[i].y - from->w[i].y};
    }
    int last = c->n - 1;
    double node1 = (end->w[0].x - from->w[0].x) / h + air * (moved[0].x / h);
    double payload = (end->w[last].x - from->w[last].x) / h + air * (moved[last].x / h);
    result->trolley_fx = carried_force(c, &load->command, trolley_v, node1, payload) - top_pull.x;
    result->work_trolley = result->trolley_fx * trolley_dx;
    result->work_payload = payload_work(&load->command, moved[last], trolley_dx);
    result->dissipated = dissipated;
    if (air != 0.0) {
        Vector *mean_w = work->unknown;
        for (int i = 0; i < c->n; i++) mean_w[i] = (Vector){moved[i].x / h, moved[i].y / h};
        result->dissipated += 2.0 * air * h * kinetic_energy(c, mean_w, trolley_v);
    }
}

/* Displacements of a step and positions at its end, from the element vectors.
   At rest they are 0 and r0 to the last digit, which sums of the vectors themselves are not. */
static void move_nodes(Workspace *work, const Motion *from) {
    Vector *moved = work->moved, sum = {0.0, 0.0};
    for (int e = 0; e < work->chain.n; e++) {
        Vector d0 = work->d0[e], d1 = work->d1[e];
        sum = (Vector){sum.x + (d1.x - d0.x), sum.y + (d1.y - d0.y)};
        moved[e] = sum;
        work->end.r[e] = (Vector){from->r[e].x + sum.x, from->r[e].y + sum.y};
    }
}

/* Out-of-balance forces of a step, from its displacements, into work->unknown; tangents, too. */
static void residual(Workspace *work, const Motion *from, const Load *load, double h, double eta,
                     double inertia) {
    const Chain *c = &work->chain;
    const Command command = load->command; /* a copy: nothing that is written can change it */
    double trolley_v = trolley_v_after(load, 0.5 * h);
    Vector *change = work->end.w, *unknown = work->unknown; /* w is free until the step is done */
    for (int i = 0; i < c->n; i++) {
        Vector moved = work->moved[i];
        change[i] = (Vector){inertia * moved.x - 2.0 / h * from->w[i].x,
                             inertia * moved.y - 2.0 / h * from->w[i].y};
    }
    for (int i = 0; i < c->n; i++) {
        ElementForce f = element_force(work, eta, i);
        Vector steady = applied_force(c, &command, trolley_v, i);
        work->banded.tangent[i] = f.tangent;
        unknown[i] = minus(minus(steady, mass_times(c, change, i)), f.pull);
        if (i) {
            unknown[i - 1].x += f.pull.x;
            unknown[i - 1].y += f.pull.y;
        }
    }
}

/* Turn and stretch the elements as a correction of the nodes asks; 0 where one would vanish. */
static int correct(const Vector *correction, Vector *d1, int n) {
    for (int e = 0; e < n; e++) {
        Vector d = d1[e], dd = along(correction, e);
        double over = 1.0 / dot(d, d), factor = 1.0 + dot(d, dd) * over;
        if (!(factor > LEAST_STRETCH)) return 0;
        d1[e] = turned(d, cross(d, dd) * over, factor);
    }
    return 1;
}

/* Largest component of a nodal quantity; not a number where one is not. */
static double size_of(const Vector *nodal, int n) {
    double size = 0.0;
    for (int i = 0; i < n; i++) {
        size = larger(size, larger(fabs(nodal[i].x), fabs(nodal[i].y)));
        if (!is_finite(nodal[i].x + nodal[i].y)) return NAN;
    }
    return size;
}

/* N/l of an element by its tension of the last step, N/m; none if it is slack. */
static inline double taut_stiffness(const Workspace *work, const Motion *from, int e) {
    return larger(from->tension[e], 0.0) / work->l0[e];
}

static inline Vector taut_pull(const Workspace *work, const Motion *from, int e) {
    double stiffness = taut_stiffness(work, from, e);
    return (Vector){stiffness * work->d0[e].x, stiffness * work->d0[e].y};
}

/* Mean velocity of a step in which each element keeps its tension, or none if it is slack:

       ((2/h + alpha) M + h/2 K) u = 2/h M w0 + f - b (a + alpha v) - F(k d0),  k_e = N_e/l_e

   in place by Thomas elimination: a taut string's matrix is positive definite. */
static const Vector *expected_velocity(Workspace *work, const Motion *from, const Load *load,
                                       double h) {
    const Chain *c = &work->chain;
    const Command command = load->command; /* a copy, as in residual */
    double trolley_v = trolley_v_after(load, 0.5 * h);
    double inertia = 2.0 / h + c->settings.damping_air;
    double coupling = 0.0, above = 0.0; /* matrix entry and factor between nodes i-1 and i */
    double *factor = work->end.tension; /* free until the step is done */
    Vector *u = work->unknown, pull = taut_pull(work, from, 0);
    double stiffness = taut_stiffness(work, from, 0);
    for (int i = 0; i < c->n; i++) {
        int end = i == c->n - 1;
        double below = end ? 0.0 : taut_stiffness(work, from, i + 1);
        Vector pull_below = end ? (Vector){0.0, 0.0} : taut_pull(work, from, i + 1);
        Vector steady = applied_force(c, &command, trolley_v, i);
        Vector f = minus(steady, minus(pull, pull_below));
        Vector momentum = mass_times(c, from->w, i), known = i ? u[i - 1] : (Vector){0.0, 0.0};
        double pivot = inertia * node_mass(c, i) + 0.5 * h * (stiffness + below) - coupling * above;
        u[i].x = (f.x + 2.0 / h * momentum.x - coupling * known.x) / pivot;
        u[i].y = (f.y + 2.0 / h * momentum.y - coupling * known.y) / pivot;
        coupling = inertia * c->coupling - 0.5 * h * below;
        factor[i] = above = coupling / pivot;
        stiffness = below;
        pull = pull_below;
    }
    for (int i = c->n - 2; i >= 0; i--)
        u[i] = (Vector){u[i].x - factor[i] * u[i + 1].x, u[i].y - factor[i] * u[i + 1].y};
    return u;
}

/* Element vectors expected at the step's end: they turn with that velocity and keep the tension. */
static void predict(Workspace *work, const Motion *from, const Load *load, double h, double eta) {
    int n = work->chain.n;
    for (int e = 0; e < n; e++) {
        work->d0[e] = along(from->r, e);
        work->l0[e] = norm(work->d0[e]);
    }
    const Vector *u = expected_velocity(work, from, load, h);
    for (int e = 0; e < n; e++) {
        double turn = h * cross(work->d0[e], along(u, e)) / (work->l0[e] * work->l0[e]);
        work->d1[e] = turned(work->d0[e], turn, expected_stretch(work, from, eta, e));
    }
}

/* M (w1 - w0)/h + alpha M (w0 + w1)/2 + F(r0, r1) = f - b (a + alpha v). */
static Outcome step(Workspace *work, const Motion *from, const Load *load, double h,
                    StepResult *result) {
    const Chain *c = &work->chain;
    const Settings *p = &c->settings;
    double eta = viscosity_of(work, from, h);
    double inertia = 2.0 / (h * h) + p->damping_air / h, length = p->chain_length, last = 0.0;
    predict(work, from, load, h, eta);
    for (int iteration = 1; iteration <= MOST_ITERATIONS; iteration++) {
        result->iterations = iteration;
        move_nodes(work, from);
        residual(work, from, load, h, eta, inertia);
        if (!factor_and_solve(&work->banded, c, inertia, work->unknown)) return NOT_CONVERGED;
        double size = size_of(work->unknown, c->n);
        if (!(size < length) || (iteration > 2 && size > DIVERGENCE * last) ||
            (size > STILL * length && !correct(work->unknown, work->d1, c->n)))
            return NOT_CONVERGED;
        if (size <= CORRECTION_TOLERANCE * length) {
            move_nodes(work, from);
            step_result(work, from, load, h, eta, result);
            work->end.last_h = h;
            return DONE;
        }
        last = size;
    }
    return NOT_CONVERGED;
}

const Scheme ENERGY_MOMENTUM_SCHEME = {filtered_jump, step};
