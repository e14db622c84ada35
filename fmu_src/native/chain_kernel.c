/* The nonlinear crane's communication step; see chain_kernel.h.

   Source: Maourane & Szabo, Pollack Periodica 15(2), 2020, 82-93, section 2.1 (its numbers in
   brackets), with the corrections that documentation/EQUATIONS.md lists. Sketch, signs and units are at the top of
   chaincrane/chain.py. Nodes 1..n are entries 0..n-1 of an array; node 0 is the trolley. */

#include "chain_kernel.h"

#include <math.h>
#include <string.h>

/* energy_momentum.py */
static const double AXIAL_DISSIPATION = 0.05;
static const int EM_MAX_ITERATIONS = 12;
static const double EM_DISPLACEMENT_TOLERANCE = 1e-8;
static const double ROUND_OFF = 4e-16;
static const double DIVERGENCE = 3.0;
static const double LEAST_STRETCH = 0.1;
/* newmark.py */
static const int NEWMARK_MAX_ITERATIONS = 200;
static const int SLOW_ITERATION = 20;
static const double SLOW_SHARE = 1e-2;
static const double NEWMARK_DISPLACEMENT_TOLERANCE = 1e-6;
static const double NEWMARK_FORCE_TOLERANCE = 1e-8;
static const double NEWMARK_ROUND_OFF = 2e-16;
/* nonlinear.py */
static const int MAX_HALVINGS = 12;
static const double STEP_ENERGY_TOLERANCE = 1e-3;
static const double TOTAL_ENERGY_TOLERANCE = 5e-3;
static const double ROUND_OFF_ENERGY = 1e-9;
/* crane.py */
static const double MAX_INTERNAL_STEPS = 1e7;

typedef struct {
    double x, y;
} Vector;

typedef struct {
    double xx, xy, yx, yy;
} Block;

/* State: this header, then r (n), w (n), a (n) as x, y pairs, then the tension (n); all doubles, in
   the order of CraneModel.save(), so that a saved state fits both. */
typedef struct {
    double time;                                          /* s */
    double trolley_x, trolley_v, trolley_gained;          /* m, m/s, m/s */
    double steps, iterations;                             /* effort of the last step */
    double start, work_trolley, work_payload, dissipated; /* the ledger, J */
    double loaded, load_v, load_a, load_fx;               /* load of the last step, if loaded */
    double energy, scale;                                 /* J; what errors are measured against */
    double trolley_fx;                                    /* N */
} Header;

typedef struct {
    Header *head;
    Vector *r, *w, *a; /* relative to the trolley; a is not a number where it is not known */
    double *tension;
} State;

/* What drives the crane during a step: m/s at its start, m/s2, N. */
typedef struct {
    double trolley_v, trolley_a, payload_fx;
} Load;

/* Energy terms of a step that converged; its motion stands in the kernel's r1, w1, a1, tension1. */
typedef struct {
    double trolley_fx, work_trolley, work_payload, dissipated;
    int iterations;
} StepResult;

/* An element's force on its lower node over a step, its derivative, and its tension. */
typedef struct {
    Vector pull;
    Block tangent;
    double tension;
} ElementForce;

struct ChainKernel {
    ChainSettings settings;
    int n;
    double L0, axial;                          /* m, unstretched element; N/m, EA/L0 */
    double inner_mass, end_mass, coupling;     /* kg, mass matrix: diagonal, payload's, off */
    double inner_row, end_row;                 /* kg, its row sums */
    double inner_weight, end_weight;           /* N, upwards */
    double total_mass;                         /* kg, chain and payload */
    double rest_potential;                     /* J, potential energy of the rest position */
    State state, trial;                        /* committed, and during a communication step */
    Vector *r1, *w1, *a1;                      /* end of an internal step */
    double *tension1;
    Vector *a0, *d0, *d1, *moved;              /* its start; element vectors; displacements */
    double *l0;
    Vector *unknown;                           /* residual, then correction */
    Block *tangent;                            /* of the elements */
    Block *inverse, *lower, *upper;            /* of the matrix: P_i^-1, B_i, P_i^-1 B_(i+1) */
};

/* As math.h has them, but in no need of a C runtime's own functions. */
static inline int is_nan(double x) { return x != x; }

static inline int is_finite(double x) { return x - x == 0.0; }

/* ---- vectors and blocks ---- */

static inline Vector minus(Vector a, Vector b) { return (Vector){a.x - b.x, a.y - b.y}; }

static inline Block plus(Block a, Block b) {
    return (Block){a.xx + b.xx, a.xy + b.xy, a.yx + b.yx, a.yy + b.yy};
}

static inline double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y; }

static inline double cross(Vector a, Vector b) { return a.x * b.y - a.y * b.x; }

static inline double norm(Vector a) { return sqrt(a.x * a.x + a.y * a.y); }

static inline double larger(double a, double b) { return a > b ? a : b; }

/* Element e's difference of a nodal quantity; node 0's is zero. */
static inline Vector along(const Vector *nodal, int e) {
    return e ? minus(nodal[e], nodal[e - 1]) : nodal[0];
}

/* ---- chain.py ---- */

static inline double node_mass(const ChainKernel *k, int i) {
    return i < k->n - 1 ? k->inner_mass : k->end_mass;
}

static inline double row_mass(const ChainKernel *k, int i) {
    return i < k->n - 1 ? k->inner_row : k->end_row;
}

/* Axial force N = EA (l - L0)/L0, N, tension positive. */
static double axial_force(const ChainKernel *k, double length) {
    return k->axial * (length - k->L0);
}

