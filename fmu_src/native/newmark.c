/* The paper's scheme, Newmark's average acceleration, steps I to VI; see newmark.h. */

#include "newmark.h"

#include <string.h>

#include "jump.h"

/* Axial force with the chain's damping, N. */
static double axial(const Chain *c, Vector d, double length, Vector dw) {
    double tau = c->settings.damping_chain, force = axial_force(c, length);
    return tau == 0.0 ? force : force + c->axial * tau * dot(d, dw) / length;
}

/* applied - M a - C w - f_sigma, (21), into work->unknown; ``a`` may be NULL. */
static void residual(Workspace *work, const Load *load, double trolley_v, const Vector *r,
                     const Vector *w, const Vector *a) {
    const Chain *c = &work->chain;
    double air = c->settings.damping_air;
    Vector *unknown = work->unknown;
    for (int i = 0; i < c->n; i++) {
        Vector d = along(r, i), out = applied_force(c, &load->command, trolley_v, i);
        double length = norm(d), pull = axial(c, d, length, along(w, i)) / length;
        out = minus(out, (Vector){pull * d.x, pull * d.y});
        if (a) out = minus(out, mass_times(c, a, i));
        if (air != 0.0) {
            Vector drag = mass_times(c, w, i);
            out = minus(out, (Vector){air * drag.x, air * drag.y});
        }
        unknown[i] = out;
        if (i) {
            unknown[i - 1].x += pull * d.x;
            unknown[i - 1].y += pull * d.y;
        }
    }
}

/* Horizontal force of the drive on the chain, N: node 0's row of dynamic equilibrium. */
static double trolley_force(const Chain *c, const Motion *motion, const Vector *a,
                            const Command *command, double trolley_v) {
    Vector r = motion->r[0], w = motion->w[0];
    int last = c->n - 1;
    double air = c->settings.damping_air, length = norm(r);
    double node1 = a[0].x + air * w.x, payload = a[last].x + air * motion->w[last].x;
    double carried = carried_force(c, command, trolley_v, node1, payload);
    return carried - axial(c, r, length, w) * r.x / length;
}

/* What the damping takes in a step, J: mean of its forces at both ends times the path. */
static double damping_work(Workspace *work, const Motion *from, double v0, double v1,
                           double trolley_dx) {
    const Chain *c = &work->chain;
    const Motion *end = &work->end;
    double taken = 0.0, air = c->settings.damping_air, v = 0.5 * (v0 + v1);
    Vector *mean = work->unknown;
    if (c->settings.damping_chain != 0.0) {
        for (int e = 0; e < c->n; e++) {
            Vector d0 = along(from->r, e), d1 = along(end->r, e), path = minus(d1, d0);
            double l0 = norm(d0), l1 = norm(d1);
            double pull0 = (axial(c, d0, l0, along(from->w, e)) - axial_force(c, l0)) / l0;
            double pull1 = (axial(c, d1, l1, along(end->w, e)) - axial_force(c, l1)) / l1;
            taken += 0.5 * (pull0 * dot(d0, path) + pull1 * dot(d1, path));
        }
    }
    if (air != 0.0) {
        double friction = 0.0, row_path = 0.0, momentum = c->total_mass * v;
        for (int i = 0; i < c->n; i++)
            mean[i] =
                (Vector){0.5 * (from->w[i].x + end->w[i].x), 0.5 * (from->w[i].y + end->w[i].y)};
        for (int i = 0; i < c->n; i++) {
            Vector path = minus(end->r[i], from->r[i]);
            friction += dot(path, mass_times(c, mean, i));
            row_path += row_mass(c, i) * path.x;
            momentum += row_mass(c, i) * mean[i].x;
        }
        taken += air * (friction + v * row_path + momentum * trolley_dx);
    }
    return taken;
}

/* Step VI, (24)-(26), done; the step's energy terms by the trapezoidal rule. */
static void step_result(Workspace *work, const Motion *from, const Load *load, double h,
                        StepResult *result) {
    const Chain *c = &work->chain;
    const Motion *end = &work->end;
    const Command *command = &load->command;
    double v0 = load->trolley_v, v1 = trolley_v_after(load, h), trolley_dx = 0.5 * h * (v0 + v1);
    double before = trolley_force(c, from, work->a0, command, v0);
    double after = trolley_force(c, end, end->a, command, v1);
    for (int e = 0; e < c->n; e++) {
        Vector d = along(end->r, e);
        end->tension[e] = axial(c, d, norm(d), along(end->w, e));
    }
    Vector moved = minus(end->r[c->n - 1], from->r[c->n - 1]);
    result->trolley_fx = after;
    result->work_trolley = 0.5 * (before + after) * trolley_dx;
    result->work_payload = payload_work(command, moved, trolley_dx);
    result->dissipated = damping_work(work, from, v0, v1, trolley_dx);
}

