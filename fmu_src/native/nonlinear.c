/* The nonlinear crane, a chain of truss elements; the twin of chaincrane/plant/nonlinear.py.

   Source: Maourane & Szabo, Pollack Periodica 15(2), 2020, 82-93, section 2.1 (its numbers in
   brackets), with the corrections that documentation/EQUATIONS.md lists. */

#include <string.h>

#include "energy_momentum.h"
#include "inextensible.h"
#include "jump.h"
#include "newmark.h"
#include "nonlinear.h"
#include "truss.h"

static const Formulation *const FORMULATION[] = {[CHAIN_FORMULATION_TRUSS] = &TRUSS,
                                                 [CHAIN_FORMULATION_INEXTENSIBLE] = &INEXTENSIBLE};

static const Scheme *const SCHEME[] = {[SOLVER_SCHEME_ENERGY_MOMENTUM] = &ENERGY_MOMENTUM_SCHEME,
                                       [SOLVER_SCHEME_NEWMARK] = &NEWMARK_SCHEME};

/* A state: numbers by name, then r (n), w (n), a (n) as x, y pairs, then tension and stretched (n). */
typedef struct {
    NonlinearState *head;
    Motion motion;
} State;

typedef struct {
    State state, trial;               /* committed, and during a communication step */
    State companion, trial_companion; /* a second solution, steps twice as long; head NULL: none */
    Workspace work;
    void *own; /* the formulation's memory */
} NonlinearCrane;

static const Formulation *formulation_of(const Settings *settings) {
    return FORMULATION[(int)settings->chain_formulation];
}

static double mechanical_energy(const Workspace *work, const Motion *motion, double trolley_v) {
    return formulation_of(&work->chain.settings)->energy(work, motion, trolley_v);
}

/* The largest so far of start above rest + (M + m) (v - v_start)^2/2 + |work of the payload's
   force|, J: what the trolley and that force can have put into the swing, in any frame; in air,
   + (M + m) v^2/2, what a wind of the trolley's speed can. */
static double energy_scale(const Chain *c, const NonlinearState *s, double trolley_v) {
    double speed = c->settings.initial_speed, changed = trolley_v - speed;
    double wind = c->settings.damping_air != 0.0 ? trolley_v : 0.0;
    double start = s->shared.ledger_start - 0.5 * c->total_mass * speed * speed;
    double put_in = start + 0.5 * c->total_mass * (changed * changed + wind * wind);
    return larger(s->scale, put_in + fabs(s->shared.ledger_payload));
}

/* The next step is a new start for the scheme. */
static void forget_load(const Chain *c, State *s) {
    s->head->loaded = 0.0;
    memset(&s->head->last_command, 0, sizeof s->head->last_command);
    for (int i = 0; i < c->n; i++) {
        s->motion.a[i] = (Vector){NAN, NAN};
        s->motion.stretched[i] = 0.0;
    }
    s->head->last_h = 0.0;
}

/* Whether the load jumps between two steps; the trolley's velocity is no load. */
static int jumps(const Command *before, const Command *after) {
    Command held = *before;
    const double *a = (const double *)&held, *b = (const double *)after;
    held.trolley_v_cmd = after->trolley_v_cmd;
    for (int i = 0; i < INPUTS; i++)
        if (a[i] != b[i]) return 1;
    return 0;
}

/* The scheme of a crane's settings. */
static const Scheme *scheme_of(const Chain *c) {
    if (c->settings.chain_formulation == CHAIN_FORMULATION_INEXTENSIBLE)
        return &INEXTENSIBLE_SCHEME;
    return SCHEME[(int)c->settings.solver_scheme];
}

/* Elements at the lengths of the tension that a jump requires, or as far on the way as keeps ``most``
   J; the energy then. */
