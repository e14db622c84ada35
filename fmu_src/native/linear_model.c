/* The linear crane in C99: the same equations as chaincrane/linear.py, a taut string with a point
   mass, stepped exactly.

   Source: Maourane & Szabo, Pollack Periodica 15(2), 2020, 82-93, section 2.2 (its numbers in
   brackets), with the corrections that README lists. Node 0 is the trolley; nodes 1..n are entries
   0..n-1 of an array, and so are modes. Units: m, kg, s, N, J, rad.

   linear.py takes its modes from dense matrices. Here both matrices are tridiagonal, and stay so:
   the frequencies come from Sturm's counts and bisection, each shape from a twisted factorisation
   (Parlett & Dhillon, Linear Algebra Appl. 267, 1997), mode by mode. Of a shape only what is looked
   at is kept. So modes take O(n^2) time and O(n) memory: 1000 elements half a second or less. */

#include "model.h"

#include <math.h>
#include <string.h>

enum { POINTS = CHAIN_MATERIAL_POINTS + 1 }; /* ten material points from the top, then the middle */
enum { GAUSS_POINTS = 4 };

static const double GAUSS_NODES[GAUSS_POINTS] = {-0.86113631159405257, -0.33998104358485626,
                                                 0.33998104358485626, 0.86113631159405257};
static const double GAUSS_WEIGHTS[GAUSS_POINTS] = {0.34785484513745385, 0.65214515486254614,
                                                   0.65214515486254614, 0.34785484513745385};
static const double CRITICAL = 1e-5; /* |kappa t| below which damping counts as critical */
static const double PIVOT = 1e-300;  /* in the place of a pivot that vanishes */

/* State: this header, then eta, rate and the rate of rate (n each), in the order of
   LinearCrane.save(). */
typedef struct {
    double time, trolley_x, trolley_v, trolley_gained;    /* s, m, m/s, m/s */
    double steps, iterations;                             /* of the last communication step */
    double start, work_trolley, work_payload, dissipated; /* the ledger, J */
    double trolley_fx;                                    /* N */
} Header;

/* Modal coordinates, m sqrt(kg), and their rates: q = shapes eta. */
typedef struct {
    double *eta, *rate;
} Motion;

/* What drives the string during a step. */
typedef struct {
    double v, a, payload_fx; /* m/s at its start, m/s2, N */
} Load;

typedef struct {
    ChainSettings settings;
    int n;
    double L0;                          /* m, unstretched element */
    double inner_mass, end_mass;        /* kg, mass matrix: diagonal, its last entry */
    double coupling;                    /* kg, off the diagonal; node 0 and node 1 too */
    double row_mass, end_row, row_mass0; /* kg, its row sums: inner, last, node 0's */
    double total_mass;                  /* kg, chain and payload */
    double depth[POINTS];               /* m, y of the points at rest */
    double node1_y, payload_y;          /* m, at rest */
    double *squares;                    /* rad2/s2, omega^2, ascending */
    double *push;                       /* sqrt(kg), modal load of a trolley acceleration */
    double *node1, *payload;            /* 1/sqrt(kg), rows of the shapes */
    double *points;                     /* 1/sqrt(kg), of the points: POINTS to each mode */
    double response_h, *s, *s_dot;      /* free response after response_h, s */
    Motion jumped, at;                  /* work: after a jump; at a point of quadrature */
    double *K_diagonal, *K_coupling;    /* N/m, of (31): node i, and nodes i, i + 1 */
    double *down, *up, *nodal, *other;  /* work of the modes */
    Header *head;
    Motion motion;
    double *rate_of_rate;
} LinearCrane;

/* ---- chain.py ---- */

static double mass_diagonal(const LinearCrane *c, int i) {
    return i < c->n - 1 ? c->inner_mass : c->end_mass;
}

static double row_mass(const LinearCrane *c, int i) { return i < c->n - 1 ? c->row_mass : c->end_row; }

