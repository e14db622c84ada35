/* The chain that does not stretch; see inextensible.h. */

#include "inextensible.h"

#include <string.h>

static const int NEWTON_STEPS = 8;     /* from a rough guess to a zero of a Legendre polynomial */
static const int MOST_SWEEPS = 30;     /* of Jacobi's method, which takes about eight */
static const double ROUND_OFF = 1e-17; /* of its diagonal, what an entry may be and count as zero */

enum { STAGES = 5 };

/* Gauss points of the chain, and what they carry; all matrices by rows. */
typedef struct {
    int n;
    double *place, *weight; /* from -1 to 1; m */
    double *load;           /* kg m, b */
    double *inertia;        /* kg m2, S, n x n */
} Gauss;

/* Tangents and their rates. */
typedef struct {
    Vector *u;  /* unit vectors */
    double *om; /* rad/s */
} Turning;

struct GaussChain {
    Gauss gauss;
    double *shape;         /* m, W at the points that are seen, POINTS x n */
    double *slope;         /* W'(0) */
    double *hanging;       /* N, tension at rest */
    double *inverse;       /* 1/m, of the weights */
    double fastest;        /* rad/s */
    Turning first, stage;  /* at a step's start; at a stage of it */
    Turning rates[STAGES]; /* u' and om' at each stage */
    Vector *force;         /* N m, F */
    Vector *rate;          /* of the tangents, u' or u'' */
    double *matrix;        /* n x n */
    double *pivot;         /* 1/D of L D L' */
};

static int reference_points(int n) { return 2 * n + 2; }

/* ---- Legendre and Gauss ---- */

/* P_(-1) = -1 by convention, P_0, ..., P_degree at y. */
static void legendre(int degree, double y, double *p) {
    p[0] = -1.0;
    p[1] = 1.0;
    if (degree > 0) p[2] = y;
    for (int j = 2; j <= degree; j++) p[j + 1] = ((2 * j - 1) * y * p[j] - (j - 1) * p[j - 1]) / j;
}

/* P_n at x and its derivative. */
static double legendre_slope(int n, double x, double *value) {
    double before = 1.0, now = x;
    for (int j = 2; j <= n; j++) {
        double next = ((2 * j - 1) * x * now - (j - 1) * before) / j;
        before = now;
        now = next;
    }
    *value = now;
    return n * (before - x * now) / (1.0 - x * x);
}

/* Zeros of P_n, ascending, and the weights of Gauss' rule, sum 2. */
static void gauss_points(int n, double *x, double *w) {
    for (int i = 0; i < (n + 1) / 2; i++) {
        double t = (i + 1 - 0.25) / (n + 0.5), value, slope;
        double zero = (1.0 - 4.0 * t * t) / (1.0 + t * t); /* about cos(pi t) */
        for (int k = 0; k < NEWTON_STEPS; k++) {
            slope = legendre_slope(n, zero, &value);
            zero -= value / slope;
        }
        if (2 * i + 1 == n) zero = 0.0;
        slope = legendre_slope(n, zero, &value);
        x[i] = -zero;
        x[n - 1 - i] = zero;
        w[i] = w[n - 1 - i] = 2.0 / ((1.0 - zero * zero) * slope * slope);
    }
}

/* W_q(s) of all Gauss points at y = 2 s/L - 1, m: w_q/2 sum P_j(x_q) (P_(j+1)(y) - P_(j-1)(y)).
   ``at_points``: P_j(x_q) from j = -1, n + 1 to each point; ``at_y``: room for n + 2. */
static void shapes(const Gauss *g, const double *at_points, double y, double *at_y, double *W) {
    int n = g->n;
    legendre(n, y, at_y);
    for (int j = 0; j < n; j++) at_y[j] = at_y[j + 2] - at_y[j];
    for (int q = 0; q < n; q++) {
        const double *p = at_points + q * (n + 1) + 1;
        double sum = 0.0;
        for (int j = 0; j < n; j++) sum += p[j] * at_y[j];
        W[q] = 0.5 * g->weight[q] * sum;
    }
}

/* ---- set-up ---- */

/* Doubles that set-up works in, of a chain of n points. */
static size_t scratch_count(int n) {
    size_t N = (size_t)n;
    return N * (N + 1) + 2 * (N + 1) + (N + 2) + N;
}