/* K = EA/L0 c c^T + N/l (1 - c c^T), (12) in global axes, N/m. */
static Block element_tangent(const ChainKernel *k, Vector d) {
    double length = norm(d), elastic = k->axial;
    double geometric = axial_force(k, length) / length;
    Vector c = {d.x / length, d.y / length};
    double across = elastic - geometric;
    return (Block){geometric + across * c.x * c.x, across * c.x * c.y,
                   across * c.x * c.y, geometric + across * c.y * c.y};
}

/* Tension of an element in the hanging equilibrium, N: the payload and the chain below it. */
static double hanging_tension(const ChainKernel *k, int e) {
    int below = k->n - 1 - e;
    double element = k->settings.mass / k->n;
    return k->settings.gravity * (k->settings.payload_mass + element * (below + 0.5));
}

/* Positions, m, of the straight chain held at the sway angle, each element under N_e cos(angle). */
static void straight_chain(const ChainKernel *k, double sway_angle, Vector *r) {
    double along_chain = 0.0, sine = sin(sway_angle), cosine = cos(sway_angle);
    for (int e = 0; e < k->n; e++) {
        along_chain += k->L0 * (1.0 + hanging_tension(k, e) * cosine / k->settings.EA);
        r[e] = (Vector){along_chain * sine, -along_chain * cosine};
    }
}

/* Row i of M_ff times a nodal quantity, the free nodes' mass matrix (11). */
static inline Vector mass_times(const ChainKernel *k, const Vector *nodal, int i) {
    double own = node_mass(k, i);
    Vector product = {own * nodal[i].x, own * nodal[i].y};
    if (i > 0) {
        product.x += k->coupling * nodal[i - 1].x;
        product.y += k->coupling * nodal[i - 1].y;
    }
    if (i < k->n - 1) {
        product.x += k->coupling * nodal[i + 1].x;
        product.y += k->coupling * nodal[i + 1].y;
    }
    return product;
}

/* Kinetic energy, J; w relative, trolley_v in m/s. */
static double kinetic_energy(const ChainKernel *k, const Vector *w, double trolley_v) {
    double relative = 0.0, momentum = 0.0;
    for (int i = 0; i < k->n; i++) {
        relative += dot(w[i], mass_times(k, w, i));
        momentum += row_mass(k, i) * w[i].x;
    }
    return 0.5 * relative + trolley_v * momentum + 0.5 * k->total_mass * trolley_v * trolley_v;
}

/* Elastic energy and weight, J, above the rest position. */
static double potential_energy(const ChainKernel *k, const Vector *r) {
    double stretch2 = 0.0, weight = 0.0;
    for (int i = 0; i < k->n; i++) {
        double stretch = norm(along(r, i)) - k->L0;
        stretch2 += stretch * stretch;
        weight += (i < k->n - 1 ? k->inner_weight : k->end_weight) * r[i].y;
    }
    return 0.5 * k->axial * stretch2 - weight - k->rest_potential;
}

static double mechanical_energy(const ChainKernel *k, const Vector *r, const Vector *w, double v) {
    return kinetic_energy(k, w, v) + potential_energy(k, r);
}

/* M_ff x = load, in place: Thomas elimination, safe because M is diagonally dominant. */
static void mass_solve(ChainKernel *k, Vector *x) {
    double *factor = k->l0, c = k->coupling; /* l0 is free outside of a step */
    for (int i = 0; i < k->n; i++) {
        double pivot = node_mass(k, i);
        if (i) {
            pivot -= c * factor[i - 1];
            x[i].x -= c * x[i - 1].x;
            x[i].y -= c * x[i - 1].y;
        }
        factor[i] = c / pivot;
        x[i].x /= pivot;
        x[i].y /= pivot;
    }
    for (int i = k->n - 2; i >= 0; i--) {
        x[i].x -= factor[i] * x[i + 1].x;
        x[i].y -= factor[i] * x[i + 1].y;
    }
}

/* ---- banded.py: inertia M + elements' tangents, block-tridiagonal ---- */

static inline Vector times(Block b, Vector v) {
    return (Vector){b.xx * v.x + b.xy * v.y, b.yx * v.x + b.yy * v.y};
}

static inline Block product(Block a, Block b) {
    return (Block){a.xx * b.xx + a.xy * b.yx, a.xx * b.xy + a.xy * b.yy,
                   a.yx * b.xx + a.yy * b.yx, a.yx * b.xy + a.yy * b.yy};
}

/* Row i of the block elimination: P_i = D_i - B_i P_(i-1)^-1 B_i; 0 where P_i is singular.

   B_i = inertia m_c - T_i couples nodes i-1 and i; D_i = inertia m_i + T_i + T_(i+1). Each 2x2
   block is inverted by Cramer's rule, which is forward stable at that size (Higham, Accuracy and
   Stability of Numerical Algorithms, 1.10.1). No blocks are swapped: Newton's iteration mends what
   round-off that costs, and a matrix that is too far from definite ends in a halved step. */
static inline int factor_node(ChainKernel *k, double inertia, int i) {
    const Block *T = k->tangent;
    double own = inertia * node_mass(k, i), coupling = inertia * k->coupling;
    Block p = {own + T[i].xx, T[i].xy, T[i].yx, own + T[i].yy};
    if (i < k->n - 1) p = plus(p, T[i + 1]);
    if (i > 0) {
        Block b = {coupling - T[i].xx, -T[i].xy, -T[i].yx, coupling - T[i].yy};
        Block x = product(k->inverse[i - 1], b), bx = product(b, x);
        k->lower[i] = b;
        k->upper[i - 1] = x;
        p = (Block){p.xx - bx.xx, p.xy - bx.xy, p.yx - bx.yx, p.yy - bx.yy};
    }
    double over = 1.0 / (p.xx * p.yy - p.xy * p.yx);
    k->inverse[i] = (Block){p.yy * over, -p.xy * over, -p.yx * over, p.xx * over};
    return is_finite(over);
}