static double settle(Workspace *work, Motion *motion, double trolley_v, double most,
                     double energy) {
    const Chain *c = &work->chain;
    size_t nodes = (size_t)c->n * sizeof(Vector);
    double share = 1.0;
    for (int i = 0; i < MAX_HALVINGS; i++) {
        settled(work, motion, share);
        double now = mechanical_energy(work, &work->end, trolley_v);
        if (now <= most) {
            for (int e = 0; e < c->n; e++) {
                double elastic = axial_force(c, norm(along(motion->r, e)));
                motion->tension[e] = elastic + share * (work->end.tension[e] - elastic);
            }
            memcpy(motion->r, work->end.r, nodes);
            memcpy(motion->w, work->end.w, nodes);
            return now;
        }
        share *= 0.5;
    }
    return energy;
}

/* The drive's impulse, N s: all change of momentum, by the nodes' velocities in work->unknown. */
static double drive_impulse(const Workspace *work, double dv) {
    const Chain *c = &work->chain;
    return c->total_mass * dv + formulation_of(&c->settings)->momentum(work, work->unknown);
}

/* The trolley's velocity jumps to ``after``; the drive's impulse works at the mean velocity. What the
   jump leaves out of axial vibrations is booked as dissipated. It can be negative, down to -JUMP_GAIN
   of the scale; a filtered impulse that would add more is given up for the plain one. */
static void jump(Workspace *work, State *s, const Command *command, double after) {
    const Chain *c = &work->chain;
    Motion *motion = &s->motion;
    SharedState *shared = &s->head->shared;
    size_t nodes = (size_t)c->n * sizeof(Vector);
    double before = shared->trolley_v, dv = after - before, mean = 0.5 * (before + after);
    shared->trolley_impulse = 0.0;
    if (dv == 0.0) return;
    memcpy(work->end.w, motion->w, nodes);
    int settles = scheme_of(c)->jump(work, motion, command, after, dv);
    double impulse = drive_impulse(work, dv), scale = energy_scale(c, s->head, after);
    double most = s->head->energy + mean * impulse + JUMP_GAIN * scale;
    double energy = mechanical_energy(work, motion, after);
    if (settles && energy > most) {
        memcpy(motion->w, work->end.w, nodes);
        settles = plain_jump(work, motion, command, after, dv);
        impulse = drive_impulse(work, dv);
        energy = mechanical_energy(work, motion, after);
    }
    if (settles) {
        energy = settle(work, motion, after, most, energy);
        shared->ledger_dissipated += s->head->energy + mean * impulse - energy;
    }
    shared->trolley_impulse = impulse;
    shared->ledger_trolley += mean * impulse;
    s->head->energy = energy;
    s->head->scale = scale;
    forget_load(c, s);
}

/* Energy now against before + work - dissipation: ``ledger`` is the expected energy now. */
static Outcome check_energy(const Chain *c, const NonlinearState *s, double ledger, double energy,
                            double h, Failure *failure) {
    double weight = c->settings.gravity * c->total_mass;
    double floor = ROUND_OFF_ENERGY * weight * c->settings.chain_length;
    double scale = s->scale;
    double total = energy - ledger, step = total - (s->energy - expected_energy(&s->shared));
    double allowed = formulation_of(&c->settings)->step_energy_tolerance;
    if (!(fabs(step) <= allowed * scale + floor)) {
        *failure = (Failure){0.0, h, step, scale, allowed};
        return STEP_ENERGY;
    }
    if (!(fabs(total) <= TOTAL_ENERGY_TOLERANCE * scale + floor)) {
        *failure = (Failure){0.0, h, total, scale, TOTAL_ENERGY_TOLERANCE};
        return TOTAL_ENERGY;
    }
    return DONE;
}