/* S_qr = mu int W_q W_r ds + M w_q w_r, b_q = int W_q dm; leaves P_j(x_q) in ``scratch``. */
static void gauss_chain(Gauss *g, const Settings *p, double *scratch) {
    int n = g->n;
    double half = 0.5 * p->chain_length, half_mass = 0.5 * p->chain_mass, M = p->payload_mass;
    double *at_points = scratch, *y = at_points + n * (n + 1), *share = y + n + 1;
    double *at_y = share + n + 1, *W = at_y + n + 2;
    gauss_points(n, g->place, g->weight);
    for (int q = 0; q < n; q++) {
        g->weight[q] *= half;
        g->load[q] = g->weight[q] * (M + half_mass * (1.0 - g->place[q]));
        legendre(n - 1, g->place[q], at_points + q * (n + 1));
    }
    for (int q = 0; q < n; q++)
        for (int r = 0; r < n; r++) g->inertia[q * n + r] = M * g->weight[q] * g->weight[r];
    gauss_points(n + 1, y, share);
    for (int k = 0; k <= n; k++) {
        shapes(g, at_points, y[k], at_y, W);
        for (int q = 0; q < n; q++)
            for (int r = 0; r <= q; r++)
                g->inertia[q * n + r] += half_mass * share[k] * W[q] * W[r];
    }
    for (int q = 0; q < n; q++)
        for (int r = 0; r < q; r++) g->inertia[r * n + q] = g->inertia[q * n + r];
}

/* Turn rows and columns i, j of a symmetric A so that a_ij vanishes; and the columns of V. */
static void rotate(double *A, double *V, int n, int i, int j) {
    double a = A[i * n + j], t, c, s;
    double ratio = (A[j * n + j] - A[i * n + i]) / (2.0 * a);
    t = 1.0 / (fabs(ratio) + sqrt(1.0 + ratio * ratio));
    if (ratio < 0.0) t = -t;
    c = 1.0 / sqrt(1.0 + t * t);
    s = t * c;
    A[i * n + i] -= t * a;
    A[j * n + j] += t * a;
    A[i * n + j] = A[j * n + i] = 0.0;
    for (int k = 0; k < n; k++) {
        if (k != i && k != j) {
            double x = A[i * n + k], y = A[j * n + k];
            A[k * n + i] = A[i * n + k] = c * x - s * y;
            A[k * n + j] = A[j * n + k] = s * x + c * y;
        }
        if (V) {
            double x = V[k * n + i], y = V[k * n + j];
            V[k * n + i] = c * x - s * y;
            V[k * n + j] = s * x + c * y;
        }
    }
}

/* Eigenvalues of a symmetric, positive definite A onto its diagonal, vectors into V's columns if
   there is a V: Jacobi's method. */
static void eigen(double *A, double *V, int n) {
    int turned = 1;
    if (V) memset(V, 0, (size_t)(n * n) * sizeof(double));
    for (int i = 0; V && i < n; i++) V[i * n + i] = 1.0;
    for (int sweep = 0; turned && sweep < MOST_SWEEPS; sweep++) {
        turned = 0;
        for (int i = 0; i < n; i++)
            for (int j = i + 1; j < n; j++)
                if (fabs(A[i * n + j]) > ROUND_OFF * sqrt(A[i * n + i] * A[j * n + j])) {
                    rotate(A, V, n, i, j);
                    turned = 1;
                }
    }
}

/* g/omega^2, m, onto the diagonal of B^(-1/2) S B^(-1/2), in the place of S; modes into V. */
static void inverse_modes(Gauss *g, double *V) {
    int n = g->n;
    for (int q = 0; q < n; q++)
        for (int r = 0; r < n; r++) g->inertia[q * n + r] /= sqrt(g->load[q] * g->load[r]);
    eigen(g->inertia, V, n);
}

/* Where the largest number of a diagonal stands that is not yet taken. */
static int largest_left(const double *A, int n, const double *taken) {
    int found = -1;
    for (int i = 0; i < n; i++)
        if (!taken[i] && (found < 0 || A[i * n + i] > A[found * n + found])) found = i;
    return found;
}

