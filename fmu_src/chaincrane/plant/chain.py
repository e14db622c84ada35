"""The chain as truss elements: what an element and the assembled chain are, without time.

    y ^
      |        trolley, node 0, motion prescribed, on y = 0
      +----->  o======> x, the direction of travel
           x    \\                 r_j     position of node j relative to the trolley, m
                 o  node 1         d_e     = r_e - r_(e-1), the vector along element e, m
                  \\  element 2    l_e     = |d_e|, its length; L0 = L/n unstretched, m
                   o  node 2       N_e     axial force, N, tension positive
                   :
                    o  node n: payload, a point mass

Sway is positive towards +x. All positions and velocities here are relative to the trolley, so a
long travel costs no digits. Arrays of nodes leave out node 0 and have shape (n, 2), columns x and
y; arrays of elements have shape (n, 2) or (n,).

Source: Maourane & Szabo, Pollack Periodica 15(2), 2020, 82-93, section 2.1 (its numbers in
brackets), with the corrections that documentation/EQUATIONS.md lists.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .command import Command
from .parameters import Crane

Array = NDArray[np.float64]

ON_A_NODE = 1e-9  # elements, what a material point may be above a node and count as on it


def element_mass(mu: float, L0: float) -> Array:
    """Consistent mass matrix of a truss element, (11).

    M_e = mu L0 / 6 [2 0 1 0; 0 2 0 1; 1 0 2 0; 0 1 0 2], kg, shape (4, 4), for the nodal values
    [x_i, y_i, x_j, y_j]. It is the same in every direction, so it needs no transformation.
    """
    coupled = np.array([[2.0, 1.0], [1.0, 2.0]])
    return np.asarray(mu * L0 / 6.0 * np.kron(coupled, np.eye(2)), dtype=float)


def averaged_element_mass(mu: float, L0: float) -> Array:
    """Mean of the consistent mass matrix (11) and the lumped one, ours, kg, shape (4, 4).

    M_e = mu L0 / 12 [5 0 1 0; 0 5 0 1; 1 0 5 0; 0 1 0 5]. The leading dispersion errors of the two
    cancel on a uniform string: it carries its waves more faithfully at the same mesh. But it makes
    an element's rotation too heavy, which :func:`rotation_excess` mends for the chain as a whole.
    """
    lumped = 0.5 * mu * L0 * np.eye(4)
    return 0.5 * (element_mass(mu, L0) + lumped)


ELEMENT_MASS = {"consistent": element_mass, "averaged": averaged_element_mass}


def rotation_excess(mass_matrix: str, chain_mass: float, elements: int) -> float:
    """What the chain's rotation as a rigid body has too much, kg at the payload's node, ours.

    An element of half lumped mass resists its rotation with mu L0^3/12 too much, so the n of a
    straight chain with m L^2/(12 n^2): as much as m/(12 n^2) at its end. Moved from the payload's
    diagonal entry to what couples it with node 0, all row sums stay, and the rotation is exact.
    """
    return chain_mass / (12.0 * elements**2) if mass_matrix == "averaged" else 0.0


def element_weight(mu: float, L0: float, gravity: float) -> Array:
    """Weight of a truss element on its two nodes, (13): each gets half, N, shape (4,).

    f_g = (0, -mu L0 g/2, 0, -mu L0 g/2), in global axes; the printed equation is garbled.
    """
    half = 0.5 * mu * L0 * gravity
    return np.array([0.0, -half, 0.0, -half])


def axial_force(EA: float, L0: float, length: Array) -> Array:
    """Axial force N = EA (l - L0)/L0, N, tension positive; ``length`` in m, any shape."""
    return EA / L0 * (length - L0)


def internal_force(d: Array, force: Array) -> Array:
    """Internal nodal forces f_sigma of a chain, (13) assembled, N, shape (n, 2), node 0 left out.

    Element e pulls its lower node up along itself with N_e and its upper node down, so node e
    has N_e d_e/l_e - N_(e+1) d_(e+1)/l_(e+1). ``d`` (n, 2) in m, ``force`` N (n,) in N.
    """
    pull = (force / np.hypot(d[:, 0], d[:, 1]))[:, None] * d
    return assemble_force(pull)


def element_tangent(d: Array, L0: float, EA: float) -> Array:
    """Tangent stiffness dF/dd of each element's end force, K_L + K_G of (12) in global axes.

    K = EA/L0 c c^T + N/l (1 - c c^T), c = d/l, shape (n, 2, 2), N/m. The elastic part has 1/L0 and
    the geometric part acts across the element alone: that is the exact derivative of
    :func:`internal_force`. The printed (12) has N/L in every direction, EA being large against N.
    """
    length = np.hypot(d[:, 0], d[:, 1])
    c = d / length[:, None]
    along = c[:, :, None] * c[:, None, :]
    across = np.eye(2) - along
    geometric = axial_force(EA, L0, length) / length
    return EA / L0 * along + geometric[:, None, None] * across


def assemble_force(pull: Array) -> Array:
    """Nodal forces (n, 2) from the pull (n, 2) of each element on its lower node."""
    force = pull.copy()
    force[:-1] -= pull[1:]
    return force


def along_elements(nodal: Array) -> Array:
    """Difference of a nodal quantity over each element, (n, 2); node 0's is zero."""
    d = nodal.copy()
    d[1:] -= nodal[:-1]
    return d


