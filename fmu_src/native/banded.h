/* Block-tridiagonal systems of 2x2 blocks, inertia M + the elements' tangents; the twin of
   chaincrane/plant/banded.py. All solve in place. Inline, as they are half of a step's work: in a
   file of its own they cost a step 4 % more. */

#ifndef BANDED_H
#define BANDED_H

#include "chain.h"

typedef struct {
    Block *tangent;                 /* of the elements */
    Block *inverse, *lower, *upper; /* of the matrix: P_i^-1, B_i, P_i^-1 B_(i+1) */
} Banded;

static inline Block plus(Block a, Block b) {
    return (Block){a.xx + b.xx, a.xy + b.xy, a.yx + b.yx, a.yy + b.yy};
}

static inline Vector times(Block b, Vector v) {
    return (Vector){b.xx * v.x + b.xy * v.y, b.yx * v.x + b.yy * v.y};
}

static inline Block product(Block a, Block b) {
    return (Block){a.xx * b.xx + a.xy * b.yx, a.xx * b.xy + a.xy * b.yy, a.yx * b.xx + a.yy * b.yx,
                   a.yx * b.xy + a.yy * b.yy};
}

/* M_ff x = load by Thomas elimination, safe because M is diagonally dominant; ``factor``: room for n
   numbers. */
static inline void mass_solve(const Chain *c, double *factor, Vector *x) {
    double coupling = c->coupling;
    for (int i = 0; i < c->n; i++) {
        double pivot = node_mass(c, i);
        if (i) {
            pivot -= coupling * factor[i - 1];
            x[i].x -= coupling * x[i - 1].x;
            x[i].y -= coupling * x[i - 1].y;
        }
        factor[i] = coupling / pivot;
        x[i].x /= pivot;
        x[i].y /= pivot;
    }
    for (int i = c->n - 2; i >= 0; i--) {
        x[i].x -= factor[i] * x[i + 1].x;
        x[i].y -= factor[i] * x[i + 1].y;
    }
}

/* Row i of the block elimination: P_i = D_i - B_i P_(i-1)^-1 B_i; 0 where P_i is singular.

   B_i = inertia m_c - T_i couples nodes i-1 and i; D_i = inertia m_i + T_i + T_(i+1). Each 2x2
   block is inverted by Cramer's rule, which is forward stable at that size (Higham, Accuracy and
   Stability of Numerical Algorithms, 1.10.1). No blocks are swapped: Newton's iteration mends what
   round-off that costs, and a matrix that is too far from definite ends in a halved step. */
static inline int factor_node(const Banded *m, const Chain *c, double inertia, int i) {
    const Block *T = m->tangent;
    double own = inertia * node_mass(c, i), coupling = inertia * c->coupling;
    Block p = {own + T[i].xx, T[i].xy, T[i].yx, own + T[i].yy};
    if (i < c->n - 1) p = plus(p, T[i + 1]);
    if (i > 0) {
        Block b = {coupling - T[i].xx, -T[i].xy, -T[i].yx, coupling - T[i].yy};
        Block x = product(m->inverse[i - 1], b), bx = product(b, x);
        m->lower[i] = b;
        m->upper[i - 1] = x;
        p = (Block){p.xx - bx.xx, p.xy - bx.xy, p.yx - bx.yx, p.yy - bx.yy};
    }
    double over = 1.0 / (p.xx * p.yy - p.xy * p.yx);
    m->inverse[i] = (Block){p.yy * over, -p.xy * over, -p.yx * over, p.xx * over};
    return is_finite(over);
}

static inline void forward_node(const Banded *m, Vector *x, int i) {
    if (i > 0) x[i] = minus(x[i], times(m->lower[i], x[i - 1]));
    x[i] = times(m->inverse[i], x[i]);
}

static inline void substitute_back(const Banded *m, int n, Vector *x) {
    for (int i = n - 2; i >= 0; i--) x[i] = minus(x[i], times(m->upper[i], x[i + 1]));
}

/* Factors of inertia M + the tangents, to be kept; 0 where it is singular. */
static inline int factor(const Banded *m, const Chain *c, double inertia) {
    for (int i = 0; i < c->n; i++)
        if (!factor_node(m, c, inertia, i)) return 0;
    return 1;
}

/* Solve with the kept factors. */
static inline void solve(const Banded *m, int n, Vector *x) {
    for (int i = 0; i < n; i++) forward_node(m, x, i);
    substitute_back(m, n, x);
}

/* Factor and solve in one pass; 0 where the matrix is singular. */
static inline int factor_and_solve(const Banded *m, const Chain *c, double inertia, Vector *x) {
    for (int i = 0; i < c->n; i++) {
        if (!factor_node(m, c, inertia, i)) return 0;
        forward_node(m, x, i);
    }
    substitute_back(m, c->n, x);
    return 1;
}

#endif
