"""Rung 4, jumps and the scheme's own dissipation. Tension after a jump: another integrator, and an
inextensible chain; the bounce of a payload: its energy.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from math import ceil, log2, pi, sqrt
from typing import Any

import numpy as np
import pytest
from conftest import PAYLOADS
from scipy.integrate import solve_ivp

from chaincrane.plant.chain import (
    Array,
    DiscreteChain,
    along_elements,
    axial_force,
    discretise,
    internal_force,
    potential_energy,
    straight_chain,
)
from chaincrane.plant.command import IDLE, Command
from chaincrane.plant.jump import JUMP_TIME, filter_time, filtered_jump, plain_jump
from chaincrane.plant.kernel import NativeCrane
from chaincrane.plant.ledger import Ledger
from chaincrane.plant.linear import mass_matrix
from chaincrane.plant.nonlinear import NonlinearCrane
from chaincrane.plant.parameters import Chain, Crane, Initial, Numerics, Payload
from chaincrane.plant.scheme import Motion

HEAVY = Crane(payload=Payload(PAYLOADS["heavy"]))
SOFT = replace(HEAVY, chain=Chain(EA=1e4))


def largest_tension(crane: NativeCrane, h: float, until: float) -> float:
    """Largest tension at the top, N, once the trolley has stopped, seen every ``h`` s."""
    tensions = []
    for _ in range(round(until / h)):
        crane.step(h)
        tensions.append(crane.outputs()["chain.tension_top"])
    return max(tensions)


@pytest.mark.parametrize("step", [2e-3, 1e-3, 5e-4, 2e-4])
def test_tension_after_the_heavy_stop_does_not_depend_on_the_step(
    library: Any, step: float
) -> None:
    """14.8 N within 5 %: what an inextensible chain of the same mass matrices has. No slack."""
    crane = NativeCrane(HEAVY, numerics=Numerics(max_step=step), library=library)
    assert largest_tension(crane, step, 0.2) == pytest.approx(14.8, rel=0.05)
    assert crane.outputs()["chain.slack_time"] == 0.0


def truss_tension(chain: DiscreteChain, sway: float, dv: float, times: Array) -> Array:
    """Tension of the top element after a jump, N, by SciPy's DOP853 on the truss itself."""
    inverse = np.linalg.inv(mass_matrix(chain))
    r = straight_chain(chain, sway)
    motion = Motion(r, np.zeros_like(r), np.zeros(chain.elements))
    start = np.concatenate((r.ravel(), plain_jump(chain, motion, dv).motion.w.ravel()))
    EA, n = chain.crane.chain.EA, chain.elements

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        d = along_elements(y[: 2 * n].reshape(n, 2))
        tension = axial_force(EA, chain.L0, np.hypot(d[:, 0], d[:, 1]))
        a = inverse @ (chain.weight - internal_force(d, tension))
        return np.concatenate((y[2 * n :], a.ravel()))

    found = solve_ivp(rate, (0.0, times[-1]), start, "DOP853", times, rtol=1e-8, atol=1e-10)
    lengths = np.hypot(found.y[0], found.y[1])
    return np.asarray(axial_force(EA, chain.L0, lengths))


@pytest.mark.parametrize("step", [2e-3, 1e-3, 5e-4, 2e-4])
def test_a_soft_chain_keeps_its_own_impulse_and_waves(library: Any, step: float) -> None:
    """EA 1e4 N, a jump at 0.5 rad: 57.3 N at the top, as another integrator has at the same times,
    within 5 %, and the waves on the way there; the peak is 2 ms wide.
    """
    times = np.arange(0.0, 0.03, 1e-4)
    truth = truss_tension(discretise(SOFT, 10), 0.5, -0.8, times)
    assert truth.max() == pytest.approx(57.3, rel=0.01)
    crane = NativeCrane(SOFT, Initial(0.8, 0.5), Numerics(max_step=step), library=library)
    found = []
    for _ in range(round(0.03 / step) - 1):
        crane.step(step)
        found.append(crane.outputs()["chain.tension_top"])
    same = truth[:: round(step / 1e-4)][1 : len(found) + 1]
    assert max(found) == pytest.approx(same.max(), rel=0.05)
    assert np.sqrt(np.mean((found - same) ** 2)) < 0.1 * truth.max()
    assert crane.outputs()["chain.slack_time"] > 0.0