def hanging_tension(crane: Crane, elements: int) -> Array:
    """Tension of each element in the hanging equilibrium, N, shape (n,), from the top.

    N_e = g (payload + elements below + half of element e).
    """
    below = np.arange(elements - 0.5, 0.0, -1.0)  # elements, down from the middle of e
    carried = crane.payload.mass + crane.chain.mass / elements * below
    return np.asarray(crane.gravity * carried)


def hanging_length(crane: Crane, elements: int, tension: Array) -> Array:
    """Length of each element under ``tension``, m: l_e = L0 (1 + N_e/EA)."""
    return crane.chain.length / elements * (1.0 + tension / crane.chain.EA)


@dataclass(frozen=True)
class DiscreteChain:
    """A crane's chain cut into elements: the constant arrays that every scheme needs."""

    crane: Crane
    elements: int
    L0: float  # m, unstretched element length
    mu: float  # kg/m
    mass_diagonal: Array  # kg, (n,), each node's entry of the mass matrix
    mass_coupling: float  # kg, between neighbours (node 0 and node 1 too)
    end_coupling: float  # kg, between node 0 and the payload's node, besides
    row_mass: Array  # kg, (n,), row sums of the mass matrix, node 0's column included
    weight: Array  # N, (n, 2)
    rest: Array  # m, (n, 2), hanging equilibrium

    @property
    def row_mass0(self) -> float:
        """Row sum of node 0, kg: half an element."""
        return 0.5 * self.mu * self.L0


def discretise(crane: Crane, elements: int, mass_matrix: str = "consistent") -> DiscreteChain:
    """Cut ``crane``'s chain into ``elements`` equal truss elements."""
    L0 = crane.chain.length / elements
    mu = crane.chain.mass / crane.chain.length
    element = ELEMENT_MASS[mass_matrix](mu, L0)
    own, coupling = float(element[0, 0]), float(element[0, 2])
    diagonal = np.full(elements, 2.0 * own)
    excess = rotation_excess(mass_matrix, crane.chain.mass, elements)
    diagonal[-1] = own + crane.payload.mass - excess
    row = np.full(elements, 2.0 * (own + coupling))
    row[-1] = own + coupling + crane.payload.mass
    half_weight = element_weight(mu, L0, crane.gravity)[1]
    weight = np.zeros((elements, 2))
    weight[:, 1] = 2.0 * half_weight
    weight[-1, 1] = half_weight - crane.payload.mass * crane.gravity
    rest = np.zeros((elements, 2))
    rest[:, 1] = -np.cumsum(hanging_length(crane, elements, hanging_tension(crane, elements)))
    return DiscreteChain(crane, elements, L0, mu, diagonal, coupling, excess, row, weight, rest)