/* Inertia with the frequencies of a finer chain, B^(1/2) V diag(g/omega_ref^2) V' B^(1/2); the
   fastest one, rad/s. ``reference``: a finer chain's g/omega^2 on the diagonal of its inertia. */
static double mend_inertia(Gauss *g, const Gauss *reference, double gravity, double *V,
                           double *taken) {
    int n = g->n;
    double value = 0.0;
    inverse_modes(g, V);
    memset(taken, 0, (size_t)(n + reference->n) * sizeof(double));
    double *of_ours = taken, *of_theirs = taken + n;
    for (int mode = 0; mode < n; mode++) {
        int ours = largest_left(g->inertia, n, of_ours);
        int theirs = largest_left(reference->inertia, reference->n, of_theirs);
        of_ours[ours] = of_theirs[theirs] = 1.0;
        value = reference->inertia[theirs * reference->n + theirs];
        for (int q = 0; q < n; q++) V[q * n + ours] *= sqrt(g->load[q] * value);
    }
    for (int q = 0; q < n; q++)
        for (int r = 0; r < n; r++) {
            double sum = 0.0;
            for (int k = 0; k < n; k++) sum += V[q * n + k] * V[r * n + k];
            g->inertia[q * n + r] = sum;
        }
    return sqrt(gravity / value);
}

/* ---- memory ---- */

/* What set-up works in. */
typedef struct {
    Gauss reference;
    double *modes, *taken, *scratch;
} SetUp;

/* Hand out the next numbers of ``memory``; only count them where it is NULL. */
static double *take(double *memory, size_t *used, size_t count) {
    double *start = memory ? memory + *used : NULL;
    *used += count;
    return start;
}

static void lay_out_gauss(Gauss *g, int n, double *memory, size_t *used) {
    size_t N = (size_t)n;
    g->n = n;
    g->place = take(memory, used, N);
    g->weight = take(memory, used, N);
    g->load = take(memory, used, N);
    g->inertia = take(memory, used, N * N);
}

static Turning turning_at(double *memory, size_t *used, size_t n) {
    Turning t = {(Vector *)take(memory, used, 2 * n), take(memory, used, n)};
    return t;
}

/* Lay a chain of n points out, or count only where ``memory`` is NULL; doubles. */
static size_t lay_out(struct GaussChain *c, SetUp *s, int n, double *memory) {
    int fine = reference_points(n);
    size_t N = (size_t)n, used = 0;
    lay_out_gauss(&c->gauss, n, memory, &used);
    c->first = turning_at(memory, &used, N);
    c->stage = turning_at(memory, &used, N);
    c->force = (Vector *)take(memory, &used, 2 * N);
    c->rate = (Vector *)take(memory, &used, 2 * N);
    for (int i = 0; i < STAGES; i++) c->rates[i] = turning_at(memory, &used, N);
    c->pivot = take(memory, &used, N);
    c->matrix = take(memory, &used, N * N);
    c->shape = take(memory, &used, POINTS * N);
    c->slope = take(memory, &used, N);
    c->hanging = take(memory, &used, N);
    c->inverse = take(memory, &used, N);
    lay_out_gauss(&s->reference, fine, memory, &used);
    s->modes = take(memory, &used, N * N);
    s->taken = take(memory, &used, N + (size_t)fine);
    s->scratch = take(memory, &used, scratch_count(fine));
    return used;
}

static size_t memory(const Settings *settings) {
    struct GaussChain c;
    SetUp s;
    size_t numbers = lay_out(&c, &s, (int)settings->chain_elements, NULL);
    return sizeof(struct GaussChain) + numbers * sizeof(double);
}

static void prepare(Workspace *work, void *memory) {
    const Settings *p = &work->chain.settings;
    struct GaussChain *c = work->gauss = memory;
    Gauss *g = &c->gauss;
    SetUp s;
    int n = work->chain.n;
    lay_out(c, &s, n, (double *)(c + 1));
    gauss_chain(&s.reference, p, s.scratch);
    inverse_modes(&s.reference, NULL);
    gauss_chain(g, p, s.scratch);
    double *at_y = s.scratch + n * (n + 1);
    for (int i = 0; i < POINTS; i++)
        shapes(g, s.scratch, 2.0 * material_fraction(i) - 1.0, at_y, c->shape + i * n);
    for (int q = 0; q < n; q++) {
        const double *at_point = s.scratch + q * (n + 1) + 1;
        double sum = 0.0;
        for (int j = 0; j < n; j++) sum += (j % 2 ? -1.0 : 1.0) * (2 * j + 1) * at_point[j];
        c->slope[q] = g->weight[q] / p->chain_length * sum;
        c->inverse[q] = 1.0 / g->weight[q];
        c->hanging[q] = p->gravity * g->load[q] / g->weight[q];
    }
    c->fastest = mend_inertia(g, &s.reference, p->gravity, s.modes, s.taken);
}