def test_only_a_jump_that_sends_waves_is_followed(library: Any) -> None:
    """A bounce in steps of L0/(4 c), then as before; none for a small jump or for steel."""
    c = sqrt(1e4 * 0.8 / 0.22)
    followed = 6.0 * sqrt(0.8 * (0.42 + 0.22 / 3.0) / 1e4)
    steps = ceil(followed / (0.25 * 0.08 / c)) + ceil((0.1 - followed) / 1e-3)
    for kind in (NonlinearCrane, partial(NativeCrane, library=library)):
        crane = kind(SOFT, Initial(0.8))
        crane.step(0.1)
        assert crane.effort.steps == pytest.approx(steps, abs=1)  # T_0 x^4 is 0.1 % of a step
        crane.step(0.1)
        assert crane.effort.steps == 100
        crane.step(0.1, Command(trolley_v_cmd=5e-3))  # its wave pulls 0.26 N of a weight of 6.3
        assert crane.effort.steps == 100
        steel = kind(HEAVY, Initial(0.8))
        steel.step(0.1)
        assert steel.effort.steps == 100


def test_a_chain_between_soft_and_steel_is_filtered_in_between() -> None:
    """T rises with EA, from none to JUMP_TIME; in a soft chain the impulse is the plain one."""
    times = [filter_time(replace(HEAVY, chain=Chain(EA=10.0**p))) for p in range(3, 10)]
    assert times == sorted(times)
    assert times[0] < 1e-6 * JUMP_TIME
    assert times[-1] == pytest.approx(JUMP_TIME, rel=1e-3)
    chain = discretise(SOFT, 10)
    r = straight_chain(chain, 0.5)
    motion = Motion(r, np.zeros_like(r), np.zeros(10))
    filtered = filtered_jump(chain, motion, IDLE, 0.0, -0.8)
    np.testing.assert_allclose(filtered.dw, plain_jump(chain, motion, -0.8).dw, atol=1e-8)


def test_the_impulse_is_an_output(library: Any) -> None:
    """All of it changes the momentum; it is told once, at the step that begins with the jump."""
    for crane in (NonlinearCrane(HEAVY), NativeCrane(HEAVY, library=library)):
        before = crane.ledger
        crane.step(1e-6)
        impulse = crane.outputs()["trolley.impulse"]
        assert -0.64 * 0.8 < impulse < 0.0
        work = crane.ledger.trolley - before.trolley
        assert work == pytest.approx(0.4 * impulse, rel=1e-4)  # at the mean velocity
        crane.step(1e-3)
        assert crane.outputs()["trolley.impulse"] == 0.0


def amplitude_lost(steps: int, elements: int = 1) -> float:
    """Share of its amplitude that a bounce of so many steps a period loses a period, EA 1e4 N."""
    period = 2.0 * pi / sqrt(1e4 / (0.8 * (0.42 + 0.22 / 3.0)))
    h = period / steps
    crane = NonlinearCrane(SOFT, Initial(speed=0.0), Numerics(elements, 1.001 * h))
    start = crane._state
    r = start.motion.r * (1.0 + 1e-4)
    energy = potential_energy(crane.chain, r)
    motion = Motion(r, start.motion.w, start.motion.tension)
    crane._state = replace(
        start, motion=motion, energy=energy, scale=energy, ledger=Ledger(start=energy)
    )
    for _ in range(10 * steps):
        crane.step(h)
    return 1.0 - float((crane.energy / energy) ** 0.05)


def test_a_resolved_bounce_is_left_alone() -> None:
    """Ours: below 1e-3 a period with 20 steps, and of the second order in the step or better."""
    assert amplitude_lost(20) < 1e-3
    assert log2(amplitude_lost(20) / amplitude_lost(40)) > 2.0
    assert log2(amplitude_lost(20, 10) / amplitude_lost(40, 10)) > 1.9