static void forward_node(const ChainKernel *k, Vector *x, int i) {
    if (i > 0) x[i] = minus(x[i], times(k->lower[i], x[i - 1]));
    x[i] = times(k->inverse[i], x[i]);
}

static void substitute_back(const ChainKernel *k, Vector *x) {
    for (int i = k->n - 2; i >= 0; i--) x[i] = minus(x[i], times(k->upper[i], x[i + 1]));
}

/* Factors of inertia M + the tangents, to be kept; 0 where it is singular. */
static int factor(ChainKernel *k, double inertia) {
    for (int i = 0; i < k->n; i++)
        if (!factor_node(k, inertia, i)) return 0;
    return 1;
}

/* Solve with the kept factors, in place. */
static void solve(const ChainKernel *k, Vector *x) {
    for (int i = 0; i < k->n; i++) forward_node(k, x, i);
    substitute_back(k, x);
}

/* Factor and solve in one pass, in place; 0 where the matrix is singular. */
static int factor_and_solve(ChainKernel *k, double inertia, Vector *x) {
    for (int i = 0; i < k->n; i++) {
        if (!factor_node(k, inertia, i)) return 0;
        forward_node(k, x, i);
    }
    substitute_back(k, x);
    return 1;
}

/* ---- energy_momentum.py ---- */

