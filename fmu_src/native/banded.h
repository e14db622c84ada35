/* Block-tridiagonal systems of 2x2 blocks, inertia M + the elements' tangents; the twin of
   chaincrane/plant/banded.py. All solve in place. */

#ifndef BANDED_H
#define BANDED_H

#include "chain.h"

typedef struct {
    Block *tangent;                 /* of the elements */
    Block *inverse, *lower, *upper; /* of the matrix: P_i^-1, B_i, P_i^-1 B_(i+1) */
} Banded;

/* M_ff x = load; ``factor``: room for n numbers. */
void mass_solve(const Chain *c, double *factor, Vector *x);

/* Factors of inertia M + the tangents, to be kept; 0 where it is singular. */
int factor(const Banded *m, const Chain *c, double inertia);

/* Solve with the kept factors. */
void solve(const Banded *m, int n, Vector *x);

/* Factor and solve in one pass; 0 where the matrix is singular. */
int factor_and_solve(const Banded *m, const Chain *c, double inertia, Vector *x);

#endif
