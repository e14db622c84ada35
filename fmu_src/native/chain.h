/* The chain cut into elements, without time: the twin of chaincrane/plant/chain.py, where sketch,
   signs and sources are. Nodes 1..n are entries 0..n-1 of an array; node 0 is the trolley.

   Nothing here or in the files above it has a global that changes: two cranes never meet. A step uses
   + - * / and sqrt alone, so that every IEEE machine gives the same digits (compile with
   -ffp-contract=off). Units: m, kg, s, N, J, rad. */

#ifndef CHAIN_H
#define CHAIN_H

#include <math.h>

#include "names.h"
#include "twins.h"

HIDDEN

typedef struct {
    double x, y;
} Vector;

typedef struct {
    double xx, xy, yx, yy;
} Block;

typedef struct {
    Settings settings;
    int n;                                 /* elements, and free nodes */
    double L0, axial;                      /* m, unstretched element; N/m, EA/L0 */
    double inner_mass, end_mass, coupling; /* kg, mass matrix: diagonal, payload's, off */
    double end_coupling;                   /* kg, between node 0 and the payload's, besides */
    double inner_row, end_row, row_mass0;  /* kg, its row sums; node 0's */
    double inner_weight, end_weight;       /* N, upwards */
    double total_mass;                     /* kg, chain and payload */
    double rest_potential;                 /* J, potential energy of the rest position */
} Chain;

/* As math.h has them, but in no need of a C runtime's own functions. */
static inline int is_nan(double x) { return x != x; }

static inline int is_finite(double x) { return x - x == 0.0; }

static inline double larger(double a, double b) { return b > a ? b : a; }

static inline double smaller(double a, double b) { return a < b ? a : b; }

/* ---- vectors ---- */

static inline Vector minus(Vector a, Vector b) { return (Vector){a.x - b.x, a.y - b.y}; }

static inline double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y; }

static inline double cross(Vector a, Vector b) { return a.x * b.y - a.y * b.x; }

static inline double norm(Vector a) { return sqrt(a.x * a.x + a.y * a.y); }

/* Element e's difference of a nodal quantity; node 0's is zero. */
static inline Vector along(const Vector *nodal, int e) {
    return e ? minus(nodal[e], nodal[e - 1]) : nodal[0];
}

/* ---- the mass matrix (11) ---- */

static inline double node_mass(const Chain *c, int i) {
    return i < c->n - 1 ? c->inner_mass : c->end_mass;
}

static inline double row_mass(const Chain *c, int i) {
    return i < c->n - 1 ? c->inner_row : c->end_row;
}

/* Row i of M_ff times a nodal quantity, whose entries stand ``stride`` numbers apart. */
static inline double mass_row(const Chain *c, const double *nodal, int stride, int i) {
    double product = node_mass(c, i) * nodal[i * stride];
    if (i > 0) product += c->coupling * nodal[(i - 1) * stride];
    if (i < c->n - 1) product += c->coupling * nodal[(i + 1) * stride];
    return product;
}

static inline Vector mass_times(const Chain *c, const Vector *nodal, int i) {
    return (Vector){mass_row(c, &nodal->x, 2, i), mass_row(c, &nodal->y, 2, i)};
}

/* ---- forces ---- */

/* Axial force N = EA (l - L0)/L0, N, tension positive. */
static inline double axial_force(const Chain *c, double length) {
    return c->axial * (length - c->L0);
}

/* K = EA/L0 c c^T + N/l (1 - c c^T), (12) in global axes, N/m. */
Block element_tangent(const Chain *c, Vector d);

/* Weight, payload force, and the trolley's motion as a load on node i, N: f - b (a + alpha v). */
static inline Vector applied_force(const Chain *c, const Command *command, double trolley_v,
                                   int i) {
    double carried = command->trolley_a_cmd + c->settings.damping_air * trolley_v;
    if (i < c->n - 1) return (Vector){-c->inner_row * carried, c->inner_weight};
    return (Vector){command->payload_fx - c->end_row * carried, c->end_weight};
}

/* Horizontal force, N, that node 0's row of the mass matrix takes: inertia and the air's drag.
   ``node1``, ``payload``: a + alpha w of node 1 and of the payload's, relative to the trolley,
   m/s2. */
double carried_force(const Chain *c, const Command *command, double trolley_v, double node1,
                     double payload);

/* Work of the payload's force, J; ``moved``: of the payload relative to the trolley, m. */
double payload_work(const Command *command, Vector moved, double trolley_dx);

/* ---- the hanging equilibrium, and a straight chain ---- */

/* Tension of an element in the hanging equilibrium, N: the payload and the chain below it. */
double hanging_tension(const Chain *c, int e);

/* Length of an element under ``tension``, m: l_e = L0 (1 + N_e/EA). */
double hanging_length(const Chain *c, double tension);

/* Positions, m, of the straight chain held at the sway angle, each element under N_e cos(angle). */
void straight_chain(const Chain *c, double sway_angle, Vector *r);

/* Mass matrix (11) and weight (13) of the chain cut into equal elements. */
void discretise(Chain *c, const Settings *settings);

/* ---- energies ---- */

/* Kinetic energy, J; w relative, trolley_v in m/s. */
double kinetic_energy(const Chain *c, const Vector *w, double trolley_v);

/* Elastic energy and weight, J, above the rest position. */
double potential_energy(const Chain *c, const Vector *r);

/* ---- material points ---- */

/* A nodal quantity at a fraction of the chain's length, (7)-(8); strides as in mass_row. */
double interpolate(const Chain *c, const double *nodal, int stride, double fraction);

/* Fraction of the chain's length of a material point: ten from the top, then the middle. */
double material_fraction(int point);

enum { POINTS = MATERIAL_POINTS + 1 };

SHOWN

#endif
