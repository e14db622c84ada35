/* The linear crane, a taut string with a point mass, stepped exactly; the twin of
   chaincrane/plant/linear.py.

   Source: Maourane & Szabo, Pollack Periodica 15(2), 2020, 82-93, section 2.2 (its numbers in
   brackets), with the corrections that documentation/EQUATIONS.md lists.

   linear.py takes its modes from dense matrices. Here both matrices stay tridiagonal: Sturm's counts
   and bisection give the frequencies, and a twisted factorisation each shape (Parlett & Dhillon,
   Linear Algebra Appl. 267, 1997), one mode after the other. Of a shape only what outputs and loads
   look at is kept. So modes take O(n^2) time and O(n) memory. */

#include <string.h>

#include "crane.h"

enum { GAUSS_POINTS = sizeof GAUSS_NODES / sizeof *GAUSS_NODES };

static const double PIVOT = 1e-100;   /* of the largest entry, in the place of one that vanishes */
static const double ABOVE_ALL = 1e-9; /* of the bound of omega^2, that no mode is missed */

/* Modal coordinates, m sqrt(kg), and their rates: q = shapes eta. */
typedef struct {
    double *eta, *rate;
} ModalMotion;

/* The state: numbers by name, then eta, rate and the rate of rate (n each). */
typedef struct {
    Chain chain;
    double node1_y, payload_y;         /* m, at rest */
    double depth[POINTS];              /* m, y of the points at rest */
    double *squares;                   /* rad2/s2, omega^2, ascending */
    double *push;                      /* sqrt(kg), modal load of a trolley acceleration */
    double *node1, *payload;           /* 1/sqrt(kg), rows of the shapes */
    double *points;                    /* 1/sqrt(kg), of the points: POINTS to each mode */
    double response_h, *s, *s_dot;     /* free response after response_h, s */
    ModalMotion jumped, at;            /* work: after a jump; at a point of quadrature */
    double *K_diagonal, *K_coupling;   /* N/m, of (31): node i, and nodes i, i + 1 */
    double pivot;                      /* N/m, in the place of one that vanishes */
    double *down, *up, *nodal, *other; /* work of the modes */
    LinearState *head;
    ModalMotion motion;
    double *rate_of_rate;
} LinearCrane;

