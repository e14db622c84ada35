"""Rung 2, statics. References: analytic."""

import numpy as np
import pytest

from chaincrane.plant.chain import (
    along_elements,
    axial_force,
    discretise,
    hanging_tension,
    internal_force,
    interpolation,
    straight_chain,
)
from chaincrane.plant.command import Command
from chaincrane.plant.linear import LinearCrane
from chaincrane.plant.nonlinear import NonlinearCrane
from chaincrane.plant.parameters import Chain, Crane, Damping, Initial, Numerics, Payload

SOFT = Crane(chain=Chain(EA=200.0))  # stretches by centimetres


@pytest.mark.parametrize("crane", [Crane(), SOFT])
@pytest.mark.parametrize("elements", [1, 2, 10, 37])
def test_hanging_equilibrium_is_in_balance(crane: Crane, elements: int) -> None:
    chain = discretise(crane, elements)
    d = along_elements(chain.rest)
    force = axial_force(crane.chain.EA, chain.L0, np.hypot(*d.T))
    residual = chain.weight - internal_force(d, force)
    round_off = 1e-15 * crane.chain.EA / chain.L0 * crane.chain.length
    assert np.abs(residual).max() < 1e-12 + round_off


def test_reaction_is_the_weight() -> None:
    crane = Crane()
    chain = discretise(crane, 10)
    half_element = 0.5 * crane.chain.mass / 10 * crane.gravity
    weight = (crane.chain.mass + crane.payload.mass) * crane.gravity
    assert hanging_tension(crane, 10)[0] + half_element == pytest.approx(weight, rel=1e-14)
    assert chain.weight[:, 1].sum() - half_element == pytest.approx(-weight, rel=1e-14)


def test_stretch_is_that_of_a_hanging_rod() -> None:
    """Analytic: L (M + m/2) g / EA, whatever the number of elements."""
    crane = SOFT
    expected = crane.chain.length * (1 + (0.42 + 0.11) * 9.81 / 200.0)
    for elements in (1, 3, 10):
        assert -discretise(crane, elements).rest[-1, 1] == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("model", [NonlinearCrane, LinearCrane])
@pytest.mark.parametrize("payload", [0.42, 0.07])
def test_a_crane_at_rest_stays_at_rest(model: type, payload: float) -> None:
    crane = model(Crane(payload=Payload(payload)), Initial(speed=0.0))
    start = crane.outputs()
    for _ in range(100):
        crane.step(0.01)
    for name, value in crane.outputs().items():
        if name.startswith(("payload", "chain.x", "chain.y", "chain.mid", "trolley")):
            assert abs(value - start[name]) <= 1e-12, name


def test_held_at_an_angle_each_element_carries_its_share() -> None:
    chain = discretise(SOFT, 5)
    angle = 0.4
    r = straight_chain(chain, angle)
    np.testing.assert_allclose(np.arctan2(r[:, 0], -r[:, 1]), angle, rtol=1e-14)
    d = along_elements(r)
    force = axial_force(SOFT.chain.EA, chain.L0, np.hypot(*d.T))
    np.testing.assert_allclose(force, hanging_tension(SOFT, 5) * np.cos(angle), rtol=1e-12)


def test_material_points_lie_on_the_elements() -> None:
    for elements in (1, 2, 3, 10, 33):
        fractions = np.linspace(0.1, 1.0, 10)
        nodes = np.arange(1, elements + 1) / elements
        np.testing.assert_allclose(
            interpolation(elements, fractions) @ nodes, fractions, rtol=1e-14
        )


@pytest.mark.parametrize("scheme", ["energy_momentum", "newmark"])
def test_mirrored_motion_is_mirrored(scheme: str) -> None:
    """Left and right are alike: the same run with all signs of x turned."""
    ends = []
    for sign in (1.0, -1.0):
        crane = NonlinearCrane(initial=Initial(speed=sign * 0.8), numerics=Numerics(scheme=scheme))
        for _ in range(200):
            crane.step(
                1e-3,
                Command(trolley_v_cmd=sign * 0.1, trolley_a_cmd=sign * 0.3, payload_fx=sign * 0.2),
            )
        ends.append(crane.outputs())
    for name in ("payload.x", "payload.vx", "trolley.fx", "chain.top_angle"):
        assert ends[0][name] == -ends[1][name], name
    for name in ("payload.y", "chain.tension_top", "energy.total"):
        assert ends[0][name] == ends[1][name], name


@pytest.mark.parametrize("model", [LinearCrane, NonlinearCrane])
@pytest.mark.parametrize("angle", [0.3, -1.5, 3.0])
def test_the_drives_force_before_the_first_step_is_that_of_the_release(
    model: type, angle: float
) -> None:
    """What the drive exerts over the first microsecond, in air too; the crane at rest: none."""
    crane = Crane(Chain(EA=1e4), damping=Damping(air=0.5))
    sways = model(crane, Initial(speed=0.4, sway_angle=angle))
    before = sways.outputs()["trolley.fx"]
    sways.step(1e-6, Command(trolley_v_cmd=0.4))
    assert abs(before) > 0.05
    assert sways.outputs()["trolley.fx"] == pytest.approx(before, abs=1e-4 * abs(before))
    rests = model(Crane(), Initial(speed=0.0))
    assert rests.outputs()["trolley.fx"] == 0.0
