"""Rung 3, modes. References: analytic (Bessel roots), and one model against the other."""

import numpy as np
import pytest
import scipy.linalg
from conftest import PAYLOADS
from scipy.optimize import brentq
from scipy.special import jv, yv

from chaincrane.plant.chain import along_elements, discretise, element_tangent
from chaincrane.plant.command import Command
from chaincrane.plant.linear import (
    LinearCrane,
    mass_matrix,
    modes,
    state_space,
    stiffness_matrix,
)
from chaincrane.plant.parameters import MASS_MATRICES, Crane, Damping, Initial, Numerics, Payload


def bessel_frequencies(crane: Crane, count: int, below: float = 80.0) -> list[float]:
    """Frequencies of a hanging chain with an end mass, rad/s, below a bound.

    u = A J0(z) + B Y0(z), z(y) = 2 w sqrt((M/mu + y)/g), y from the payload upwards;
    u(L) = 0 and M w^2 u + M g u' = 0 at y = 0, that is w u - sqrt(g mu/M) (A J1 + B Y1) = 0.
    """
    mu, M, g = crane.chain.mass / crane.chain.length, crane.payload.mass, crane.gravity

    def determinant(w: float) -> float:
        bottom, top = (2 * w * np.sqrt((M / mu + y) / g) for y in (0.0, crane.chain.length))
        slope = np.sqrt(g * mu / M)  # u' = -w slope/g (A J1 + B Y1), as dz/dy = w slope/g
        at_payload = [w * f0(0, bottom) - slope * f0(1, bottom) for f0 in (jv, yv)]
        return float(at_payload[0] * yv(0, top) - at_payload[1] * jv(0, top))

    grid = np.arange(0.5, below, 0.05)
    values = [determinant(w) for w in grid]
    roots = [
        brentq(determinant, a, b, xtol=1e-13)
        for a, b, fa, fb in zip(grid, grid[1:], values, values[1:], strict=False)
        if fa * fb < 0
    ]
    return roots[:count]


@pytest.mark.parametrize("payload", PAYLOADS.values())
def test_frequencies_converge_to_the_bessel_roots_with_order_2(payload: float) -> None:
    crane = Crane(payload=Payload(payload))
    exact = np.array(bessel_frequencies(crane, 3))
    meshes = [40, 80, 160]
    errors = np.array([modes(discretise(crane, n)).omega[:3] - exact for n in meshes])
    orders = np.log2(errors[:-1] / errors[1:])
    assert np.all(np.abs(orders - 2.0) < 0.05), orders


@pytest.mark.parametrize("payload", PAYLOADS.values())
def test_averaged_mass_carries_the_chains_waves_better(payload: float) -> None:
    """The chain's own vibrations, modes 2 and 3, err by 0.28 of it or less (heavy: 0.09); the first
    frequency as before. The order stays 2.
    """
    crane = Crane(payload=Payload(payload))
    exact = np.array(bessel_frequencies(crane, 3))
    consistent, averaged = (
        np.abs(modes(discretise(crane, 10, kind)).omega[:3] - exact) for kind in MASS_MATRICES
    )
    assert np.all(averaged[1:] < 0.34 * consistent[1:])
    assert averaged[0] < consistent[0]
    fine, finer = (
        np.abs(modes(discretise(crane, n, "averaged")).omega[:3] - exact) for n in (40, 80)
    )
    assert np.all(np.abs(np.log2(fine / finer) - 2.0) < 0.1)


def test_first_frequencies_of_ten_elements() -> None:
    """MODEL's numbers: 3.6236 rad/s (heavy), 3.8816 rad/s (light); own, rounded to 5 digits."""
    for payload, omega in ((0.42, 3.6236), (0.07, 3.8816)):
        first = modes(discretise(Crane(payload=Payload(payload)), 10)).omega[0]
        assert first == pytest.approx(omega, abs=5e-5)


def test_modes_are_orthogonal() -> None:
    chain = discretise(Crane(), 10)
    found = modes(chain)
    M, K = mass_matrix(chain), stiffness_matrix(chain)
    np.testing.assert_allclose(found.shapes.T @ M @ found.shapes, np.eye(10), atol=1e-12)
    np.testing.assert_allclose(
        found.shapes.T @ K @ found.shapes, np.diag(found.omega**2), atol=1e-9 * found.omega[-1] ** 2
    )


def test_rigid_translation_needs_no_force() -> None:
    """K 1 = 0 but for the element at the trolley."""
    K = stiffness_matrix(discretise(Crane(), 6))
    force = K @ np.ones(6)
    assert np.abs(force[1:]).max() < 1e-12 * np.abs(K).max()
    assert force[0] > 0.0


def test_the_linear_crane_is_the_nonlinear_one_linearised() -> None:
    """Horizontal stiffness of the hanging chain, N/l an element, against the string's N/L0.

    They differ by the stretch at rest, N/EA, 8e-7 for steel: the string does not stretch.
    """
    crane, n = Crane(), 10
    chain = discretise(crane, n)
    tangent = element_tangent(along_elements(chain.rest), chain.L0, crane.chain.EA)[:, 0, 0]
    K = np.diag(tangent) + np.diag(np.append(tangent[1:], 0.0))
    K -= np.diag(tangent[1:], 1) + np.diag(tangent[1:], -1)
    np.testing.assert_allclose(K, stiffness_matrix(chain), rtol=2e-6, atol=1e-9)


@pytest.mark.parametrize("air", [0.0, 0.4, 12.0])
def test_the_exact_step_is_the_matrix_exponential_of_the_state_space(air: float) -> None:
    """Another code: SciPy's expm of A, B, against the modal step, with both inputs held.

    The trolley starts at rest with a_cmd, so the air sees its velocity: it is a third input here.
    """
    crane = Crane(damping=Damping(air=air))
    system = state_space(crane, 4)
    n, h, a_cmd, fx = 4, 0.05, 0.7, 0.3
    B = np.column_stack((system.B, air * system.B[:, 0]))  # the trolley's velocity acts as air * a
    size = 2 * n + 3
    big = np.zeros((size + 1, size + 1))
    big[: 2 * n, : 2 * n] = system.A
    big[: 2 * n, 2 * n : 2 * n + 3] = B
    big[2 * n + 2, 2 * n] = 1.0  # velocity = integral of acceleration
    state = np.zeros(size + 1)
    state[2 * n : 2 * n + 2] = a_cmd, fx
    state = scipy.linalg.expm(h * big) @ state
    crane_model = LinearCrane(crane, Initial(speed=0.0), Numerics(elements=n))
    crane_model.step(h, Command(trolley_a_cmd=a_cmd, payload_fx=fx))
    x_rel, mid = (system.C[:2] @ state[: 2 * n]).tolist()
    out = crane_model.outputs()
    assert out["payload.x_rel"] == pytest.approx(x_rel, rel=1e-11)
    assert out["chain.mid_x_rel"] == pytest.approx(mid, rel=1e-11)
    assert out["payload.vx"] - out["trolley.v"] == pytest.approx(state[2 * n - 1], rel=1e-11)
