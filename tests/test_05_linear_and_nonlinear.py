"""Rung 5, linear against nonlinear at shrinking amplitude. References: one model for the other."""

import numpy as np

from chaincrane.plant.command import Command
from chaincrane.plant.linear import LinearCrane
from chaincrane.plant.nonlinear import NonlinearCrane
from chaincrane.plant.parameters import Crane, Damping, Initial, Numerics


def largest_difference(angle: float) -> float:
    """Of payload.x_rel over 1.5 s, both released from a small angle, m.

    The internal step is fine, for the nonlinear crane's time error falls with the amplitude only.
    """
    settings = Crane(), Initial(0.0, angle), Numerics(elements=4, max_step=1e-4)
    linear, nonlinear = LinearCrane(*settings), NonlinearCrane(*settings)
    gap = 0.0
    for _ in range(75):
        linear.step(0.02)
        nonlinear.step(0.02)
        gap = max(
            gap,
            abs(linear.outputs()["payload.x_rel"] - nonlinear.outputs()["payload.x_rel"]),
        )
    return gap


def test_difference_falls_as_the_third_power_of_the_amplitude() -> None:
    """Ratio 8 at half the amplitude; 5 % for the fifth power, which is still there at 0.2 rad."""
    gaps = [largest_difference(angle) for angle in (0.2, 0.1, 0.05)]
    orders = np.log2(np.array(gaps[:-1]) / np.array(gaps[1:]))
    assert np.all(np.abs(orders - 3.0) < 0.1), orders


def test_a_small_push_moves_both_alike() -> None:
    """Every signal, within 0.1 % of its own largest value: the nonlinear crane's time error.

    Its trolley.fx is the mean of the last internal step, half a millisecond old: within 1 %.
    """
    settings = Crane(damping=Damping(air=0.3)), Initial(0.0), Numerics()
    cranes = LinearCrane(*settings), NonlinearCrane(*settings)
    names = ["payload.x", "payload.vx", "chain.mid_x_rel", "chain.top_angle", "trolley.fx"]
    names += ["energy.total", "energy.dissipated"]
    seen: list[list[list[float]]] = [[], []]
    for i in range(200):
        for crane, rows in zip(cranes, seen, strict=True):
            crane.step(5e-3, Command(payload_fx=1e-3 if i < 40 else 0.0))
            out = crane.outputs()
            rows.append([out[name] for name in names])
    linear, nonlinear = np.array(seen[0]), np.array(seen[1])
    gap = np.abs(linear - nonlinear).max(axis=0) / np.abs(linear).max(axis=0)
    allowed = [1e-2 if name == "trolley.fx" else 1e-3 for name in names]
    assert np.all(gap < allowed), dict(zip(names, gap, strict=True))


def test_a_small_jump_of_the_trolley_moves_both_alike() -> None:
    settings = Crane(), Initial(1e-3), Numerics()
    linear, nonlinear = LinearCrane(*settings), NonlinearCrane(*settings)
    for _ in range(40):
        for crane in (linear, nonlinear):
            crane.step(5e-3)
    a, b = linear.outputs(), nonlinear.outputs()
    for name in ("payload.x", "payload.vx", "chain.mid_x_rel", "chain.top_angle"):
        assert abs(a[name] - b[name]) < 2e-2 * abs(a[name]), name
    assert abs(a["energy.total"] - b["energy.total"]) < 1e-6 * abs(a["energy.total"])