static double longest_step(const Workspace *work) { return LONGEST_TURN / work->gauss->fastest; }

/* No axial waves. */
static double wave_step(const Workspace *work) {
    (void)work;
    return INFINITY;
}

static double error_share(int slack) {
    (void)slack; /* changes nothing */
    return FOURTH_ORDER_SHARE;
}

/* ---- the motion by nodes and by tangents ---- */

static Vector unit(Vector d) {
    double length = norm(d);
    return (Vector){d.x / length, d.y / length};
}

static Vector across(Vector u) { return (Vector){-u.y, u.x}; }

/* Tangent q of a motion's nodes: the length of a link is its weight. */
static Vector tangent(const struct GaussChain *c, const Vector *r, int q) {
    Vector link = along(r, q);
    return (Vector){link.x * c->inverse[q], link.y * c->inverse[q]};
}

static void turning_of(const struct GaussChain *c, const Motion *motion, Turning *t) {
    for (int q = 0; q < c->gauss.n; q++) {
        t->u[q] = tangent(c, motion->r, q);
        t->om[q] = dot(across(t->u[q]), along(motion->w, q)) * c->inverse[q];
    }
}

static void positions(const struct GaussChain *c, const Turning *t, Vector *r) {
    Vector sum = {0.0, 0.0};
    for (int q = 0; q < c->gauss.n; q++) {
        double w = c->gauss.weight[q];
        r[q] = sum = (Vector){sum.x + w * t->u[q].x, sum.y + w * t->u[q].y};
    }
}

static void velocities(const struct GaussChain *c, const Turning *t, Vector *w) {
    Vector sum = {0.0, 0.0};
    for (int q = 0; q < c->gauss.n; q++) {
        double rate = c->gauss.weight[q] * t->om[q];
        w[q] = sum = (Vector){sum.x - rate * t->u[q].y, sum.y + rate * t->u[q].x};
    }
}

static void posture(const Workspace *work, const Motion *motion, Posture *posture) {
    const struct GaussChain *c = work->gauss;
    int n = c->gauss.n;
    posture->node1 = (Vector){0.0, 0.0};
    posture->payload = motion->r[n - 1];
    posture->payload_w = motion->w[n - 1];
    for (int i = 0; i < POINTS; i++) posture->points[i] = (Vector){0.0, 0.0};
    for (int q = 0; q < n; q++) {
        Vector u = tangent(c, motion->r, q);
        posture->node1.x += c->slope[q] * u.x;
        posture->node1.y += c->slope[q] * u.y;
        for (int i = 0; i < POINTS; i++) {
            posture->points[i].x += c->shape[i * n + q] * u.x;
            posture->points[i].y += c->shape[i * n + q] * u.y;
        }
    }
}

/* ---- energies and momentum ---- */

/* g sum b_q (u_qy + 1), J. */
static double potential(const Workspace *work, const Vector *r) {
    const struct GaussChain *c = work->gauss;
    double sum = 0.0;
    for (int q = 0; q < c->gauss.n; q++) sum += c->gauss.load[q] * (tangent(c, r, q).y + 1.0);
    return work->chain.settings.gravity * sum;
}

/* sum b_q u'_qx, kg m/s. */
static double momentum(const Workspace *work, const Vector *w) {
    const struct GaussChain *c = work->gauss;
    double sum = 0.0;
    for (int q = 0; q < c->gauss.n; q++) sum += c->gauss.load[q] * (along(w, q).x * c->inverse[q]);
    return sum;
}