/* Tension of an element in the hanging equilibrium, N: the payload and the chain below it. */
static double hanging_tension(const LinearCrane *c, int e) {
    int below = c->n - 1 - e;
    double element = c->settings.mass / c->n;
    return c->settings.gravity * (c->settings.payload_mass + element * (below + 0.5));
}

/* Nodal values at a fraction of the chain's length, (7)-(8). */
static double interpolate(const double *nodal, int n, double fraction) {
    double place = fraction * n, whole = floor(place + 1e-9);
    int upper = whole < n - 1 ? (int)whole : n - 1;
    double share = place - upper, value = share * nodal[upper];
    return upper > 0 ? value + (1.0 - share) * nodal[upper - 1] : value;
}

static double fraction(int point) {
    return point < CHAIN_MATERIAL_POINTS ? (double)(point + 1) / CHAIN_MATERIAL_POINTS : 0.5;
}

static double dot(const double *a, const double *b, int n) {
    double sum = 0.0;
    for (int i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

/* Mass matrix (11) and rest position of the chain cut into equal elements. */
static void discretise(LinearCrane *c) {
    const ChainSettings *p = &c->settings;
    double element = p->mass / c->n, y = 0.0, *rest = c->nodal;
    c->L0 = p->length / c->n;
    c->coupling = p->mass_matrix == CHAIN_AVERAGED ? element / 12.0 : element / 6.0;
    c->inner_mass = element - 2.0 * c->coupling;
    c->end_mass = 0.5 * element - c->coupling + p->payload_mass;
    c->row_mass = element;
    c->end_row = 0.5 * element + p->payload_mass;
    c->row_mass0 = 0.5 * element;
    c->total_mass = p->mass + p->payload_mass;
    for (int e = 0; e < c->n; e++) {
        y -= c->L0 * (1.0 + hanging_tension(c, e) / p->EA);
        rest[e] = y;
    }
    c->node1_y = rest[0];
    c->payload_y = y;
    for (int point = 0; point < POINTS; point++)
        c->depth[point] = interpolate(rest, c->n, fraction(point));
}

/* ---- modes: K phi = omega^2 M phi, phi^T M phi = 1 ---- */

/* Stiffness matrix (31) of the elements' N_e/L0 [1 -1; -1 1], (30). */
static void stiffness_matrix(LinearCrane *c) {
    for (int i = 0; i < c->n; i++) {
        double above = hanging_tension(c, i) / c->L0;
        double below = i < c->n - 1 ? hanging_tension(c, i + 1) / c->L0 : 0.0;
        c->K_diagonal[i] = above + below;
        c->K_coupling[i] = -below;
    }
}

/* K - lambda M, N/m: its diagonal, and what couples nodes i and i + 1. */
static double pencil_diagonal(const LinearCrane *c, double lambda, int i) {
    return c->K_diagonal[i] - lambda * mass_diagonal(c, i);
}

static double pencil_coupling(const LinearCrane *c, double lambda, int i) {
    return c->K_coupling[i] - lambda * c->coupling;
}

static double safe(double pivot) { return pivot == 0.0 ? PIVOT : pivot; }

/* Sturm's count: how many omega^2 are below lambda, the negative pivots of K - lambda M. */
static int count_below(const LinearCrane *c, double lambda) {
    double pivot = safe(pencil_diagonal(c, lambda, 0));
    int count = pivot < 0.0;
    for (int i = 1; i < c->n; i++) {
        double b = pencil_coupling(c, lambda, i - 1);
        pivot = safe(pencil_diagonal(c, lambda, i) - b * b / pivot);
        count += pivot < 0.0;
    }
    return count;
}

/* omega^2 of a mode, by bisection between two bounds, to the last digit that counts can tell. */
static double bisect(const LinearCrane *c, int mode, double low, double high) {
    for (;;) {
        double middle = 0.5 * (low + high);
        if (!(middle > low && middle < high)) return middle;
        if (count_below(c, middle) > mode) high = middle;
        else low = middle;
    }
}

/* A shape by the twisted factorisation of K - lambda M: pivots from the top and from the bottom
   meet where they leave the smallest remainder, and from there the shape unrolls both ways. */
static void shape_of(const LinearCrane *c, double lambda, double *shape) {
    int n = c->n, twist = 0;
    double *down = c->down, *up = c->up, least = INFINITY;
    for (int i = 0; i < n; i++) {
        double b = i > 0 ? pencil_coupling(c, lambda, i - 1) : 0.0;
        down[i] = pencil_diagonal(c, lambda, i);
        if (i > 0) down[i] = safe(down[i] - b * b / safe(down[i - 1]));
    }
    for (int i = n - 1; i >= 0; i--) {
        double b = i < n - 1 ? pencil_coupling(c, lambda, i) : 0.0, own;
        own = up[i] = pencil_diagonal(c, lambda, i);
        if (i < n - 1) up[i] = safe(own - b * b / up[i + 1]);
        double left = fabs(down[i] + up[i] - own);
        if (left < least) {
            least = left;
            twist = i;
        }
    }
    shape[twist] = 1.0;
    for (int i = twist - 1; i >= 0; i--)
        shape[i] = -pencil_coupling(c, lambda, i) / safe(down[i]) * shape[i + 1];
    for (int i = twist + 1; i < n; i++)
        shape[i] = -pencil_coupling(c, lambda, i - 1) / safe(up[i]) * shape[i - 1];
}

/* M times a nodal quantity, entry i. */
static double mass_times(const LinearCrane *c, const double *nodal, int i) {
    double product = mass_diagonal(c, i) * nodal[i];
    if (i > 0) product += c->coupling * nodal[i - 1];
    if (i < c->n - 1) product += c->coupling * nodal[i + 1];
    return product;
}

/* omega^2 of a shape by Rayleigh's quotient: element by element it is exact in its small digits. */
static double normalise(const LinearCrane *c, double *shape) {
    double mass = 0.0, stiffness = 0.0;
    for (int i = 0; i < c->n; i++) mass += shape[i] * mass_times(c, shape, i);
    double scale = 1.0 / sqrt(mass);
    if (shape[c->n - 1] < 0.0) scale = -scale; /* the same sign on every machine */
    for (int i = 0; i < c->n; i++) shape[i] *= scale;
    for (int e = 0; e < c->n; e++) {
        double slope = shape[e] - (e ? shape[e - 1] : 0.0);
        stiffness += hanging_tension(c, e) / c->L0 * slope * slope;
    }
    return stiffness;
}

/* Frequencies, and what is looked at of the shapes; the start's modal coordinates, too. */
static void modes(LinearCrane *c) {
    /* no omega^2 is above the largest one of an element alone */
    double element = c->settings.mass / c->n, low = 0.0;
    double high = 2.0 * hanging_tension(c, 0) / c->L0 / (0.5 * element - 2.0 * c->coupling);
    double *shape = c->nodal, *straight = c->other;
    high *= 1.0 + 1e-9;
    stiffness_matrix(c);
    for (int i = 0; i < c->n; i++)
        straight[i] = c->L0 * (i + 1) * sin(c->settings.sway_angle);
    for (int mode = 0; mode < c->n; mode++) {
        double lambda = low = bisect(c, mode, low, high);
        shape_of(c, lambda, shape);
        c->squares[mode] = normalise(c, shape);
        c->push[mode] = c->motion.eta[mode] = 0.0;
        for (int i = 0; i < c->n; i++) {
            c->push[mode] += shape[i] * row_mass(c, i);
            c->motion.eta[mode] += shape[i] * mass_times(c, straight, i);
        }
        c->node1[mode] = shape[0];
        c->payload[mode] = shape[c->n - 1];
        for (int point = 0; point < POINTS; point++)
            c->points[mode * POINTS + point] = interpolate(shape, c->n, fraction(point));
    }
}

/* ---- linear.py ---- */

/* Response of a mode after t s to a unit rate at 0, and its derivative:
   s(t) = exp(-alpha t/2) sinh(kappa t)/kappa, kappa = sqrt(alpha^2/4 - omega^2). */
static void free_response(double square, double air, double t, double *s, double *s_dot) {
    double kappa2 = 0.25 * air * air - square, kappa = sqrt(fabs(kappa2)), mean;
    if (kappa2 < 0.0) {
        double fade = exp(-0.5 * air * t);
        *s = fade * sin(kappa * t) / kappa;
        mean = fade * cos(kappa * t);
    } else {
        double slow = exp((kappa - 0.5 * air) * t), fast = exp((-kappa - 0.5 * air) * t);
        *s = (slow - fast) / (2.0 * kappa);
        mean = 0.5 * (slow + fast);
    }
    if (kappa * t < CRITICAL) *s = t * exp(-0.5 * air * t); /* the quotient's limit */
    *s_dot = mean - 0.5 * air * *s;
}

/* Free responses of all modes after h s, kept for the next step of the same size. */
static void prepare_response(LinearCrane *c, double h) {
    if (h == c->response_h) return;
    for (int i = 0; i < c->n; i++)
        free_response(c->squares[i], c->settings.damping_air, h, &c->s[i], &c->s_dot[i]);
    c->response_h = h;
}

/* Kinetic energy, J, that the trolley's velocity adds to the relative motion's. */
static double carried(const LinearCrane *c, Motion motion, double trolley_v) {
    return trolley_v * dot(c->push, motion.rate, c->n) + 0.5 * c->total_mass * trolley_v * trolley_v;
}

/* 1/2 v^T M v + 1/2 q^T K q, J, with absolute velocities v, in modal coordinates. */
static double energy(const LinearCrane *c, Motion motion, double trolley_v) {
    double elastic = 0.0;
    for (int i = 0; i < c->n; i++) elastic += c->squares[i] * motion.eta[i] * motion.eta[i];
    return 0.5 * dot(motion.rate, motion.rate, c->n) + 0.5 * elastic + carried(c, motion, trolley_v);
}

/* Horizontal momentum of chain and payload, kg m/s. */
static double momentum(const LinearCrane *c, Motion motion, double trolley_v) {
    return dot(c->push, motion.rate, c->n) + c->total_mass * trolley_v;
}

/* Modal load p0 + p1 t of a trolley at v + a t in air, and of the payload's force. */
static double load_now(const LinearCrane *c, Load load, int i) {
    double air = c->settings.damping_air;
    return -c->push[i] * (load.a + air * load.v) + c->payload[i] * load.payload_fx;
}

static double load_slope(const LinearCrane *c, Load load, int i) {
    return -c->push[i] * (c->settings.damping_air * load.a);
}

/* Exact motion of a mode after t s: the matrix exponential of (32), a 2x2 block for each mode.

   eta'' + alpha eta' + omega^2 eta = p0 + p1 t has the particular solution c0 + c1 t. */
static void propagate_mode(const LinearCrane *c, Motion from, Load load, int i, double t, double s,
                           double s_dot, Motion to) {
    double air = c->settings.damping_air, square = c->squares[i];
    double c1 = load_slope(c, load, i) / square;
    double c0 = (load_now(c, load, i) - air * c1) / square;
    double eta = from.eta[i] - c0, rate = from.rate[i] - c1;
    to.eta[i] = (s_dot + air * s) * eta + s * rate + c0 + c1 * t;
    to.rate[i] = s_dot * rate - square * s * eta + c1;
}

/* Number of equal internal steps; a ratio that is whole but for round-off counts as whole. */
static double internal_steps(double h, double max_step) {
    double count = ceil(h / max_step * (1.0 - 1e-9));
    return count > 1.0 ? count : 1.0;
}

/* What the air takes in a step, alpha v^T M v, and the drive's work against its drag, J.

   Gauss quadrature of the exact motion, four points to each of at most solver.max_step. */
static void drag(LinearCrane *c, Motion motion, double h, Load load, double *taken, double *work) {
    double air = c->settings.damping_air, count = internal_steps(h, c->settings.max_step);
    *taken = *work = 0.0;
    if (air == 0.0) return;
    double width = h / count;
    for (double i = 0.0; i < count; i += 1.0) {
        for (int k = 0; k < GAUSS_POINTS; k++) {
            double t = (i + 0.5 * (1.0 + GAUSS_NODES[k])) * width, trolley_v = load.v + load.a * t;
            for (int mode = 0; mode < c->n; mode++) {
                double s, s_dot;
                free_response(c->squares[mode], air, t, &s, &s_dot);
                propagate_mode(c, motion, load, mode, t, s, s_dot, c->at);
            }
            double kinetic =
                0.5 * dot(c->at.rate, c->at.rate, c->n) + carried(c, c->at, trolley_v);
            double weight = 0.5 * GAUSS_WEIGHTS[k] * width * air;
            *taken += weight * 2.0 * kinetic;
            *work += weight * momentum(c, c->at, trolley_v) * trolley_v;
        }
    }
}

/* Force of the drive on the chain, N: node 0's row of (31). */
static double drive_force(const LinearCrane *c, double trolley_v, double trolley_a) {
    double air = c->settings.damping_air;
    double q = dot(c->node1, c->motion.eta, c->n), rate = dot(c->node1, c->motion.rate, c->n);
    double acceleration = dot(c->node1, c->rate_of_rate, c->n);
    return c->row_mass0 * (trolley_a + air * trolley_v) + c->coupling * (acceleration + air * rate) -
           hanging_tension(c, 0) / c->L0 * q;
}

static int step(void *memory, double h, double v_cmd, double a_cmd, double payload_fx,
                ChainFailure *failure) {
    LinearCrane *c = memory;
    Header *head = c->head;
    int n = c->n;
    Load load = {v_cmd + head->trolley_gained, a_cmd, payload_fx};
    double before_v = head->trolley_v, end_v = load.v + h * a_cmd, dv = load.v - before_v;
    double trolley_dx = h * (load.v + 0.5 * h * a_cmd), air = c->settings.damping_air;
    double taken, drag_work, payload_moved = 0.0, path = 0.0;
    (void)failure; /* an exact step does not fail */

    /* a jump of velocity is an impulse -b dv on the free nodes */
    Motion jumped = c->jumped;
    double before_momentum = momentum(c, c->motion, before_v);
    for (int i = 0; i < n; i++) {
        jumped.eta[i] = c->motion.eta[i];
        jumped.rate[i] = c->motion.rate[i] - c->push[i] * dv;
    }
    double start_momentum = momentum(c, jumped, load.v);
    double jump_work = 0.5 * (load.v + before_v) * (start_momentum - before_momentum);
    drag(c, jumped, h, load, &taken, &drag_work);
    prepare_response(c, h);
    for (int i = 0; i < n; i++) {
        propagate_mode(c, jumped, load, i, h, c->s[i], c->s_dot[i], c->motion);
        double moved = c->motion.eta[i] - jumped.eta[i];
        payload_moved += c->payload[i] * moved;
        path += c->push[i] * moved;
        c->rate_of_rate[i] = load_now(c, load, i) + h * load_slope(c, load, i) -
                             air * c->motion.rate[i] - c->squares[i] * c->motion.eta[i];
    }
    /* The drive gives all change of horizontal momentum P that the payload's force and the air
       do not: with v = v0 + a t its work is the integral of (P' - fx + drag) v. */
    double drive_work = momentum(c, c->motion, end_v) * end_v - start_momentum * load.v -
                        a_cmd * (path + c->total_mass * trolley_dx) - payload_fx * trolley_dx +
                        drag_work;
    head->work_trolley += jump_work + drive_work;
    head->work_payload += payload_fx * (payload_moved + trolley_dx);
    head->dissipated += taken;
    head->trolley_fx = drive_force(c, end_v, a_cmd);
    head->trolley_x += h * load.v + 0.5 * h * h * a_cmd;
    head->trolley_gained += h * a_cmd;
    head->trolley_v = v_cmd + head->trolley_gained;
    head->time += h;
    head->steps = 1.0;
    head->iterations = 0.0;
    return CHAIN_OK;
}

/* The string's displacements at the rest position's depths. */
static void outputs(const void *memory, double values[CHAIN_OUTPUTS]) {
    const LinearCrane *c = memory;
    const Header *head = c->head;
    double x_rel = dot(c->payload, c->motion.eta, c->n), *out = values;
    double expected = head->start + head->work_trolley + head->work_payload - head->dissipated;
    double now = energy(c, c->motion, head->trolley_v), q[POINTS] = {0.0};
    for (int mode = 0; mode < c->n; mode++) /* all points together: many short sums are fast */
        for (int point = 0; point < POINTS; point++)
            q[point] += c->points[mode * POINTS + point] * c->motion.eta[mode];
    *out++ = head->trolley_x;
    *out++ = head->trolley_v;
    *out++ = head->trolley_fx;
    *out++ = head->trolley_x + x_rel;
    *out++ = c->payload_y;
    *out++ = head->trolley_v + dot(c->payload, c->motion.rate, c->n);
    *out++ = 0.0;
    *out++ = x_rel;
    *out++ = atan2(x_rel, -c->payload_y);
    *out++ = q[POINTS - 1];
    *out++ = atan2(dot(c->node1, c->motion.eta, c->n), -c->node1_y);
    *out++ = hanging_tension(c, 0);
    *out++ = hanging_tension(c, c->n - 1);
    for (int i = 0; i < CHAIN_MATERIAL_POINTS; i++) {
        out[i] = head->trolley_x + q[i];
        out[i + CHAIN_MATERIAL_POINTS] = c->depth[i];
    }
    out += 2 * CHAIN_MATERIAL_POINTS;
    *out++ = now;
    *out++ = head->dissipated;
    *out++ = now - expected;
    *out++ = head->steps;
    *out++ = head->iterations;
}

/* ---- memory ---- */

static size_t state_count(int elements) {
    return sizeof(Header) / sizeof(double) + 3 * (size_t)elements;
}

enum { ARRAYS = 16 + POINTS }; /* of n doubles, besides the state */

static size_t head_size(void) { return (sizeof(LinearCrane) + 15) / 16 * 16; }

static size_t memory_size(int elements) {
    return head_size() + (ARRAYS * (size_t)elements + state_count(elements)) * sizeof(double);
}

static void create(void *memory, const ChainSettings *settings) {
    LinearCrane *c = memory;
    int n = settings->elements;
    memset(memory, 0, memory_size(n));
    c->settings = *settings;
    c->n = n;
    double *next = (double *)((char *)memory + head_size());
    double **arrays[ARRAYS - POINTS] = {
        &c->squares,    &c->push,        &c->node1,  &c->payload, &c->s,         &c->s_dot,
        &c->jumped.eta, &c->jumped.rate, &c->at.eta, &c->at.rate, &c->K_diagonal, &c->K_coupling,
        &c->down,       &c->up,          &c->nodal,  &c->other};
    for (int i = 0; i < ARRAYS - POINTS; i++, next += n) *arrays[i] = next;
    c->points = next;
    next += POINTS * n;
    c->head = (Header *)next;
    c->motion.eta = next + sizeof(Header) / sizeof(double);
    c->motion.rate = c->motion.eta + n;
    c->rate_of_rate = c->motion.rate + n;
    discretise(c);
    modes(c);
    c->head->trolley_v = settings->speed;
    c->head->trolley_fx = drive_force(c, 0.0, 0.0);
    c->head->start = energy(c, c->motion, settings->speed);
}

static double *state(void *memory) { return (double *)((LinearCrane *)memory)->head; }

const CraneModel CRANE = {memory_size, create, step, outputs, state_count, state};
