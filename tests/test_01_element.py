"""Rung 1, the element. References: analytic."""

import numpy as np
import pytest

from chaincrane.plant.chain import (
    along_elements,
    axial_force,
    discretise,
    element_mass,
    element_tangent,
    element_weight,
    internal_force,
    kinetic_energy,
    mass_times,
)
from chaincrane.plant.energy_momentum import Viscosity, corrected, element_force, turned
from chaincrane.plant.parameters import MASS_MATRICES, Chain, Crane, Payload

MU, L0, EA = 0.275, 0.08, 7.357e6


def bent_chain(rng: np.random.Generator, elements: int = 5, stretch: float = 1e-3) -> np.ndarray:
    """Element vectors of an arbitrary chain, shape (elements, 2)."""
    angle = rng.uniform(-1.0, 1.0, elements)
    length = L0 * (1.0 + stretch * rng.uniform(-1.0, 1.0, elements))
    return np.asarray(length[:, None] * np.column_stack((np.sin(angle), -np.cos(angle))))


def test_mass_matrix_carries_the_elements_mass() -> None:
    M = element_mass(MU, L0)
    rigid = np.array([1.0, 0.0, 1.0, 0.0])
    assert rigid @ M @ rigid == pytest.approx(MU * L0, rel=1e-15)
    np.testing.assert_array_equal(M, M.T)
    assert np.linalg.eigvalsh(M).min() > 0.0


def test_mass_matrix_is_the_integral_of_the_shape_functions() -> None:
    nodes, weights = np.polynomial.legendre.leggauss(2)  # exact for the product of two lines
    s = 0.5 * (1.0 + nodes)
    N = np.stack((1.0 - s, s))
    integral = MU * L0 * 0.5 * np.einsum("iq,jq,q->ij", N, N, weights)
    np.testing.assert_allclose(element_mass(MU, L0)[::2, ::2], integral, rtol=1e-14)


def test_weight_is_shared_by_both_nodes_and_points_down() -> None:
    weight = element_weight(MU, L0, 9.81)
    assert weight[1] == weight[3] < 0.0
    assert weight.sum() == pytest.approx(-MU * L0 * 9.81, rel=1e-15)


def test_rigid_motion_makes_no_force() -> None:
    rng = np.random.default_rng(1)
    d = bent_chain(rng, stretch=0.0)
    turn = 0.7
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turned = d @ rotation.T
    force = axial_force(EA, L0, np.hypot(*turned.T))
    # round-off of a length, 1e-17 m, times EA/L0, 9e7 N/m, is 1e-9 N
    assert np.abs(internal_force(turned, force)).max() < 1e-8


def test_internal_forces_are_in_balance() -> None:
    d = bent_chain(np.random.default_rng(2))
    force = axial_force(EA, L0, np.hypot(*d.T))
    pull_of_the_trolley = force[0] * d[0] / np.hypot(*d[0])
    total = internal_force(d, force).sum(axis=0) - pull_of_the_trolley
    assert np.abs(total).max() < 1e-10 * np.abs(force).max()


def test_tangent_is_the_derivative_of_the_force() -> None:
    d = bent_chain(np.random.default_rng(3))
    step = 1e-7 * L0

    def pull(vectors: np.ndarray) -> np.ndarray:
        length = np.hypot(*vectors.T)
        return np.asarray((axial_force(EA, L0, length) / length)[:, None] * vectors)

    for c in range(2):
        shift = np.zeros_like(d)
        shift[:, c] = step
        numerical = (pull(d + shift) - pull(d - shift)) / (2.0 * step)
        np.testing.assert_allclose(
            element_tangent(d, L0, EA)[:, :, c], numerical, rtol=1e-6, atol=1e-6 * EA / L0
        )


def test_discrete_gradient_does_the_work_of_the_elastic_energy() -> None:
    rng = np.random.default_rng(4)
    d0, d1 = bent_chain(rng), bent_chain(rng)
    viscosity = Viscosity(0.3 * EA / L0, rng.uniform(-1e2, 1e2, len(d0)))
    stretch0, stretch1 = np.hypot(*d0.T) - L0, np.hypot(*d1.T) - L0
    elastic = 0.5 * EA / L0 * (stretch1**2 - stretch0**2)
    work = np.einsum("ij,ij->i", element_force(EA, L0, viscosity, d0, d1).pull, d1 - d0)
    stretched = stretch1 - stretch0
    viscous = (viscosity.eta * stretched - viscosity.lag) * stretched
    np.testing.assert_allclose(work, elastic + viscous, rtol=1e-8)