/* One step of the scheme; the state moves on if its energy balance is good. */
static Outcome attempt(Workspace *work, State *s, const Load *load, double h, Failure *failure) {
    const Chain *c = &work->chain;
    Motion *motion = &s->motion;
    const Motion *end = &work->end;
    NonlinearState *head = s->head;
    size_t nodes = (size_t)c->n * sizeof(Vector);
    StepResult result = {0};
    if (head->loaded != 0.0 && jumps(&head->last_command, &load->command))
        forget_load(c, s); /* accelerations start anew */
    motion->last_h = head->last_h;
    Outcome outcome = scheme_of(c)->step(work, motion, load, h, &result);
    head->shared.iterations += result.iterations;
    if (outcome != DONE) {
        *failure = (Failure){0.0, h, 0.0, 0.0, 0.0};
        return outcome;
    }
    NonlinearState next = *head;
    next.shared.ledger_trolley += result.work_trolley;
    next.shared.ledger_payload += result.work_payload;
    next.shared.ledger_dissipated += result.dissipated;
    next.energy = mechanical_energy(work, end, trolley_v_after(load, h));
    outcome = check_energy(c, head, expected_energy(&next.shared), next.energy, h, failure);
    if (outcome != DONE) return outcome;
    next.scale = energy_scale(c, &next, trolley_v_after(load, h));
    next.trolley_fx = result.trolley_fx;
    next.loaded = 1.0;
    next.last_command = load->command;
    next.last_h = end->last_h;
    for (int e = 0; e < c->n; e++)
        if (end->tension[e] < 0.0) {
            next.slack_time += h;
            break;
        }
    next.shared.steps += 1.0;
    *head = next;
    memcpy(motion->r, end->r, nodes);
    memcpy(motion->w, end->w, nodes);
    if (!is_nan(end->a[0].x)) memcpy(motion->a, end->a, nodes); /* newmark keeps them */
    memcpy(motion->tension, end->tension, (size_t)c->n * sizeof(double));
    memcpy(motion->stretched, end->stretched, (size_t)c->n * sizeof(double));
    return DONE;
}

/* One internal step; where it fails it is halved, at most MAX_HALVINGS times over. ``v``: the
   trolley's velocity at the communication step's start. */
static Outcome internal_step(Workspace *work, State *s, double v, const Command *command,
                             double elapsed, double h, int halvings, Failure *failure) {
    Load load = {v + elapsed * command->trolley_a_cmd, *command};
    Outcome outcome = attempt(work, s, &load, h, failure);
    if (outcome == DONE) return DONE;
    if (halvings == MAX_HALVINGS) {
        failure->time = s->head->shared.time + elapsed;
        return outcome;
    }
    h *= 0.5;
    outcome = internal_step(work, s, v, command, elapsed, h, halvings + 1, failure);
    if (outcome != DONE) return outcome;
    return internal_step(work, s, v, command, elapsed + h, h, halvings + 1, failure);
}

/* Doubles of one solution. */
static size_t solution_count(const Settings *settings) {
    return sizeof(NonlinearState) / sizeof(double) + 8 * (size_t)settings->chain_elements;
}

static int has_companion(const Settings *settings) {
    return settings->solver_error_estimate == SOLVER_ERROR_ESTIMATE_COMPANION ||
           settings->solver_tolerance > 0.0;
}

/* ---- companion.py ---- */

static int is_predictable(const Chain *c, const NonlinearState *s) {
    return s->error_payload <= UNPREDICTABLE * c->settings.chain_length;
}