def straight_chain(chain: DiscreteChain, sway_angle: float) -> Array:
    """Positions (n, 2), m, of the straight chain held at ``sway_angle`` rad from the vertical.

    Ours: each element carries N_e cos(angle), the tension in the instant of its release, so that
    letting go does not ring the chain along its length. At angle 0 it is the hanging equilibrium.
    """
    if sway_angle == 0.0:
        return chain.rest.copy()
    tension = hanging_tension(chain.crane, chain.elements) * np.cos(sway_angle)
    along = np.cumsum(hanging_length(chain.crane, chain.elements, tension))
    return np.asarray(np.outer(along, [np.sin(sway_angle), -np.cos(sway_angle)]))


def mass_times(chain: DiscreteChain, nodal: Array) -> Array:
    """M_ff times a nodal quantity (n, 2), the free nodes' mass matrix."""
    product = chain.mass_diagonal[:, None] * nodal
    product[1:] += chain.mass_coupling * nodal[:-1]
    product[:-1] += chain.mass_coupling * nodal[1:]
    return product


def kinetic_energy(chain: DiscreteChain, w: Array, trolley_v: float) -> float:
    """Kinetic energy, J, of chain and payload; ``w`` relative (n, 2), ``trolley_v`` in m/s."""
    relative = 0.5 * float(np.vdot(w, mass_times(chain, w)))
    mixed = trolley_v * float(chain.row_mass @ w[:, 0])
    total_mass = chain.crane.total_mass
    return relative + mixed + 0.5 * total_mass * trolley_v * trolley_v


def potential_energy(chain: DiscreteChain, r: Array) -> float:
    """Elastic energy and weight, J, at positions ``r`` (n, 2), above the hanging equilibrium."""
    return _potential(chain, r) - _potential(chain, chain.rest)


def _potential(chain: DiscreteChain, r: Array) -> float:
    d = along_elements(r)
    stretch = np.hypot(d[:, 0], d[:, 1]) - chain.L0
    elastic = 0.5 * chain.crane.chain.EA / chain.L0 * float(stretch @ stretch)
    return elastic - float(np.vdot(chain.weight, r))


def applied_force(chain: DiscreteChain, command: Command, trolley_v: float) -> Array:
    """Weight, payload force, and the trolley's motion as a load, f - b (a + alpha v), N, (n, 2).

    b are the mass matrix' row sums, a and v the trolley's acceleration and velocity, alpha the
    air's damping.
    """
    force = chain.weight.copy()
    air = chain.crane.damping.air
    force[:, 0] -= chain.row_mass * (command.trolley_a_cmd + air * trolley_v)
    force[-1, 0] += command.payload_fx
    return force


def payload_work(command: Command, moved: Array, trolley_dx: float) -> float:
    """Work of the payload's force, J; ``moved``: of the payload in the trolley's frame, m, (2,)."""
    return command.payload_fx * (float(moved[0]) + trolley_dx)


def carried_force(
    chain: DiscreteChain, command: Command, trolley_v: float, node1: float, payload: float
) -> float:
    """Horizontal force, N, that node 0's row of the mass matrix takes: inertia and the air's drag.

    ``node1``, ``payload``: a + alpha w of node 1 and of the payload's, relative to the trolley,
    m/s2.
    """
    air = chain.crane.damping.air
    own = chain.row_mass0 * (command.trolley_a_cmd + air * trolley_v)
    return own + chain.mass_coupling * node1 + chain.end_coupling * payload


def interpolation(elements: int, fractions: Array) -> Array:
    """Matrix (points, n) that interpolates nodal values at fractions of the chain, (7)-(8)."""
    place = np.asarray(fractions, dtype=float) * elements
    upper = np.minimum(np.floor(place + ON_A_NODE).astype(int), elements - 1)
    share = place - upper
    weights = np.zeros((len(place), elements))
    rows = np.arange(len(place))
    weights[rows, upper] += share
    below = upper > 0
    weights[rows[below], upper[below] - 1] += 1.0 - share[below]
    return weights