def test_discrete_gradient_tangent_is_the_derivative() -> None:
    rng = np.random.default_rng(5)
    d0, d1 = bent_chain(rng), bent_chain(rng)
    step, viscosity = 1e-7 * L0, Viscosity(0.1 * EA / L0, rng.uniform(-1e2, 1e2, len(d0)))
    tangent = element_force(EA, L0, viscosity, d0, d1).tangent
    for c in range(2):
        shift = np.zeros_like(d1)
        shift[:, c] = step
        above = element_force(EA, L0, viscosity, d0, d1 + shift).pull
        below = element_force(EA, L0, viscosity, d0, d1 - shift).pull
        numerical = (above - below) / (2.0 * step)
        np.testing.assert_allclose(tangent[:, :, c], numerical, rtol=1e-6, atol=1e-6 * EA / L0)


def test_turned_elements_keep_their_lengths() -> None:
    rng = np.random.default_rng(6)
    d, angle = bent_chain(rng), rng.normal(size=5)
    after = turned(d, angle, np.ones(5))
    np.testing.assert_allclose(np.hypot(*after.T), np.hypot(*d.T), rtol=1e-15)


def test_correction_of_elements_is_a_sum_to_first_order() -> None:
    rng = np.random.default_rng(7)
    d, shift = bent_chain(rng), rng.normal(size=(5, 2))
    for size, allowed in ((1e-3 * L0, 1e-5), (1e-4 * L0, 1e-7)):  # falls as the square
        after = corrected(d, size * shift)
        assert after is not None
        off = np.abs(after - d - along_elements(size * shift)).max()
        assert 0.0 < off < allowed * L0


def test_correction_that_folds_an_element_is_refused() -> None:
    d = np.array([[0.0, -L0]])
    assert corrected(d, np.array([[0.0, 0.95 * L0]])) is None


@pytest.mark.parametrize("mass_matrix", MASS_MATRICES)
def test_assembled_mass_is_that_of_chain_and_payload(mass_matrix: str) -> None:
    crane = Crane(chain=Chain(mass=0.22), payload=Payload(mass=0.42))
    chain = discretise(crane, 7, mass_matrix)
    assert chain.row_mass.sum() + chain.row_mass0 == pytest.approx(0.64, rel=1e-14)
    rigid = np.ones((7, 2))
    free = mass_times(chain, rigid)[:, 0]
    free[0] += chain.mass_coupling  # node 0 moves along
    free[-1] += chain.end_coupling
    np.testing.assert_allclose(free, chain.row_mass, rtol=1e-14)


@pytest.mark.parametrize("mass_matrix", MASS_MATRICES)
@pytest.mark.parametrize("elements", [1, 2, 7])
def test_a_chain_that_turns_as_a_rod_has_a_rods_inertia(elements: int, mass_matrix: str) -> None:
    """m L^2/3 + M L^2 about the trolley: the mean of consistent and lumped alone has too much."""
    crane = Crane(chain=Chain(length=0.8, mass=0.22), payload=Payload(mass=0.42))
    chain = discretise(crane, elements, mass_matrix)
    w = np.outer(np.arange(1, elements + 1) * chain.L0, [1.0, 0.0])  # 1 rad/s
    inertia = (0.22 / 3.0 + 0.42) * 0.8**2
    assert kinetic_energy(chain, w, 0.0) == pytest.approx(0.5 * inertia, rel=1e-14)


def test_kinetic_energy_of_a_travelling_crane() -> None:
    chain = discretise(Crane(), 4)
    still = np.zeros((4, 2))
    assert kinetic_energy(chain, still, 0.8) == pytest.approx(0.5 * 0.64 * 0.8**2, rel=1e-14)


def test_differences_along_the_chain() -> None:
    nodal = np.array([[1.0, 2.0], [4.0, 8.0]])
    np.testing.assert_array_equal(along_elements(nodal), [[1.0, 2.0], [3.0, 6.0]])