/* pull = k (d0 + d1)/2, k = [EA/L0 (l0 + l1 - 2 L0) + 2 eta (l1 - l0)]/(l0 + l1), eta in N/m. */
static inline ElementForce element_force(const ChainKernel *k, double viscosity, int e) {
    ElementForce f;
    Vector d0 = k->d0[e], d1 = k->d1[e];
    double l0 = k->l0[e], l1 = norm(d1), total = l0 + l1;
    f.tension = 0.5 * (axial_force(k, l0) + axial_force(k, l1)) + viscosity * (l1 - l0);
    double stiffness = 2.0 * f.tension / total;
    double slope = (k->axial + 2.0 * viscosity - stiffness) / (total * l1);
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
static inline double expected_stretch(const ChainKernel *k, const State *s, double viscosity,
                                      int e) {
    double change = s->tension[e] - axial_force(k, k->l0[e]);
    double factor = 1.0 + change / ((0.5 * k->axial + viscosity) * k->l0[e]);
    return larger(factor, LEAST_STRETCH);
}

/* Weight, payload force and the trolley's motion as a load on node i, N. */
static inline Vector applied(const ChainKernel *k, Load load, double trolley_v, int i) {
    double carried = load.trolley_a + k->settings.damping_air * trolley_v;
    if (i < k->n - 1) return (Vector){-k->inner_row * carried, k->inner_weight};
    return (Vector){load.payload_fx - k->end_row * carried, k->end_weight};
}

/* Velocities and the step's energy terms, once the positions r1 are known. */
static void em_result(ChainKernel *k, const State *s, Load load, double h, double viscosity,
                      StepResult *result) {
    double air = k->settings.damping_air;
    double trolley_v = load.trolley_v + 0.5 * h * load.trolley_a, trolley_dx = h * trolley_v;
    double stretch2 = 0.0;
    Vector top_pull = {0.0, 0.0};
    for (int i = 0; i < k->n; i++) {
        ElementForce f = element_force(k, viscosity, i);
        double stretch = norm(k->d1[i]) - k->l0[i];
        stretch2 += stretch * stretch;
        k->tension1[i] = f.tension;
        if (i == 0) top_pull = f.pull;
        Vector moved = k->moved[i];
        k->w1[i] = (Vector){2.0 / h * moved.x - s->w[i].x, 2.0 / h * moved.y - s->w[i].y};
    }
    double mean_w = k->moved[0].x / h;
    double node1_a = (k->w1[0].x - s->w[0].x) / h + air * mean_w;
    double row = 0.5 * k->inner_row;
    result->trolley_fx =
        row * (load.trolley_a + air * trolley_v) + k->coupling * node1_a - top_pull.x;
    result->work_trolley = result->trolley_fx * trolley_dx;
    result->work_payload =
        load.payload_fx * (k->moved[k->n - 1].x + trolley_dx);
    result->dissipated = viscosity * stretch2;
    if (air != 0.0) {
        for (int i = 0; i < k->n; i++)
            k->unknown[i] = (Vector){k->moved[i].x / h, k->moved[i].y / h};
        result->dissipated += 2.0 * air * h * kinetic_energy(k, k->unknown, trolley_v);
    }
}

/* Displacements of a step and positions r1 at its end, from the element vectors.
   At rest they are 0 and r0 to the last digit, which sums of the vectors themselves are not. */
static void move_nodes(ChainKernel *k, const State *s) {
    Vector *moved = k->moved, sum = {0.0, 0.0};
    for (int e = 0; e < k->n; e++) {
        sum = (Vector){sum.x + (k->d1[e].x - k->d0[e].x), sum.y + (k->d1[e].y - k->d0[e].y)};
        moved[e] = sum;
        k->r1[e] = (Vector){s->r[e].x + sum.x, s->r[e].y + sum.y};
    }
}

/* Out-of-balance forces of a step that ends with d1, r1, into k->unknown; tangents, too. */
static void em_residual(ChainKernel *k, const State *s, Load load, double h, double viscosity,
                        double inertia) {
    double trolley_v = load.trolley_v + 0.5 * h * load.trolley_a;
    Vector *change = k->w1; /* w1 is free until the step is done */
    for (int i = 0; i < k->n; i++) {
        Vector moved = k->moved[i];
        change[i] = (Vector){inertia * moved.x - 2.0 / h * s->w[i].x,
                             inertia * moved.y - 2.0 / h * s->w[i].y};
    }
    for (int i = 0; i < k->n; i++) {
        ElementForce f = element_force(k, viscosity, i);
        Vector steady = applied(k, load, trolley_v, i);
        k->tangent[i] = f.tangent;
        k->unknown[i] = minus(minus(steady, mass_times(k, change, i)), f.pull);
        if (i) {
            k->unknown[i - 1].x += f.pull.x;
            k->unknown[i - 1].y += f.pull.y;
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
static inline double taut_stiffness(const ChainKernel *k, const State *s, int e) {
    return larger(s->tension[e], 0.0) / k->l0[e];
}

static inline Vector taut_pull(const ChainKernel *k, const State *s, int e) {
    double stiffness = taut_stiffness(k, s, e);
    return (Vector){stiffness * k->d0[e].x, stiffness * k->d0[e].y};
}

/* Mean velocity of a step in which each element keeps its tension, or none if it is slack:

       ((2/h + alpha) M + h/2 K) u = 2/h M w0 + f - b (a + alpha v) - F(k d0),  k_e = N_e/l_e

   in place by Thomas elimination: a taut string's matrix is positive definite. */
static const Vector *expected_velocity(ChainKernel *k, const State *s, Load load, double h) {
    double trolley_v = load.trolley_v + 0.5 * h * load.trolley_a;
    double inertia = 2.0 / h + k->settings.damping_air;
    double coupling = 0.0, above = 0.0; /* matrix entry and factor between nodes i-1 and i */
    double *factor = k->tension1;       /* free until the step is done */
    Vector *u = k->unknown, pull = taut_pull(k, s, 0);
    double stiffness = taut_stiffness(k, s, 0);
    for (int i = 0; i < k->n; i++) {
        int end = i == k->n - 1;
        double below = end ? 0.0 : taut_stiffness(k, s, i + 1);
        Vector pull_below = end ? (Vector){0.0, 0.0} : taut_pull(k, s, i + 1);
        Vector f = minus(applied(k, load, trolley_v, i), minus(pull, pull_below));
        Vector momentum = mass_times(k, s->w, i), known = i ? u[i - 1] : (Vector){0.0, 0.0};
        double pivot = inertia * node_mass(k, i) + 0.5 * h * (stiffness + below) - coupling * above;
        u[i].x = (f.x + 2.0 / h * momentum.x - coupling * known.x) / pivot;
        u[i].y = (f.y + 2.0 / h * momentum.y - coupling * known.y) / pivot;
        coupling = inertia * k->coupling - 0.5 * h * below;
        factor[i] = above = coupling / pivot;
        stiffness = below;
        pull = pull_below;
    }
    for (int i = k->n - 2; i >= 0; i--)
        u[i] = (Vector){u[i].x - factor[i] * u[i + 1].x, u[i].y - factor[i] * u[i + 1].y};
    return u;
}

/* Element vectors expected at the step's end: they turn with that velocity and keep the tension. */
static void predict(ChainKernel *k, const State *s, Load load, double h, double viscosity) {
    for (int e = 0; e < k->n; e++) {
        k->d0[e] = along(s->r, e);
        k->l0[e] = norm(k->d0[e]);
    }
    const Vector *u = expected_velocity(k, s, load, h);
    for (int e = 0; e < k->n; e++) {
        double turn = h * cross(k->d0[e], along(u, e)) / (k->l0[e] * k->l0[e]);
        k->d1[e] = turned(k->d0[e], turn, expected_stretch(k, s, viscosity, e));
    }
}

/* One step: M (w1 - w0)/h + alpha M (w0 + w1)/2 + F(r0, r1) = f - b (a + alpha v). */
static int em_step(ChainKernel *k, const State *s, Load load, double h, StepResult *result) {
    const ChainSettings *p = &k->settings;
    double viscosity = k->axial * (p->damping_chain / h + AXIAL_DISSIPATION);
    double inertia = 2.0 / (h * h) + p->damping_air / h, last = 0.0;
    predict(k, s, load, h, viscosity);
    for (int iteration = 1; iteration <= EM_MAX_ITERATIONS; iteration++) {
        result->iterations = iteration;
        move_nodes(k, s);
        em_residual(k, s, load, h, viscosity, inertia);
        if (!factor_and_solve(k, inertia, k->unknown)) return CHAIN_NOT_CONVERGED;
        double size = size_of(k->unknown, k->n);
        if (!(size < p->length) || (iteration > 2 && size > DIVERGENCE * last) ||
            (size > ROUND_OFF * p->length && !correct(k->unknown, k->d1, k->n)))
            return CHAIN_NOT_CONVERGED;
        if (size <= EM_DISPLACEMENT_TOLERANCE * p->length) {
            move_nodes(k, s);
            em_result(k, s, load, h, viscosity, result);
            return CHAIN_OK;
        }
        last = size;
    }
    return CHAIN_NOT_CONVERGED;
}

/* ---- newmark.py ---- */

/* Axial force with the chain's damping, N. */
static double axial(const ChainKernel *k, Vector d, double length, Vector dw) {
    double tau = k->settings.damping_chain, force = axial_force(k, length);
    return tau == 0.0 ? force : force + k->axial * tau * dot(d, dw) / length;
}

/* applied - M a - C w - f_sigma, (21), into k->unknown; ``a`` may be NULL. */
static void newmark_residual(ChainKernel *k, Load load, double trolley_v, const Vector *r,
                             const Vector *w, const Vector *a) {
    double air = k->settings.damping_air;
    Vector *residual = k->unknown;
    for (int i = 0; i < k->n; i++) {
        Vector d = along(r, i), out = applied(k, load, trolley_v, i);
        double length = norm(d), pull = axial(k, d, length, along(w, i)) / length;
        out = minus(out, (Vector){pull * d.x, pull * d.y});
        if (a) out = minus(out, mass_times(k, a, i));
        if (air != 0.0) {
            Vector drag = mass_times(k, w, i);
            out = minus(out, (Vector){air * drag.x, air * drag.y});
        }
        residual[i] = out;
        if (i) {
            residual[i - 1].x += pull * d.x;
            residual[i - 1].y += pull * d.y;
        }
    }
}

/* Horizontal force of the drive on the chain, N: node 0's row of dynamic equilibrium. */
static double trolley_force(const ChainKernel *k, Vector r, Vector w, Vector a, double trolley_v,
                            double trolley_a) {
    double air = k->settings.damping_air, row = 0.5 * k->inner_row, length = norm(r);
    double carried = row * (trolley_a + air * trolley_v) + k->coupling * (a.x + air * w.x);
    return carried - axial(k, r, length, w) * r.x / length;
}

/* What the damping takes in a step, J: mean of its forces at both ends times the path. */
static double damping_work(ChainKernel *k, const State *s, double v0, double v1,
                           double trolley_dx) {
    double work = 0.0, air = k->settings.damping_air, v = 0.5 * (v0 + v1);
    Vector *mean = k->unknown;
    if (k->settings.damping_chain != 0.0) {
        for (int e = 0; e < k->n; e++) {
            Vector d0 = along(s->r, e), d1 = along(k->r1, e), path = minus(d1, d0);
            double l0 = norm(d0), l1 = norm(d1);
            double pull0 = (axial(k, d0, l0, along(s->w, e)) - axial_force(k, l0)) / l0;
            double pull1 = (axial(k, d1, l1, along(k->w1, e)) - axial_force(k, l1)) / l1;
            work += 0.5 * (pull0 * dot(d0, path) + pull1 * dot(d1, path));
        }
    }
    if (air != 0.0) {
        double friction = 0.0, row_path = 0.0, momentum = k->total_mass * v;
        for (int i = 0; i < k->n; i++)
            mean[i] = (Vector){0.5 * (s->w[i].x + k->w1[i].x), 0.5 * (s->w[i].y + k->w1[i].y)};
        for (int i = 0; i < k->n; i++) {
            Vector path = minus(k->r1[i], s->r[i]);
            friction += dot(path, mass_times(k, mean, i));
            row_path += row_mass(k, i) * path.x;
            momentum += row_mass(k, i) * mean[i].x;
        }
        work += air * (friction + v * row_path + momentum * trolley_dx);
    }
    return work;
}

/* Step VI, (24)-(26), done; the step's energy terms by the trapezoidal rule. */
static void newmark_result(ChainKernel *k, const State *s, Load load, double h,
                           StepResult *result) {
    double v1 = load.trolley_v + h * load.trolley_a;
    double trolley_dx = 0.5 * h * (load.trolley_v + v1);
    double before =
        trolley_force(k, s->r[0], s->w[0], k->a0[0], load.trolley_v, load.trolley_a);
    double after = trolley_force(k, k->r1[0], k->w1[0], k->a1[0], v1, load.trolley_a);
    for (int e = 0; e < k->n; e++) {
        Vector d = along(k->r1, e);
        k->tension1[e] = axial(k, d, norm(d), along(k->w1, e));
    }
    result->trolley_fx = after;
    result->work_trolley = 0.5 * (before + after) * trolley_dx;
    result->work_payload =
        load.payload_fx * (k->r1[k->n - 1].x - s->r[k->n - 1].x + trolley_dx);
    result->dissipated = damping_work(k, s, load.trolley_v, v1, trolley_dx);
}

/* Steps I to VI. */
static int newmark_step(ChainKernel *k, const State *s, Load load, double h, StepResult *result) {
    const ChainSettings *p = &k->settings;
    int n = k->n;
    size_t nodes = (size_t)n * sizeof(Vector);

    /* I. accelerations from dynamic equilibrium, M a = f - f_sigma - C v */
    if (!is_nan(s->a[0].x)) {
        memcpy(k->a0, s->a, nodes);
    } else {
        newmark_residual(k, load, load.trolley_v, s->r, s->w, NULL);
        mass_solve(k, k->unknown);
        memcpy(k->a0, k->unknown, nodes);
    }

    /* II. effective stiffness (15), kept through the iterations; 2/h C for the damping */
    for (int e = 0; e < n; e++) {
        Vector d = along(s->r, e);
        Block T = element_tangent(k, d);
        if (p->damping_chain != 0.0) {
            double viscous = 2.0 / h * p->EA * p->damping_chain / k->L0 / dot(d, d);
            T.xx += viscous * d.x * d.x;
            T.xy += viscous * d.x * d.y;
            T.yx += viscous * d.y * d.x;
            T.yy += viscous * d.y * d.y;
        }
        k->tangent[e] = T;
    }
    if (!factor(k, 4.0 / (h * h) + 2.0 / h * p->damping_air)) return CHAIN_SINGULAR;

    /* III-IV. effective load (16) and a first increment (17); V. iteration (18)-(23) */
    double v1 = load.trolley_v + h * load.trolley_a, correction2 = 0.0, first = 0.0;
    double force_tolerance =
        NEWMARK_FORCE_TOLERANCE * p->gravity * k->total_mass + NEWMARK_ROUND_OFF * p->EA * n;
    Vector *increment = k->d0; /* d0 is free in this scheme */
    memset(increment, 0, nodes);
    for (int iteration = 0; iteration <= NEWMARK_MAX_ITERATIONS; iteration++) {
        result->iterations = iteration;
        double size2 = 0.0, unbalanced = 0.0;
        for (int i = 0; i < n; i++) {
            Vector q = increment[i], w = s->w[i], a = k->a0[i];
            k->a1[i] = (Vector){4.0 / (h * h) * q.x - 4.0 / h * w.x - a.x,
                                4.0 / (h * h) * q.y - 4.0 / h * w.y - a.y};        /* (18) */
            k->w1[i] = (Vector){2.0 / h * q.x - w.x, 2.0 / h * q.y - w.y};         /* (19) */
            k->r1[i] = (Vector){s->r[i].x + q.x, s->r[i].y + q.y};                 /* (20) */
            size2 += dot(k->r1[i], k->r1[i]);
        }
        newmark_residual(k, load, v1, k->r1, k->w1, k->a1);                        /* (21) */
        if (iteration) {
            double moved = sqrt(correction2) / sqrt(size2);
            for (int i = 0; i < n; i++) {
                Vector f = k->unknown[i];
                unbalanced = larger(unbalanced, larger(fabs(f.x), fabs(f.y)));
                if (!is_finite(f.x + f.y)) return CHAIN_NOT_CONVERGED;
            }
            if (moved <= NEWMARK_DISPLACEMENT_TOLERANCE && unbalanced <= force_tolerance) {
                newmark_result(k, s, load, h, result);
                return CHAIN_OK;
            }
            if (iteration == 1) first = moved;
            if (!(moved < 1.0) || (iteration == SLOW_ITERATION && moved > SLOW_SHARE * first))
                return CHAIN_NOT_CONVERGED;
        }
        solve(k, k->unknown);                                                      /* (17), (22) */
        correction2 = 0.0;
        for (int i = 0; i < n; i++) {
            correction2 += dot(k->unknown[i], k->unknown[i]);
            increment[i].x += k->unknown[i].x;                                     /* (23) */
            increment[i].y += k->unknown[i].y;
        }
    }
    return CHAIN_NOT_CONVERGED;
}

/* ---- nonlinear.py ---- */

/* Mechanical energy that must be there now, J. */
static double expected(const Header *s) {
    return s->start + s->work_trolley + s->work_payload - s->dissipated;
}

/* The largest so far of start above rest + (M + m) (v - v_start)^2/2 + |work of the payload's
   force|, J: what the trolley and that force can have put into the swing, in any frame. */
static double energy_scale(const ChainKernel *k, const Header *s, double trolley_v) {
    double speed = k->settings.speed, changed = trolley_v - speed;
    double start = s->start - 0.5 * k->total_mass * speed * speed;
    return larger(s->scale, start + 0.5 * k->total_mass * changed * changed + fabs(s->work_payload));
}

/* The next step is a new start for the scheme. */
static void forget_load(const ChainKernel *k, State *s) {
    Header *head = s->head;
    head->loaded = head->load_v = head->load_a = head->load_fx = 0.0;
    for (int i = 0; i < k->n; i++) s->a[i] = (Vector){NAN, NAN};
}

/* The trolley's velocity jumps to ``after``: M_ff dw = -b dv; the impulse works at the mean v. */
static void jump(ChainKernel *k, State *s, double after) {
    double before = s->head->trolley_v, dv = after - before;
    if (dv == 0.0) return;
    Vector *dw = k->unknown;
    for (int i = 0; i < k->n; i++) dw[i] = (Vector){-row_mass(k, i) * dv, 0.0};
    mass_solve(k, dw);
    for (int i = 0; i < k->n; i++) {
        s->w[i].x += dw[i].x;
        s->w[i].y += dw[i].y;
    }
    double impulse = 0.5 * k->inner_row * dv + k->coupling * dw[0].x;
    s->head->work_trolley += 0.5 * (before + after) * impulse;
    s->head->energy = mechanical_energy(k, s->r, s->w, after);
    s->head->scale = energy_scale(k, s->head, after);
    forget_load(k, s);
}

/* Energy now against before + work - dissipation: ``ledger`` is the expected energy now. */
static int check_energy(const ChainKernel *k, const Header *s, double ledger, double energy,
                        double h, ChainFailure *failure) {
    double weight = k->settings.gravity * k->total_mass;
    double floor = ROUND_OFF_ENERGY * weight * k->settings.length;
    double scale = s->scale;
    double total = energy - ledger, step = total - (s->energy - expected(s));
    if (!(fabs(step) <= STEP_ENERGY_TOLERANCE * scale + floor)) {
        *failure = (ChainFailure){0.0, h, step, scale, STEP_ENERGY_TOLERANCE};
        return CHAIN_STEP_ENERGY;
    }
    if (!(fabs(total) <= TOTAL_ENERGY_TOLERANCE * scale + floor)) {
        *failure = (ChainFailure){0.0, h, total, scale, TOTAL_ENERGY_TOLERANCE};
        return CHAIN_TOTAL_ENERGY;
    }
    return CHAIN_OK;
}

/* One step of the scheme; the trial state moves on if its energy balance is good. */
static int attempt(ChainKernel *k, Load load, double h, ChainFailure *failure) {
    State *s = &k->trial;
    Header *head = s->head;
    int newmark = k->settings.scheme == CHAIN_NEWMARK;
    size_t nodes = (size_t)k->n * sizeof(Vector);
    StepResult result = {0};
    if (head->loaded != 0.0 && (head->load_a != load.trolley_a || head->load_fx != load.payload_fx))
        forget_load(k, s); /* a jump of load: accelerations start anew */
    int kind = newmark ? newmark_step(k, s, load, h, &result) : em_step(k, s, load, h, &result);
    head->iterations += result.iterations;
    if (kind != CHAIN_OK) {
        *failure = (ChainFailure){0.0, h, 0.0, 0.0, 0.0};
        return kind;
    }
    Header next = *head;
    next.work_trolley += result.work_trolley;
    next.work_payload += result.work_payload;
    next.dissipated += result.dissipated;
    next.energy = mechanical_energy(k, k->r1, k->w1, load.trolley_v + h * load.trolley_a);
    kind = check_energy(k, head, expected(&next), next.energy, h, failure);
    if (kind != CHAIN_OK) return kind;
    next.scale = energy_scale(k, &next, load.trolley_v + h * load.trolley_a);
    next.trolley_fx = result.trolley_fx;
    next.loaded = 1.0;
    next.load_v = load.trolley_v;
    next.load_a = load.trolley_a;
    next.load_fx = load.payload_fx;
    next.steps += 1.0;
    *head = next;
    memcpy(s->r, k->r1, nodes);
    memcpy(s->w, k->w1, nodes);
    if (newmark) memcpy(s->a, k->a1, nodes);
    memcpy(s->tension, k->tension1, (size_t)k->n * sizeof(double));
    return CHAIN_OK;
}

/* One internal step; where it fails it is halved, at most MAX_HALVINGS times over. */
static int internal_step(ChainKernel *k, double v, double a_cmd, double payload_fx, double elapsed,
                         double h, int halvings, ChainFailure *failure) {
    Load load = {v + elapsed * a_cmd, a_cmd, payload_fx};
    int kind = attempt(k, load, h, failure);
    if (kind == CHAIN_OK) return CHAIN_OK;
    if (halvings == MAX_HALVINGS) {
        failure->time = k->trial.head->time + elapsed;
        return kind;
    }
    h *= 0.5;
    kind = internal_step(k, v, a_cmd, payload_fx, elapsed, h, halvings + 1, failure);
    if (kind != CHAIN_OK) return kind;
    return internal_step(k, v, a_cmd, payload_fx, elapsed + h, h, halvings + 1, failure);
}

/* ---- the kernel's memory ---- */

static State state_at(double *memory, int n) {
    State s;
    s.head = (Header *)memory;
    s.r = (Vector *)(memory + sizeof(Header) / sizeof(double));
    s.w = s.r + n;
    s.a = s.w + n;
    s.tension = (double *)(s.a + n);
    return s;
}

size_t chain_state_count(int elements) {
    return sizeof(Header) / sizeof(double) + 7 * (size_t)elements;
}

static size_t rounded(size_t bytes) { return (bytes + 15) / 16 * 16; }

/* Hand out the next ``bytes`` of the memory at ``used``; only count them where memory is NULL. */
static void *take(char *memory, size_t *used, size_t bytes) {
    void *start = memory ? memory + *used : NULL;
    *used += rounded(bytes);
    return start;
}

/* Lay a kernel out in ``memory``, or count only where it is NULL; bytes. */
static size_t lay_out(ChainKernel *k, char *memory, int elements) {
    size_t used = rounded(sizeof(ChainKernel)), n = (size_t)elements;
    size_t state = chain_state_count(elements) * sizeof(double);
    double *committed = take(memory, &used, state), *trial = take(memory, &used, state);
    Vector *vectors = take(memory, &used, 8 * n * sizeof(Vector));
    double *numbers = take(memory, &used, 2 * n * sizeof(double));
    Block *blocks = take(memory, &used, 4 * n * sizeof(Block));
    if (memory) {
        k->state = state_at(committed, elements);
        k->trial = state_at(trial, elements);
        k->r1 = vectors;
        k->w1 = vectors + n;
        k->a1 = vectors + 2 * n;
        k->a0 = vectors + 3 * n;
        k->d0 = vectors + 4 * n;
        k->d1 = vectors + 5 * n;
        k->moved = vectors + 6 * n;
        k->unknown = vectors + 7 * n;
        k->tension1 = numbers;
        k->l0 = numbers + n;
        k->tangent = blocks;
        k->inverse = blocks + n;
        k->lower = blocks + 2 * n;
        k->upper = blocks + 3 * n;
    }
    return used;
}

int chain_version(void) { return CHAIN_KERNEL_VERSION; }

int chain_output_count(void) { return CHAIN_OUTPUTS; }

int chain_settings_size(void) { return (int)sizeof(ChainSettings); }

size_t chain_memory(int elements) { return lay_out(NULL, NULL, elements); }

/* Mass matrix (11), weight (13) and rest position of the chain cut into equal elements. */
static void discretise(ChainKernel *k) {
    const ChainSettings *p = &k->settings;
    double element = p->mass / k->n, half_weight = -0.5 * element * p->gravity;
    k->L0 = p->length / k->n;
    k->axial = p->EA / k->L0;
    k->coupling = p->mass_matrix == CHAIN_AVERAGED ? element / 12.0 : element / 6.0;
    k->inner_mass = element - 2.0 * k->coupling;
    k->end_mass = 0.5 * element - k->coupling + p->payload_mass;
    k->inner_row = element;
    k->end_row = 0.5 * element + p->payload_mass;
    k->inner_weight = 2.0 * half_weight;
    k->end_weight = half_weight - p->payload_mass * p->gravity;
    k->total_mass = p->mass + p->payload_mass;
    straight_chain(k, 0.0, k->r1);
    k->rest_potential = 0.0;
    k->rest_potential = potential_energy(k, k->r1);
}

ChainKernel *chain_create(void *memory, const ChainSettings *settings) {
    ChainKernel *k = memory;
    int n = settings->elements;
    memset(memory, 0, chain_memory(n));
    k->settings = *settings;
    k->n = n;
    lay_out(k, memory, n);
    discretise(k);
    State *s = &k->state;
    straight_chain(k, settings->sway_angle, s->r);
    for (int e = 0; e < n; e++) s->tension[e] = axial_force(k, norm(along(s->r, e)));
    s->head->trolley_v = settings->speed;
    s->head->energy = mechanical_energy(k, s->r, s->w, settings->speed);
    s->head->start = s->head->energy;
    s->head->scale = potential_energy(k, s->r);
    forget_load(k, s);
    s->head->trolley_fx = 0.0 - s->tension[0] * s->r[0].x / norm(s->r[0]); /* no -0 */
    return k;
}

double *chain_state(ChainKernel *k) { return (double *)k->state.head; }

/* ---- crane.py ---- */

/* Number of equal internal steps; a ratio that is whole but for round-off counts as whole. */
static double internal_steps(double h, double max_step) {
    return larger(1.0, ceil(h / max_step * (1.0 - 1e-9)));
}

int chain_step(ChainKernel *k, double h, double v_cmd, double a_cmd, double payload_fx,
               ChainFailure *failure) {
    const Header *now = k->state.head;
    double v = v_cmd + now->trolley_gained, gained = now->trolley_gained + h * a_cmd;
    double x = now->trolley_x + h * v + 0.5 * h * h * a_cmd;
    int allowed = h > 0.0 && h <= MAX_INTERNAL_STEPS * k->settings.max_step;
    if (!allowed || !is_finite(x) || !is_finite(v_cmd + gained) || !is_finite(payload_fx))
        return CHAIN_BAD_VALUE;

    size_t bytes = chain_state_count(k->n) * sizeof(double);
    State *s = &k->trial;
    memcpy(s->head, k->state.head, bytes);
    jump(k, s, v);
    s->head->steps = s->head->iterations = 0.0;
    double count = internal_steps(h, k->settings.max_step);
    for (double i = 0.0; i < count; i += 1.0) {
        int kind = internal_step(k, v, a_cmd, payload_fx, i * h / count, h / count, 0, failure);
        if (kind != CHAIN_OK) return kind;
    }
    s->head->time += h;
    s->head->trolley_x = x;
    s->head->trolley_v = v_cmd + gained;
    s->head->trolley_gained = gained;
    memcpy(k->state.head, s->head, bytes);
    return CHAIN_OK;
}

/* The chain's material point at a fraction of its length, (7)-(8), relative to the trolley. */
static Vector material_point(const ChainKernel *k, double fraction) {
    double place = fraction * k->n, whole = floor(place + 1e-9);
    int upper = whole < k->n - 1 ? (int)whole : k->n - 1;
    double share = place - upper;
    const Vector *r = k->state.r;
    Vector point = {share * r[upper].x, share * r[upper].y};
    if (upper > 0) {
        point.x += (1.0 - share) * r[upper - 1].x;
        point.y += (1.0 - share) * r[upper - 1].y;
    }
    return point;
}

void chain_outputs(const ChainKernel *k, double outputs[CHAIN_OUTPUTS]) {
    const State *s = &k->state;
    const Header *head = s->head;
    Vector top = s->r[0], payload = s->r[k->n - 1], payload_w = s->w[k->n - 1];
    double tension_min = s->tension[0];
    for (int e = 1; e < k->n; e++)
        if (s->tension[e] < tension_min) tension_min = s->tension[e];
    double *out = outputs;
    *out++ = head->trolley_x;
    *out++ = head->trolley_v;
    *out++ = head->trolley_fx;
    *out++ = head->trolley_x + payload.x;
    *out++ = payload.y;
    *out++ = head->trolley_v + payload_w.x;
    *out++ = payload_w.y;
    *out++ = payload.x;
    *out++ = atan2(payload.x, -payload.y);
    *out++ = material_point(k, 0.5).x;
    *out++ = atan2(top.x, -top.y);
    *out++ = s->tension[0];
    *out++ = tension_min;
    for (int i = 1; i <= CHAIN_MATERIAL_POINTS; i++) {
        Vector point = material_point(k, (double)i / CHAIN_MATERIAL_POINTS);
        out[0] = head->trolley_x + point.x;
        out[CHAIN_MATERIAL_POINTS] = point.y;
        out++;
    }
    out += CHAIN_MATERIAL_POINTS;
    *out++ = head->energy;
    *out++ = head->dissipated;
    *out++ = head->energy - expected(head);
    *out++ = head->steps;
    *out++ = head->iterations;
}