static Outcome step(Workspace *work, const Motion *from, const Load *load, double h,
                    StepResult *result) {
    const Chain *c = &work->chain;
    const Settings *p = &c->settings;
    const Motion *end = &work->end;
    int n = c->n;
    size_t nodes = (size_t)n * sizeof(Vector);

    /* I. accelerations from dynamic equilibrium, M a = f - f_sigma - C v */
    if (!is_nan(from->a[0].x)) {
        memcpy(work->a0, from->a, nodes);
    } else {
        residual(work, load, load->trolley_v, from->r, from->w, NULL);
        mass_solve(c, work->l0, work->unknown); /* l0 is free in this scheme, and d0 */
        memcpy(work->a0, work->unknown, nodes);
    }

    /* II. effective stiffness (15), kept through the iterations; 2/h C for the damping */
    for (int e = 0; e < n; e++) {
        Vector d = along(from->r, e);
        Block T = element_tangent(c, d);
        if (p->damping_chain != 0.0) {
            double viscous = 2.0 / h * p->chain_EA * p->damping_chain / c->L0 / dot(d, d);
            T.xx += viscous * d.x * d.x;
            T.xy += viscous * d.x * d.y;
            T.yx += viscous * d.y * d.x;
            T.yy += viscous * d.y * d.y;
        }
        work->banded.tangent[e] = T;
    }
    if (!factor(&work->banded, c, 4.0 / (h * h) + 2.0 / h * p->damping_air)) return SINGULAR;

    /* III-IV. effective load (16) and a first increment (17); V. iteration (18)-(23) */
    double v1 = trolley_v_after(load, h), correction2 = 0.0, first = 0.0;
    double force_tolerance =
        FORCE_TOLERANCE * p->gravity * c->total_mass + FORCE_ROUND_OFF * p->chain_EA * n;
    Vector *increment = work->d0;
    memset(increment, 0, nodes);
    for (int iteration = 0; iteration <= MOST_NEWMARK_ITERATIONS; iteration++) {
        result->iterations = iteration;
        double size2 = 0.0, unbalanced = 0.0;
        for (int i = 0; i < n; i++) {
            Vector q = increment[i], w = from->w[i], a = work->a0[i];
            end->a[i] = (Vector){4.0 / (h * h) * q.x - 4.0 / h * w.x - a.x,
                                 4.0 / (h * h) * q.y - 4.0 / h * w.y - a.y}; /* (18) */
            end->w[i] = (Vector){2.0 / h * q.x - w.x, 2.0 / h * q.y - w.y};  /* (19) */
            end->r[i] = (Vector){from->r[i].x + q.x, from->r[i].y + q.y};    /* (20) */
            size2 += dot(end->r[i], end->r[i]);
        }
        residual(work, load, v1, end->r, end->w, end->a); /* (21) */
        if (iteration) {
            double moved = sqrt(correction2) / sqrt(size2);
            for (int i = 0; i < n; i++) {
                Vector f = work->unknown[i];
                unbalanced = larger(unbalanced, larger(fabs(f.x), fabs(f.y)));
                if (!is_finite(f.x + f.y)) return NOT_CONVERGED;
            }
            if (moved <= DISPLACEMENT_TOLERANCE && unbalanced <= force_tolerance) {
                step_result(work, from, load, h, result);
                return DONE;
            }
            if (iteration == 1) first = moved;
            if (!(moved < 1.0) || (iteration == LOOKED_BACK_AT && moved > SHRUNK * first))
                return NOT_CONVERGED;
        }
        solve(&work->banded, n, work->unknown); /* (17), (22) */
        correction2 = 0.0;
        for (int i = 0; i < n; i++) {
            correction2 += dot(work->unknown[i], work->unknown[i]);
            increment[i].x += work->unknown[i].x; /* (23) */
            increment[i].y += work->unknown[i].y;
        }
    }
    return NOT_CONVERGED;
}

const Scheme NEWMARK_SCHEME = {plain_jump, step};