/* (M + m) v^2/2 + v sum b_q u'_qx + sum S_qr u'_q . u'_r/2, J. */
static double kinetic(const Workspace *work, const Vector *w, double trolley_v) {
    const struct GaussChain *c = work->gauss;
    int n = c->gauss.n;
    Vector *rate = c->rate;
    double relative = 0.0, total = work->chain.total_mass;
    for (int q = 0; q < n; q++) {
        const double *S = c->gauss.inertia + q * n;
        Vector d = along(w, q), sum = {0.0, 0.0};
        rate[q] = (Vector){d.x * c->inverse[q], d.y * c->inverse[q]};
        for (int r = 0; r < q; r++) {
            sum.x += S[r] * rate[r].x;
            sum.y += S[r] * rate[r].y;
        }
        relative += dot(rate[q], sum) + 0.5 * S[q] * dot(rate[q], rate[q]);
    }
    return relative + trolley_v * momentum(work, w) + 0.5 * total * trolley_v * trolley_v;
}

static double energy(const Workspace *work, const Motion *motion, double trolley_v) {
    return kinetic(work, motion->w, trolley_v) + potential(work, motion->r);
}

/* ---- dynamics ---- */

/* F_q = (fx w_q - b_q (a + alpha v), -g b_q), N m. */
static void apply_force(const Workspace *work, const Command *command, double trolley_v) {
    const struct GaussChain *c = work->gauss;
    const Settings *p = &work->chain.settings;
    double fx = command->payload_fx;
    double carried = command->trolley_a_cmd + p->damping_air * trolley_v;
    for (int q = 0; q < c->gauss.n; q++) {
        double b = c->gauss.load[q];
        c->force[q] = (Vector){fx * c->gauss.weight[q] - carried * b, -p->gravity * b};
    }
}

/* Factors L D L' of S_qr u_q.u_r into c->matrix and c->pivot. */
static void factor_inertia(const struct GaussChain *c) {
    int n = c->gauss.n;
    for (int q = 0; q < n; q++) {
        double *row = c->matrix + q * n, own = row[q];
        for (int r = 0; r < q; r++) {
            const double *other = c->matrix + r * n;
            double sum = row[r];
            for (int k = 0; k < r; k++) sum -= row[k] * other[k];
            row[r] = sum; /* L_qr D_r for now */
        }
        for (int r = 0; r < q; r++) {
            double scaled = row[r] * c->pivot[r];
            own -= row[r] * scaled;
            row[r] = scaled;
        }
        c->pivot[q] = 1.0 / own;
    }
}

static void solve_inertia(const struct GaussChain *c, double *x) {
    int n = c->gauss.n;
    for (int q = 0; q < n; q++)
        for (int r = 0; r < q; r++) x[q] -= c->matrix[q * n + r] * x[r];
    for (int q = 0; q < n; q++) x[q] *= c->pivot[q];
    for (int q = n - 1; q >= 0; q--)
        for (int r = 0; r < q; r++) x[r] -= c->matrix[q * n + r] * x[q];
}

/* sum_r S_qr u_q.u_r (al_r + alpha om_r) = n_q.F_q + sum_r S_qr om_r^2 n_q.u_r; om'. */
static void accelerate(const Workspace *work, const Turning *t, double *al) {
    const struct GaussChain *c = work->gauss;
    int n = c->gauss.n;
    double air = work->chain.settings.damping_air;
    for (int q = 0; q < n; q++) {
        const double *S = c->gauss.inertia + q * n;
        double *row = c->matrix + q * n, own = t->om[q] * t->om[q];
        Vector u = t->u[q];
        al[q] = dot(across(u), c->force[q]);
        for (int r = 0; r < q; r++) {
            double coupled = S[r] * cross(u, t->u[r]); /* n_q.u_r = -n_r.u_q */
            row[r] = S[r] * dot(u, t->u[r]);
            al[q] += coupled * (t->om[r] * t->om[r]);
            al[r] -= coupled * own;
        }
        row[q] = S[q] * dot(u, u);
    }
    factor_inertia(c);
    solve_inertia(c, al);
    for (int q = 0; q < n; q++) al[q] -= air * t->om[q];
}