static double product(const double *a, const double *b, int n) {
    double sum = 0.0;
    for (int i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

/* ---- modes: K phi = omega^2 M phi, phi^T M phi = 1 ---- */

/* Stiffness matrix (31) of the elements' N_e/L0 [1 -1; -1 1], (30). */
static void stiffness_matrix(LinearCrane *c) {
    for (int i = 0; i < c->chain.n; i++) {
        double above = hanging_tension(&c->chain, i) / c->chain.L0;
        double below = i < c->chain.n - 1 ? hanging_tension(&c->chain, i + 1) / c->chain.L0 : 0.0;
        c->K_diagonal[i] = above + below;
        c->K_coupling[i] = -below;
    }
}

/* K - lambda M, N/m: its diagonal, and what couples nodes i and i + 1. */
static double pencil_diagonal(const LinearCrane *c, double lambda, int i) {
    return c->K_diagonal[i] - lambda * node_mass(&c->chain, i);
}

static double pencil_coupling(const LinearCrane *c, double lambda, int i) {
    return c->K_coupling[i] - lambda * c->chain.coupling;
}

static double safe(const LinearCrane *c, double pivot) { return pivot == 0.0 ? c->pivot : pivot; }

/* Sturm's count: how many omega^2 are below lambda, the negative pivots of K - lambda M. */
static int count_below(const LinearCrane *c, double lambda) {
    double pivot = safe(c, pencil_diagonal(c, lambda, 0));
    int count = pivot < 0.0;
    for (int i = 1; i < c->chain.n; i++) {
        double b = pencil_coupling(c, lambda, i - 1);
        pivot = safe(c, pencil_diagonal(c, lambda, i) - b * b / pivot);
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
    int n = c->chain.n, twist = 0;
    double *down = c->down, *up = c->up, least = INFINITY;
    for (int i = 0; i < n; i++) {
        double b = i > 0 ? pencil_coupling(c, lambda, i - 1) : 0.0;
        down[i] = pencil_diagonal(c, lambda, i);
        if (i > 0) down[i] = safe(c, down[i] - b * b / safe(c, down[i - 1]));
    }
    for (int i = n - 1; i >= 0; i--) {
        double b = i < n - 1 ? pencil_coupling(c, lambda, i) : 0.0, own;
        own = up[i] = pencil_diagonal(c, lambda, i);
        if (i < n - 1) up[i] = safe(c, own - b * b / safe(c, up[i + 1]));
        double left = fabs(down[i] + up[i] - own);
        if (left < least) {
            least = left;
            twist = i;
        }
    }
    shape[twist] = 1.0;
    for (int i = twist - 1; i >= 0; i--)
        shape[i] = -pencil_coupling(c, lambda, i) / safe(c, down[i]) * shape[i + 1];
    for (int i = twist + 1; i < n; i++)
        shape[i] = -pencil_coupling(c, lambda, i - 1) / safe(c, up[i]) * shape[i - 1];
}

/* omega^2 of a shape by Rayleigh's quotient: element by element it is exact in its small digits. */
static double normalise(const LinearCrane *c, double *shape) {
    double mass = 0.0, stiffness = 0.0;
    for (int i = 0; i < c->chain.n; i++) mass += shape[i] * mass_row(&c->chain, shape, 1, i);
    double scale = 1.0 / sqrt(mass);
    if (shape[c->chain.n - 1] < 0.0) scale = -scale; /* the same sign on every machine */
    for (int i = 0; i < c->chain.n; i++) shape[i] *= scale;
    for (int e = 0; e < c->chain.n; e++) {
        double slope = shape[e] - (e ? shape[e - 1] : 0.0);
        stiffness += hanging_tension(&c->chain, e) / c->chain.L0 * slope * slope;
    }
    return stiffness;
}

/* Frequencies, and what is looked at of the shapes; the start's modal coordinates, too. */
static void modes(LinearCrane *c) {
    /* no omega^2 is above the largest one of an element alone */
    double element = c->chain.settings.chain_mass / c->chain.n, low = 0.0;
    double high = 2.0 * hanging_tension(&c->chain, 0) / c->chain.L0 /
                  (0.5 * element - 2.0 * c->chain.coupling - c->chain.end_coupling);
    double *shape = c->nodal, *straight = c->other;
    high *= 1.0 + ABOVE_ALL;
    stiffness_matrix(c);
    c->pivot = PIVOT * larger(c->K_diagonal[0], high * node_mass(&c->chain, c->chain.n - 1));
    for (int i = 0; i < c->chain.n; i++)
        straight[i] = c->chain.L0 * (i + 1) * sin(c->chain.settings.initial_sway_angle);
    for (int mode = 0; mode < c->chain.n; mode++) {
        double lambda = low = bisect(c, mode, low, high);
        shape_of(c, lambda, shape);
        c->squares[mode] = normalise(c, shape);
        c->push[mode] = c->motion.eta[mode] = 0.0;
        for (int i = 0; i < c->chain.n; i++) {
            c->push[mode] += shape[i] * row_mass(&c->chain, i);
            c->motion.eta[mode] += shape[i] * mass_row(&c->chain, straight, 1, i);
        }
        c->node1[mode] = shape[0];
        c->payload[mode] = shape[c->chain.n - 1];
        for (int point = 0; point < POINTS; point++)
            c->points[mode * POINTS + point] =
                interpolate(&c->chain, shape, 1, material_fraction(point));
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
    for (int i = 0; i < c->chain.n; i++)
        free_response(c->squares[i], c->chain.settings.damping_air, h, &c->s[i], &c->s_dot[i]);
    c->response_h = h;
}

/* Kinetic energy, J, that the trolley's velocity adds to the relative motion's. */
static double carried(const LinearCrane *c, ModalMotion motion, double trolley_v) {
    return trolley_v * product(c->push, motion.rate, c->chain.n) +
           0.5 * c->chain.total_mass * trolley_v * trolley_v;
}

/* 1/2 v^T M v + 1/2 q^T K q, J, with absolute velocities v, in modal coordinates. */
static double energy(const LinearCrane *c, ModalMotion motion, double trolley_v) {
    double elastic = 0.0;
    for (int i = 0; i < c->chain.n; i++) elastic += c->squares[i] * motion.eta[i] * motion.eta[i];
    return 0.5 * product(motion.rate, motion.rate, c->chain.n) + 0.5 * elastic +
           carried(c, motion, trolley_v);
}

/* Horizontal momentum of chain and payload, kg m/s. */
static double momentum(const LinearCrane *c, ModalMotion motion, double trolley_v) {
    return product(c->push, motion.rate, c->chain.n) + c->chain.total_mass * trolley_v;
}

/* Modal load p0 + p1 t of a trolley at v + a t in air, and of the payload's force. */
static double load_now(const LinearCrane *c, double v, const Command *command, int i) {
    double air = c->chain.settings.damping_air;
    return -c->push[i] * (command->trolley_a_cmd + air * v) + c->payload[i] * command->payload_fx;
}

static double load_slope(const LinearCrane *c, const Command *command, int i) {
    return -c->push[i] * (c->chain.settings.damping_air * command->trolley_a_cmd);
}

/* Exact motion of a mode after t s: the matrix exponential of (32), a 2x2 block for each mode.

   eta'' + alpha eta' + omega^2 eta = p0 + p1 t has the particular solution c0 + c1 t. */
static void propagate_mode(const LinearCrane *c, ModalMotion from, double v, const Command *command,
                           int i, double t, double s, double s_dot, ModalMotion to) {
    double air = c->chain.settings.damping_air, square = c->squares[i];
    double c1 = load_slope(c, command, i) / square;
    double c0 = (load_now(c, v, command, i) - air * c1) / square;
    double eta = from.eta[i] - c0, rate = from.rate[i] - c1;
    to.eta[i] = (s_dot + air * s) * eta + s * rate + c0 + c1 * t;
    to.rate[i] = s_dot * rate - square * s * eta + c1;
}

/* What the air takes in a step, alpha v^T M v, and the drive's work against its drag, J.

   Gauss quadrature of the exact motion, four points to each panel of at most DRAG_PANEL. */
static void drag(LinearCrane *c, ModalMotion motion, double h, double v, const Command *command,
                 double *taken, double *work) {
    double air = c->chain.settings.damping_air, count = equal_parts(h, DRAG_PANEL);
    int n = c->chain.n;
    *taken = *work = 0.0;
    if (air == 0.0) return;
    double width = h / count;
    for (double i = 0.0; i < count; i += 1.0) {
        for (int k = 0; k < GAUSS_POINTS; k++) {
            double t = (i + 0.5 * (1.0 + GAUSS_NODES[k])) * width;
            double trolley_v = v + command->trolley_a_cmd * t;
            for (int mode = 0; mode < n; mode++) {
                double s, s_dot;
                free_response(c->squares[mode], air, t, &s, &s_dot);
                propagate_mode(c, motion, v, command, mode, t, s, s_dot, c->at);
            }
            double relative = 0.5 * product(c->at.rate, c->at.rate, n);
            double kinetic = relative + carried(c, c->at, trolley_v);
            double weight = 0.5 * GAUSS_WEIGHTS[k] * width * air;
            *taken += weight * 2.0 * kinetic;
            *work += weight * momentum(c, c->at, trolley_v) * trolley_v;
        }
    }
}

/* Force of the drive on the chain, N: node 0's row of (31). */
static double drive_force(const LinearCrane *c, double trolley_v, const Command *command) {
    const Chain *chain = &c->chain;
    double q = product(c->node1, c->motion.eta, chain->n);
    double rate = product(c->node1, c->motion.rate, chain->n);
    double acceleration = product(c->node1, c->rate_of_rate, chain->n);
    double air = chain->settings.damping_air, node1 = acceleration + air * rate;
    double payload = product(c->payload, c->rate_of_rate, chain->n) +
                     air * product(c->payload, c->motion.rate, chain->n);
    return carried_force(chain, command, trolley_v, node1, payload) -
           hanging_tension(chain, 0) / chain->L0 * q;
}

static Outcome step(void *memory, double h, const Command *command, Failure *failure) {
    LinearCrane *c = memory;
    SharedState *shared = &c->head->shared;
    int n = c->chain.n;
    (void)failure; /* an exact step does not fail */
    if (!is_allowed(shared, &c->chain.settings, h, command)) return BAD_VALUE;
    double v = commanded(shared, command);
    double a_cmd = command->trolley_a_cmd, air = c->chain.settings.damping_air;
    double before_v = shared->trolley_v, end_v = v + h * a_cmd, dv = v - before_v;
    double trolley_dx = h * (v + 0.5 * h * a_cmd);
    double taken, drag_work, path = 0.0;
    Vector payload_moved = {0.0, 0.0};

    /* a jump of velocity is an impulse -b dv on the free nodes */
    ModalMotion jumped = c->jumped;
    double before_momentum = momentum(c, c->motion, before_v);
    for (int i = 0; i < n; i++) {
        jumped.eta[i] = c->motion.eta[i];
        jumped.rate[i] = c->motion.rate[i] - c->push[i] * dv;
    }
    double start_momentum = momentum(c, jumped, v);
    double impulse = start_momentum - before_momentum;
    double jump_work = 0.5 * (v + before_v) * impulse;
    drag(c, jumped, h, v, command, &taken, &drag_work);
    prepare_response(c, h);
    for (int i = 0; i < n; i++) {
        propagate_mode(c, jumped, v, command, i, h, c->s[i], c->s_dot[i], c->motion);
        double moved = c->motion.eta[i] - jumped.eta[i];
        payload_moved.x += c->payload[i] * moved;
        path += c->push[i] * moved;
        c->rate_of_rate[i] = load_now(c, v, command, i) + h * load_slope(c, command, i) -
                             air * c->motion.rate[i] - c->squares[i] * c->motion.eta[i];
    }
    /* The drive gives all change of horizontal momentum P that the payload's force and the air
       do not: with v = v0 + a t its work is the integral of (P' - fx + drag) v. */
    double drive_work = momentum(c, c->motion, end_v) * end_v - start_momentum * v -
                        a_cmd * (path + c->chain.total_mass * trolley_dx) -
                        command->payload_fx * trolley_dx + drag_work;
    shared->ledger_trolley += jump_work + drive_work;
    shared->ledger_payload += payload_work(command, payload_moved, trolley_dx);
    shared->ledger_dissipated += taken;
    c->head->trolley_fx = drive_force(c, end_v, command);
    shared->trolley_impulse = impulse;
    move_trolley(shared, h, command);
    shared->time += h;
    shared->steps = 1.0;
    shared->iterations = 0.0;
    return DONE;
}

/* The string's displacements at the rest position's depths. */
static void outputs(const void *memory, Outputs *o) {
    const LinearCrane *c = memory;
    const SharedState *shared = &c->head->shared;
    const ModalMotion *motion = &c->motion;
    int n = c->chain.n;
    double q[POINTS] = {0.0};
    for (int mode = 0; mode < n; mode++) /* all points together: many short sums are fast */
        for (int point = 0; point < POINTS; point++)
            q[point] += c->points[mode * POINTS + point] * motion->eta[mode];
    Posture posture = {.node1 = {product(c->node1, motion->eta, n), c->node1_y},
                       .payload = {product(c->payload, motion->eta, n), c->payload_y},
                       .payload_w = {product(c->payload, motion->rate, n), 0.0}};
    for (int point = 0; point < POINTS; point++)
        posture.points[point] = (Vector){q[point], c->depth[point]};
    shared_outputs(shared, &posture, energy(c, *motion, shared->trolley_v), o);
    o->trolley_fx = c->head->trolley_fx;
    o->chain_slack_time = 0.0;
    o->error_payload = o->error_tension_top = o->error_trolley_fx = 0.0;
    o->error_predictable = 1.0;
    o->chain_tension_top = hanging_tension(&c->chain, 0);
    o->chain_tension_min = hanging_tension(&c->chain, n - 1);
}

/* ---- memory ---- */

static size_t state_count(const Settings *settings) {
    return sizeof(LinearState) / sizeof(double) + 3 * (size_t)settings->chain_elements;
}

enum { ARRAYS = 16 + POINTS }; /* of n doubles, besides the state */

static size_t head_size(void) { return (sizeof(LinearCrane) + 15) / 16 * 16; }

static size_t memory_size(const Settings *settings) {
    size_t arrays = ARRAYS * (size_t)settings->chain_elements;
    return head_size() + (arrays + state_count(settings)) * sizeof(double);
}

/* Depths of the rest position, which the string keeps. */
static void hang(LinearCrane *c) {
    double y = 0.0, *rest = c->nodal;
    for (int e = 0; e < c->chain.n; e++) {
        y -= hanging_length(&c->chain, hanging_tension(&c->chain, e));
        rest[e] = y;
    }
    c->node1_y = rest[0];
    c->payload_y = y;
    for (int point = 0; point < POINTS; point++)
        c->depth[point] = interpolate(&c->chain, rest, 1, material_fraction(point));
}

static void create(void *memory, const Settings *settings) {
    static const Command idle;
    LinearCrane *c = memory;
    int n = (int)settings->chain_elements;
    memset(memory, 0, memory_size(settings));
    discretise(&c->chain, settings);
    double *next = (double *)((char *)memory + head_size());
    double **arrays[ARRAYS - POINTS] = {&c->squares, &c->push,    &c->node1,      &c->payload,
                                        &c->s,       &c->s_dot,   &c->jumped.eta, &c->jumped.rate,
                                        &c->at.eta,  &c->at.rate, &c->K_diagonal, &c->K_coupling,
                                        &c->down,    &c->up,      &c->nodal,      &c->other};
    for (int i = 0; i < ARRAYS - POINTS; i++, next += n) *arrays[i] = next;
    c->points = next;
    next += POINTS * n;
    c->head = (LinearState *)next;
    c->motion.eta = next + sizeof(LinearState) / sizeof(double);
    c->motion.rate = c->motion.eta + n;
    c->rate_of_rate = c->motion.rate + n;
    hang(c);
    modes(c);
    c->head->shared.trolley_v = settings->initial_speed;
    for (int i = 0; i < n; i++)
        c->rate_of_rate[i] =
            load_now(c, settings->initial_speed, &idle, i) - c->squares[i] * c->motion.eta[i];
    c->head->trolley_fx = drive_force(c, settings->initial_speed, &idle);
    c->head->shared.ledger_start = energy(c, c->motion, settings->initial_speed);
}

static SharedState *shared(void *memory) { return &((LinearCrane *)memory)->head->shared; }

static size_t save(const void *memory, double *state) {
    const LinearCrane *c = memory;
    return save_plain((double *)c->head, state_count(&c->chain.settings), state);
}

static int load(void *memory, const double *state, size_t count) {
    LinearCrane *c = memory;
    return load_plain((double *)c->head, state_count(&c->chain.settings), state, count);
}

static const char *notice(const void *memory) {
    (void)memory; /* an exact step has nothing to say */
    return NULL;
}

static double longest_part(const Settings *settings) { return settings->solver_max_step; }

const CraneModel CRANE = {.memory = memory_size,
                          .create = create,
                          .step = step,
                          .outputs = outputs,
                          .notice = notice,
                          .shared = shared,
                          .state_count = state_count,
                          .save = save,
                          .load = load,
                          .keep = save,
                          .undo = load,
                          .longest_part = longest_part};