/* Two steps and one twice as long, and how far apart they end; forces are the steps' means. */
static Outcome compared_step(NonlinearCrane *crane, double v, const Command *command,
                             double elapsed, double h, Failure *failure) {
    Workspace *work = &crane->work;
    State *fine = &crane->trial, *other = &crane->trial_companion;
    NonlinearState *head = fine->head;
    int payload = work->chain.n - 1;
    Outcome outcome = internal_step(work, fine, v, command, elapsed, h, 0, failure);
    if (outcome != DONE) return outcome;
    double tension = fine->motion.tension[0], force = head->trolley_fx;
    outcome = internal_step(work, fine, v, command, elapsed + h, h, 0, failure);
    if (outcome != DONE) return outcome;
    SharedState own = other->head->shared;
    if (internal_step(work, other, v, command, elapsed, 2.0 * h, 0, failure) != DONE) {
        const Settings *settings = &work->chain.settings; /* it goes on beside the finer one */
        memcpy(other->head, head, solution_count(settings) * sizeof(double));
        other->head->shared.steps = own.steps;
        other->head->shared.iterations = own.iterations;
        head->error_payload = larger(head->error_payload, settings->chain_length);
        return DONE;
    }
    Vector gap = minus(fine->motion.r[payload], other->motion.r[payload]);
    tension = 0.5 * (tension + fine->motion.tension[0]);
    force = 0.5 * (force + head->trolley_fx);
    int slack = head->slack_time > 0.0 || other->head->slack_time > 0.0;
    double share = formulation_of(&work->chain.settings)->error_share(slack);
    double of_forces = FORCE_SHARE * share;
    head->error_payload = larger(head->error_payload, share * norm(gap));
    head->error_tension_top =
        larger(head->error_tension_top, of_forces * fabs(tension - other->motion.tension[0]));
    head->error_trolley_fx =
        larger(head->error_trolley_fx, of_forces * fabs(force - other->head->trolley_fx));
    return DONE;
}

/* The companion's shared numbers are those of the solution beside it, but for its ledger. */
static void accompany(NonlinearState *companion, const NonlinearState *fine) {
    NonlinearState own = *companion;
    companion->shared = fine->shared;
    companion->shared.ledger_start = own.shared.ledger_start;
    companion->shared.ledger_trolley = own.shared.ledger_trolley;
    companion->shared.ledger_payload = own.shared.ledger_payload;
    companion->shared.ledger_dissipated = own.shared.ledger_dissipated;
    companion->waves = fine->waves;
    companion->error_payload = fine->error_payload;
    companion->error_tension_top = fine->error_tension_top;
    companion->error_trolley_fx = fine->error_trolley_fx;
}

/* ---- memory ---- */

static State state_at(double *memory, int n) {
    State s;
    s.head = (NonlinearState *)memory;
    s.motion.r = (Vector *)(memory + sizeof(NonlinearState) / sizeof(double));
    s.motion.w = s.motion.r + n;
    s.motion.a = s.motion.w + n;
    s.motion.tension = (double *)(s.motion.a + n);
    s.motion.stretched = s.motion.tension + n;
    s.motion.last_h = 0.0;
    return s;
}

static size_t state_count(const Settings *settings) {
    return (has_companion(settings) ? 2 : 1) * solution_count(settings);
}

static size_t rounded(size_t bytes) { return (bytes + 15) / 16 * 16; }

/* Hand out the next ``bytes`` of the memory at ``used``; only count them where memory is NULL. */
static void *take(char *memory, size_t *used, size_t bytes) {
    void *start = memory ? memory + *used : NULL;
    *used += rounded(bytes);
    return start;
}

/* Lay a crane out in ``memory``, or count only where it is NULL; bytes. */
static size_t lay_out(NonlinearCrane *crane, char *memory, const Settings *settings) {
    int elements = (int)settings->chain_elements;
    size_t used = rounded(sizeof(NonlinearCrane)), n = (size_t)elements;
    size_t state = state_count(settings) * sizeof(double);
    double *committed = take(memory, &used, state), *trial = take(memory, &used, state);
    Vector *vectors = take(memory, &used, 8 * n * sizeof(Vector));
    double *numbers = take(memory, &used, 4 * n * sizeof(double));
    Block *blocks = take(memory, &used, 4 * n * sizeof(Block));
    void *own = take(memory, &used, formulation_of(settings)->memory(settings));
    if (memory) {
        Workspace *work = &crane->work;
        crane->own = own;
        crane->state = state_at(committed, elements);
        crane->trial = state_at(trial, elements);
        if (has_companion(settings)) {
            crane->companion = state_at(committed + solution_count(settings), elements);
            crane->trial_companion = state_at(trial + solution_count(settings), elements);
        }
        work->end = (Motion){.r = vectors,
                             .w = vectors + n,
                             .a = vectors + 2 * n,
                             .tension = numbers,
                             .stretched = numbers + n};
        work->a0 = vectors + 3 * n;
        work->d0 = vectors + 4 * n;
        work->d1 = vectors + 5 * n;
        work->moved = vectors + 6 * n;
        work->unknown = vectors + 7 * n;
        work->l0 = numbers + 2 * n;
        work->lag = numbers + 3 * n;
        work->banded = (Banded){blocks, blocks + n, blocks + 2 * n, blocks + 3 * n};
    }
    return used;
}