/* T_q = u_q.(F_q - sum_r S_qr (u''_r + alpha u'_r))/w_q, N, with om' = al. */
static void tensions(const Workspace *work, const Turning *t, const double *al, double *tension) {
    const struct GaussChain *c = work->gauss;
    int n = c->gauss.n;
    double air = work->chain.settings.damping_air;
    for (int q = 0; q < n; q++) {
        double turned = al[q] + air * t->om[q], own = t->om[q] * t->om[q];
        Vector n_q = across(t->u[q]), u = t->u[q];
        c->rate[q] = (Vector){turned * n_q.x - own * u.x, turned * n_q.y - own * u.y};
    }
    for (int q = 0; q < n; q++) {
        Vector sum = c->force[q];
        for (int r = 0; r < n; r++) {
            double S = c->gauss.inertia[q * n + r];
            sum.x -= S * c->rate[r].x;
            sum.y -= S * c->rate[r].y;
        }
        tension[q] = dot(t->u[q], sum) * c->inverse[q];
    }
}

static void straight(Workspace *work, double sway_angle, Motion *motion) {
    static const Command idle;
    struct GaussChain *c = work->gauss;
    for (int q = 0; q < c->gauss.n; q++) {
        c->stage.u[q] = (Vector){sin(sway_angle), -cos(sway_angle)};
        c->stage.om[q] = 0.0;
    }
    positions(c, &c->stage, motion->r);
    apply_force(work, &idle, 0.0);
    accelerate(work, &c->stage, c->rates->om);
    tensions(work, &c->stage, c->rates->om, motion->tension);
}

/* (M + m)(a + alpha v) + sum b_q (u''_qx + alpha u'_qx), N, at rest relative to the trolley. */
static double released_force(Workspace *work, const Motion *motion, double trolley_v) {
    static const Command idle;
    struct GaussChain *c = work->gauss;
    double sum = 0.0, carried = work->chain.settings.damping_air * trolley_v;
    turning_of(c, motion, &c->stage);
    apply_force(work, &idle, trolley_v);
    accelerate(work, &c->stage, c->rates->om);
    for (int q = 0; q < c->gauss.n; q++)
        sum += c->gauss.load[q] * (c->rates->om[q] * across(c->stage.u[q]).x);
    return work->chain.total_mass * carried + sum;
}

/* sum_r S_qr u_q.u_r dom_r = -n_qx b_q dv, and the tension after it. */
static int jump(Workspace *work, Motion *motion, const Command *command, double trolley_v,
                double dv) {
    struct GaussChain *c = work->gauss;
    Turning *t = &c->stage;
    int n = c->gauss.n;
    turning_of(c, motion, t);
    for (int q = 0; q < n; q++) {
        c->rates->om[q] = -dv * c->gauss.load[q] * across(t->u[q]).x;
        for (int r = 0; r <= q; r++)
            c->matrix[q * n + r] = c->gauss.inertia[q * n + r] * dot(t->u[q], t->u[r]);
    }
    factor_inertia(c);
    solve_inertia(c, c->rates->om);
    for (int q = 0; q < n; q++) t->om[q] += c->rates->om[q];
    memcpy(work->unknown, motion->w, (size_t)n * sizeof(Vector));
    velocities(c, t, motion->w);
    for (int q = 0; q < n; q++) work->unknown[q] = minus(motion->w[q], work->unknown[q]);
    apply_force(work, command, trolley_v);
    accelerate(work, t, c->rates->om);
    tensions(work, t, c->rates->om, motion->tension);
    return 0;
}

/* Of a stage: its place in the step, and the shares of the stages before. */
static const struct {
    double place, share[4];
} STAGE[STAGES] = {{0.0, {0.0}},
                   {1.0 / 6.0, {1.0 / 6.0}},
                   {1.0 / 3.0, {0.0, 1.0 / 3.0}},
                   {2.0 / 3.0, {1.0 / 3.0, -2.0 / 3.0, 1.0}},
                   {1.0, {0.0, 1.0, -1.0, 1.0}}};
static const double SHARE[STAGES] = {1.0 / 8.0, 0.0, 3.0 / 8.0, 3.0 / 8.0, 1.0 / 8.0};

/* The step's start moved for h s by as much of each stage's rates as ``share`` says. */
static void move(const struct GaussChain *c, int stages, const double *share, double h) {
    int n = c->gauss.n;
    const Turning *to = &c->stage;
    memcpy(to->u, c->first.u, (size_t)n * sizeof(Vector));
    memcpy(to->om, c->first.om, (size_t)n * sizeof(double));
    for (int i = 0; i < stages; i++) {
        const Turning *rate = &c->rates[i];
        double t = h * share[i];
        if (t == 0.0) continue;
        for (int q = 0; q < n; q++) {
            to->u[q].x += t * rate->u[q].x;
            to->u[q].y += t * rate->u[q].y;
            to->om[q] += t * rate->om[q];
        }
    }
}

