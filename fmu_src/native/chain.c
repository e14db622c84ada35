/* The chain cut into elements; see chain.h. */

#include "chain.h"

/* ---- forces ---- */

Block element_tangent(const Chain *c, Vector d) {
    double length = norm(d), elastic = c->axial;
    double geometric = axial_force(c, length) / length;
    Vector unit = {d.x / length, d.y / length};
    double across = elastic - geometric;
    return (Block){geometric + across * unit.x * unit.x, across * unit.x * unit.y,
                   across * unit.x * unit.y, geometric + across * unit.y * unit.y};
}

double carried_force(const Chain *c, const Command *command, double trolley_v, double node1,
                     double payload) {
    double air = c->settings.damping_air;
    double own = c->row_mass0 * (command->trolley_a_cmd + air * trolley_v);
    return own + c->coupling * node1 + c->end_coupling * payload;
}

double payload_work(const Command *command, Vector moved, double trolley_dx) {
    return command->payload_fx * (moved.x + trolley_dx);
}

/* ---- the hanging equilibrium, and a straight chain ---- */

double hanging_tension(const Chain *c, int e) {
    int below = c->n - 1 - e;
    double element = c->settings.chain_mass / c->n;
    return c->settings.gravity * (c->settings.payload_mass + element * (below + 0.5));
}

double hanging_length(const Chain *c, double tension) {
    return c->L0 * (1.0 + tension / c->settings.chain_EA);
}

void straight_chain(const Chain *c, double sway_angle, Vector *r) {
    double along_chain = 0.0, sine = sin(sway_angle), cosine = cos(sway_angle);
    for (int e = 0; e < c->n; e++) {
        along_chain += hanging_length(c, hanging_tension(c, e) * cosine);
        r[e] = (Vector){along_chain * sine, -along_chain * cosine};
    }
}

/* What couples two nodes in the mass matrix of an element, kg: (11), or averaged with the lumped. */
static double element_coupling(const Settings *p, double element) {
    return p->chain_mass_matrix == CHAIN_MASS_MATRIX_AVERAGED ? element / 12.0 : element / 6.0;
}

/* What the chain's rotation as a rigid body has too much, kg at the payload's node. */
static double rotation_excess(const Settings *p, int n) {
    if (p->chain_mass_matrix != CHAIN_MASS_MATRIX_AVERAGED) return 0.0;
    return p->chain_mass / (12.0 * n * n);
}

void discretise(Chain *c, const Settings *settings) {
    const Settings *p = settings;
    c->settings = *p;
    c->n = (int)p->chain_elements;
    double element = p->chain_mass / c->n, half_weight = -0.5 * element * p->gravity;
    c->L0 = p->chain_length / c->n;
    c->axial = p->chain_EA / c->L0;
    c->coupling = element_coupling(p, element);
    c->inner_mass = element - 2.0 * c->coupling;
    c->end_coupling = rotation_excess(p, c->n);
    c->end_mass = 0.5 * element - c->coupling + p->payload_mass - c->end_coupling;
    c->inner_row = element;
    c->end_row = 0.5 * element + p->payload_mass;
    c->row_mass0 = 0.5 * element;
    c->inner_weight = 2.0 * half_weight;
    c->end_weight = half_weight - p->payload_mass * p->gravity;
    c->total_mass = p->chain_mass + p->payload_mass;
    c->rest_potential = 0.0;
}

/* ---- energies ---- */

double kinetic_energy(const Chain *c, const Vector *w, double trolley_v) {
    double relative = 0.0, momentum = 0.0;
    for (int i = 0; i < c->n; i++) {
        relative += dot(w[i], mass_times(c, w, i));
        momentum += row_mass(c, i) * w[i].x;
    }
    return 0.5 * relative + trolley_v * momentum + 0.5 * c->total_mass * trolley_v * trolley_v;
}

double potential_energy(const Chain *c, const Vector *r) {
    double stretch2 = 0.0, weight = 0.0;
    for (int i = 0; i < c->n; i++) {
        double stretch = norm(along(r, i)) - c->L0;
        stretch2 += stretch * stretch;
        weight += (i < c->n - 1 ? c->inner_weight : c->end_weight) * r[i].y;
    }
    return 0.5 * c->axial * stretch2 - weight - c->rest_potential;
}

/* ---- material points ---- */

double interpolate(const Chain *c, const double *nodal, int stride, double fraction) {
    double place = fraction * c->n, whole = floor(place + ON_A_NODE);
    int upper = whole < c->n - 1 ? (int)whole : c->n - 1;
    double share = place - upper, value = share * nodal[upper * stride];
    return upper > 0 ? value + (1.0 - share) * nodal[(upper - 1) * stride] : value;
}

double material_fraction(int point) {
    return point < MATERIAL_POINTS ? (double)(point + 1) / MATERIAL_POINTS : 0.5;
}