static size_t memory_size(const Settings *settings) { return lay_out(NULL, NULL, settings); }

static SharedState *shared(void *memory) { return &((NonlinearCrane *)memory)->state.head->shared; }

static size_t save(const void *memory, double *state) {
    const NonlinearCrane *crane = memory;
    size_t count = state_count(&crane->work.chain.settings);
    return save_plain((double *)crane->state.head, count, state);
}

static int load(void *memory, const double *state, size_t count) {
    NonlinearCrane *crane = memory;
    size_t own = state_count(&crane->work.chain.settings);
    return load_plain((double *)crane->state.head, own, state, count);
}

/* ---- the crane ---- */

static void create(void *memory, const Settings *settings) {
    NonlinearCrane *crane = memory;
    Workspace *work = &crane->work;
    Chain *c = &work->chain;
    const Formulation *formulation = formulation_of(settings);
    int n = (int)settings->chain_elements;
    memset(memory, 0, memory_size(settings));
    lay_out(crane, memory, settings);
    discretise(c, settings);
    for (int i = 0; i < n; i++) work->end.a[i] = (Vector){NAN, NAN};
    formulation->prepare(work, crane->own);
    State *s = &crane->state;
    Motion *motion = &s->motion;
    formulation->straight(work, settings->initial_sway_angle, motion);
    s->head->shared.trolley_v = settings->initial_speed;
    s->head->energy = mechanical_energy(work, motion, settings->initial_speed);
    s->head->shared.ledger_start = s->head->energy;
    s->head->scale = formulation->potential(work, motion->r);
    forget_load(c, s);
    s->head->trolley_fx = formulation->released_force(work, motion, settings->initial_speed);
    if (has_companion(settings))
        memcpy(crane->companion.head, s->head, solution_count(settings) * sizeof(double));
}

/* A stretch of a communication step in equal internal steps, none longer than ``longest``, with a
   companion or without. */
static Outcome stretch(NonlinearCrane *crane, double begin, double duration, double longest,
                       double v, const Command *command, Failure *failure) {
    double count = equal_parts(duration, longest);
    int compares = crane->companion.head != NULL;
    if (compares) count = ceil(0.5 * count);
    double part = compares ? duration / (2.0 * count) : duration / count;
    for (double i = 0.0; i < count; i += 1.0) {
        Outcome outcome =
            compares ? compared_step(crane, v, command, begin + 2.0 * i * part, part, failure)
                     : internal_step(&crane->work, &crane->trial, v, command,
                                     begin + i * duration / count, part, 0, failure);
        if (outcome != DONE) return outcome;
    }
    return DONE;
}

/* All of a communication step: one stretch, or two where the waves of a jump are to be resolved in
   the first. */