/* Energy terms of a step from ``from``, with the nodes' velocities at h/3 and 2 h/3. */
static void step_result(const Workspace *work, const Motion *from, const Load *load, double h,
                        StepResult *result) {
    const Motion *end = &work->end;
    const Command *command = &load->command;
    int payload = work->chain.n - 1;
    double total = work->chain.total_mass, air = work->chain.settings.damping_air;
    double v0 = load->trolley_v, v1 = trolley_v_after(load, h), fx = command->payload_fx;
    double dx = h * trolley_v_after(load, 0.5 * h);
    double path = momentum(work, end->r) - momentum(work, from->r) + total * dx;
    double P0 = momentum(work, from->w) + total * v0, P1 = momentum(work, end->w) + total * v1;
    result->trolley_fx = (P1 - P0 + air * path) / h - fx;
    result->work_trolley = P1 * v1 - P0 * v0 - command->trolley_a_cmd * path - fx * dx;
    result->work_payload = payload_work(command, minus(end->r[payload], from->r[payload]), dx);
    result->dissipated = 0.0;
    if (air != 0.0) {
        const Vector *w[] = {from->w, work->d0, work->d1, end->w};
        for (int i = 0; i < 4; i++) {
            double v = trolley_v_after(load, i * h / 3.0);
            double share = air * h / 8.0 * (i % 3 ? 3.0 : 1.0);
            result->work_trolley += share * (momentum(work, w[i]) + total * v) * v;
            result->dissipated += 2.0 * share * kinetic(work, w[i], v);
        }
    }
    result->iterations = 1;
}

/* One explicit Runge-Kutta step. */
static Outcome step(Workspace *work, const Motion *from, const Load *load, double h,
                    StepResult *result) {
    struct GaussChain *c = work->gauss;
    const Turning *at = &c->stage;
    int n = c->gauss.n;
    const Command command = load->command; /* a copy, as in the truss */
    double ratio = 1.0, *tension = work->end.tension;
    result->iterations = 1;
    for (int q = 0; q < n; q++) ratio = larger(ratio, from->tension[q] / c->hanging[q]);
    if (!(h * c->fastest * sqrt(ratio) <= FASTEST_TURN)) return NOT_CONVERGED;
    turning_of(c, from, &c->first);
    for (int i = 0; i < STAGES; i++) {
        const Turning *rate = &c->rates[i];
        move(c, i, STAGE[i].share, h);
        apply_force(work, &command, trolley_v_after(load, STAGE[i].place * h));
        accelerate(work, at, rate->om);
        for (int q = 0; q < n; q++)
            rate->u[q] = (Vector){-at->om[q] * at->u[q].y, at->om[q] * at->u[q].x};
        if (i == 2) {
            tensions(work, at, rate->om, tension);
            velocities(c, at, work->d0);
        } else if (i == 3) {
            tensions(work, at, rate->om, work->l0);
            velocities(c, at, work->d1);
        }
    }
    for (int q = 0; q < n; q++) tension[q] = 0.5 * (tension[q] + work->l0[q]);
    move(c, STAGES, SHARE, h);
    for (int q = 0; q < n; q++) at->u[q] = unit(at->u[q]);
    positions(c, at, work->end.r);
    velocities(c, at, work->end.w);
    work->end.last_h = 0.0;
    step_result(work, from, load, h, result);
    return DONE;
}

const Formulation INEXTENSIBLE = {.memory = memory,
                                  .prepare = prepare,
                                  .longest_step = longest_step,
                                  .wave_step = wave_step,
                                  .step_energy_tolerance = SMOOTH_ENERGY_TOLERANCE,
                                  .error_share = error_share,
                                  .straight = straight,
                                  .potential = potential,
                                  .energy = energy,
                                  .momentum = momentum,
                                  .released_force = released_force,
                                  .posture = posture};

const Scheme INEXTENSIBLE_SCHEME = {jump, step};