static Outcome run(NonlinearCrane *crane, double h, double v, const Command *command,
                   Failure *failure) {
    const Workspace *work = &crane->work;
    const Formulation *formulation = formulation_of(&work->chain.settings);
    double allowed = formulation->longest_step(work);
    if (crane->companion.head) allowed *= 0.5; /* the companion's steps are twice as long */
    double longest = smaller(work->chain.settings.solver_max_step, allowed);
    double waves = crane->trial.head->waves;
    double wave_step = waves > 0.0 ? formulation->wave_step(work) : longest;
    if (!(wave_step < longest)) return stretch(crane, 0.0, h, longest, v, command, failure);
    double first = waves < h * (1.0 - WHOLE) ? waves : h;
    Outcome outcome = stretch(crane, 0.0, first, wave_step, v, command, failure);
    if (outcome != DONE || first == h) return outcome;
    return stretch(crane, first, h - first, longest, v, command, failure);
}

static Outcome step(void *memory, double h, const Command *command, Failure *failure) {
    NonlinearCrane *crane = memory;
    const Settings *settings = &crane->work.chain.settings;
    NonlinearState *head = crane->trial.head, *other = crane->trial_companion.head;
    SharedState *shared = &head->shared;
    size_t bytes = state_count(settings) * sizeof(double);
    if (!is_allowed(&crane->state.head->shared, settings, h, command)) return BAD_VALUE;
    memcpy(head, crane->state.head, bytes);
    double v = commanded(shared, command);
    double dv = v - shared->trolley_v, waves = wave_time(&crane->work.chain, dv);
    if (waves > 0.0) head->waves = waves;
    jump(&crane->work, &crane->trial, command, v);
    if (other) other->shared.trolley_v = crane->state.head->shared.trolley_v;
    if (other) jump(&crane->work, &crane->trial_companion, command, v);
    shared->steps = shared->iterations = 0.0;
    if (other) other->shared.steps = other->shared.iterations = 0.0;
    Outcome outcome = run(crane, h, v, command, failure);
    if (outcome != DONE) return outcome;
    if (other) {
        shared->steps += other->shared.steps;
        shared->iterations += other->shared.iterations;
    }
    head->waves = larger(0.0, head->waves - h);
    shared->time += h;
    move_trolley(shared, h, command);
    if (other) accompany(other, head);
    memcpy(crane->state.head, head, bytes);
    return DONE;
}

static void outputs(const void *memory, Outputs *o) {
    const NonlinearCrane *crane = memory;
    const Chain *c = &crane->work.chain;
    const NonlinearState *head = crane->state.head;
    const Motion *motion = &crane->state.motion;
    Posture posture;
    formulation_of(&c->settings)->posture(&crane->work, motion, &posture);
    shared_outputs(&head->shared, &posture, head->energy, o);
    o->trolley_fx = head->trolley_fx;
    o->chain_slack_time = head->slack_time;
    o->error_payload = head->error_payload;
    o->error_tension_top = head->error_tension_top;
    o->error_trolley_fx = head->error_trolley_fx;
    o->error_predictable = is_predictable(c, head);
    o->chain_tension_top = o->chain_tension_min = motion->tension[0];
    for (int e = 1; e < c->n; e++)
        if (motion->tension[e] < o->chain_tension_min) o->chain_tension_min = motion->tension[e];
}

static const char *notice(const void *memory) {
    const NonlinearCrane *crane = memory;
    const Chain *c = &crane->work.chain;
    const NonlinearState *head = crane->state.head;
    int inextensible = c->settings.chain_formulation == CHAIN_FORMULATION_INEXTENSIBLE;
    if (inextensible && head->slack_time > 0.0) return NO_SLACK;
    return is_predictable(c, head) ? NULL : NOT_PREDICTABLE;
}

/* An internal step; with a companion, which takes one where the crane takes two, a pair of them. */
static double longest_part(const Settings *settings) {
    return (has_companion(settings) ? 2.0 : 1.0) * settings->solver_max_step;
}

double estimated_error(const void *memory) {
    return ((const NonlinearCrane *)memory)->state.head->error_payload;
}

const CraneModel NONLINEAR = {.memory = memory_size,
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
