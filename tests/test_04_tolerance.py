"""Rung 4, a tolerance of the time error. References: the same crane with its last step from the
start, to the bit; and with a 64th of it.
"""

from __future__ import annotations

from math import hypot
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu

from chaincrane.errors import BadState, BadValue
from chaincrane.plant import tolerance as plant_tolerance
from chaincrane.plant.command import Command
from chaincrane.plant.interface import TOLERANCE_NOT_KEPT, settings
from chaincrane.plant.kernel import NativeCrane
from chaincrane.plant.tolerance import MAX_REFINEMENTS, TolerantCrane, nonlinear_crane

SAMPLE = 0.01  # s
COARSE = {"solver.max_step": 5e-3}


def crane(library: Any, values: dict[str, Any]) -> Any:
    """The crane in C, or without a library the NumPy one."""
    chosen = settings(values)
    return nonlinear_crane(*chosen) if library is None else NativeCrane(*chosen, library=library)


@pytest.mark.parametrize("in_c", [True, False])
def test_it_is_the_crane_of_its_last_step(library: Any, in_c: bool) -> None:
    """At each communication point: no step is chosen from the past alone."""
    kernel = library if in_c else None
    values: dict[str, Any] = {"chain.elements": 4, "payload.mass": 0.07, "solver.max_step": 5e-3}
    kept = crane(kernel, values | {"solver.tolerance": 2e-5})
    lengths, used = (0.01, 0.013, 0.02), []
    steps = [(lengths[i % 3], Command(trolley_a_cmd=0.4 * (i % 5 - 2))) for i in range(60)]
    rungs = [
        crane(
            kernel,
            values | {"solver.max_step": 5e-3 / 2**k, "solver.error_estimate": "companion"},
        )
        for k in range(MAX_REFINEMENTS + 1)
    ]
    for h, command in steps:
        kept.step(h, command)
        for rung in rungs if in_c else rungs[:4]:
            rung.step(h, command)
        cost = ("solver.steps", "solver.iterations")
        seen = {name: value for name, value in kept.outputs().items() if name not in cost}
        alike = [k for k, rung in enumerate(rungs) if seen.items() <= rung.outputs().items()]
        assert alike
        used.append(alike[0])
        assert seen["error.payload"] <= 1e-5
        before = rungs[alike[0] - 1].outputs()["error.payload"]
        assert alike[0] == 0 or before > 1e-5  # no shorter than it must be
    assert used == sorted(used)
    assert used[0] == 0 and used[-1] >= 2


def random_crane(random: Random) -> dict[str, Any]:
    """A crane of 0.3 to 5 m, of steel or soft, that stops or is pulled."""
    mass = 10.0 ** random.uniform(-1.3, 0.7)
    return {
        "chain.length": 10.0 ** random.uniform(-0.5, 0.7),
        "chain.mass": mass,
        "chain.EA": random.choice([1e5, 7e6]),
        "payload.mass": mass * 10.0 ** random.uniform(-0.3, 1.0),
        "chain.elements": random.randint(2, 12),
        "initial.speed": random.choice([0.0, 0.5]),
        "initial.sway_angle": random.choice([0.0, 0.2]),
        "solver.max_step": random.choice([1e-3, 4e-3]),
    }


def test_the_true_error_keeps_it(library: Any) -> None:
    """30 random cranes: below twice the tolerance, where it says that it keeps it."""
    random, kept, refined = Random(5), 0, 0
    for _ in range(30):
        values = random_crane(random)
        rough = crane(library, values | {"solver.tolerance": 1e-4})
        fine = crane(library, values | {"solver.max_step": values["solver.max_step"] / 128})
        worst = 0.0
        for i in range(200):
            command = Command(trolley_a_cmd=0.5 if i < 60 else 0.0)
            rough.step(SAMPLE, command)
            fine.step(SAMPLE, command)
            a, b = rough.outputs(), fine.outputs()
            worst = max(
                worst, hypot(a["payload.x"] - b["payload.x"], a["payload.y"] - b["payload.y"])
            )
        if rough.notice() is None:
            kept += 1
            assert worst < 2e-4, values
        plain = crane(library, values | {"solver.error_estimate": "companion"})
        for i in range(200):
            plain.step(SAMPLE, Command(trolley_a_cmd=0.5 if i < 60 else 0.0))
        refined += plain.outputs()["error.payload"] > 1e-4
    assert kept >= 27
    assert refined >= 5  # else nothing was shown


@pytest.mark.parametrize("in_c", [True, False])
def test_what_cannot_be_kept_is_said(library: Any, in_c: bool) -> None:
    """A tolerance of round-off: steps a 64th as long, one notice, and the run goes on."""
    values = {"chain.elements": 1, "solver.max_step": 2e-3, "solver.tolerance": 1e-15}
    one = crane(library if in_c else None, values)
    assert one.notice() is None
    one.step(SAMPLE)
    assert one.notice() == TOLERANCE_NOT_KEPT
    before = one.outputs()["solver.steps"]
    one.step(SAMPLE)
    assert before > one.outputs()["solver.steps"]  # no more runs from the start
    assert one.outputs()["solver.steps"] == 1.5 * 6 * 2**MAX_REFINEMENTS * 5 / 6


@pytest.mark.parametrize("in_c", [True, False])
def test_a_saved_state_can_be_refined_further(library: Any, in_c: bool) -> None:
    """It holds the steps since the start; another crane goes on from it to the same bits."""
    values = {"chain.elements": 3, "solver.max_step": 4e-3, "solver.tolerance": 2e-5}
    one, other = (crane(library if in_c else None, values) for _ in range(2))
    start = one.save()
    for _ in range(10):
        one.step(SAMPLE)
    state, sizes = one.save(), []
    for _ in range(60):
        one.step(SAMPLE)
        sizes.append(one.outputs()["solver.steps"])
    assert len(set(sizes)) > 1  # it was refined in between
    other.step(0.05)
    other.load(state)
    assert other.save() == state
    for _ in range(60):
        other.step(SAMPLE)
    assert other.save() == one.save()
    for bad in (b"", state[:-8], state + bytes(8), state[:-1], state[:64]):
        with pytest.raises(BadState, match=r"solver\.tolerance"):
            other.load(bad)
        assert other.save() == one.save()
    other.load(start)
    assert other.save() == start


def test_numpy_and_c_save_the_same(library: Any) -> None:
    """Header and remembered steps to the bit, the crane's numbers to round-off."""
    values = {"chain.elements": 3, "solver.max_step": 4e-3, "solver.tolerance": 2e-5}
    states = []
    for one in (crane(None, values), crane(library, values)):
        for i in range(40):
            one.step(SAMPLE, Command(trolley_a_cmd=0.01 * i))
        states.append(np.frombuffer(one.save()))
    a, b = states
    tail = 3 + 40 * 6
    assert np.array_equal(a[-tail:], b[-tail:])
    np.testing.assert_allclose(a[:-tail], b[:-tail], rtol=1e-6, atol=1e-9)


def test_a_full_memory_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """More steps than are remembered: it goes on as it is, and says so once it is exceeded."""
    monkeypatch.setattr(plant_tolerance, "MAX_REMEMBERED", 3)
    one = nonlinear_crane(
        *settings({"chain.elements": 2, "solver.max_step": 5e-3, "solver.tolerance": 1e-6})
    )
    assert isinstance(one, TolerantCrane)
    for _ in range(3):
        one.step(1e-4)
    assert one.notice() is None
    for _ in range(40):
        one.step(SAMPLE)
    assert one.notice() == TOLERANCE_NOT_KEPT
    assert one.outputs()["solver.steps"] == 3  # a pair and one twice as long: never refined
    again = nonlinear_crane(
        *settings({"chain.elements": 2, "solver.max_step": 5e-3, "solver.tolerance": 1e-6})
    )
    again.load(one.save())
    again.step(SAMPLE)
    one.step(SAMPLE)
    assert again.save() == one.save()


@pytest.mark.parametrize("model", ["crane_nl", "crane_nl_native"])
def test_the_experiments_tolerance(fmus: Path, native_fmus: Path, model: str) -> None:
    """FMI's tolerance, of the chain's length, where the user asks for it; else it does nothing."""
    asked = {"solver.max_step": 5e-3, "solver.tolerance_from": "experiment"}
    told = {"solver.max_step": 5e-3, "solver.tolerance": 1e-4 * 0.8}
    plain = {"solver.max_step": 5e-3}
    outputs = ["payload.x", "error.payload"]

    def run(start: dict[str, Any], relative: float | None) -> Any:
        return simulate_fmu(
            str((native_fmus if model.endswith("native") else fmus) / f"{model}.fmu"),
            stop_time=1.0,
            output_interval=SAMPLE,
            relative_tolerance=relative,
            start_values=start,
            output=outputs,
        )

    by_experiment, by_parameter = run(asked, 1e-4), run(told, None)
    assert np.array_equal(by_experiment, by_parameter)
    assert by_parameter["error.payload"][-1] > 0.0
    assert not np.array_equal(by_parameter, run(plain, 1e-4))
    assert np.array_equal(run(plain, None), run(plain, 1e-4))


def test_an_experiment_without_a_tolerance_is_refused() -> None:
    """By name, with what is allowed."""
    for bad in (None, 0.0, -1e-3, 1.0, float("nan")):
        with pytest.raises(BadValue, match=r"tolerance of the experiment = .* experiment asks"):
            settings({"solver.tolerance_from": "experiment"}, bad)
    _, _, numerics = settings({"solver.tolerance_from": "experiment", "chain.length": 2.0}, 1e-4)
    assert numerics.tolerance == 2e-4
    assert settings({"solver.tolerance": 1e-3}, 1e-4)[2].tolerance == 1e-3


def test_a_step_that_refined_is_undone() -> None:
    """To the bit, and what follows too: the crane before the step lies under the one after it."""
    crane, twin = (
        nonlinear_crane(*settings({"chain.elements": 3, "solver.tolerance": 2e-5, **COARSE}))
        for _ in range(2)
    )
    assert isinstance(crane, TolerantCrane)
    command = Command(trolley_a_cmd=0.8)
    while True:
        kept, state, level = crane.keep(), crane.save(), crane._level
        crane.step(SAMPLE, command)
        if crane._level > level:
            break
        twin.step(SAMPLE, command)
    after = crane.save()
    crane.undo(kept)
    assert crane.save() == state == twin.save()
    crane.step(SAMPLE, command)
    assert crane.save() == after


def test_a_step_refused_when_refined_leaves_no_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    """Outputs that are not finite, put in by hand, after the step that changed the crane."""
    crane = nonlinear_crane(*settings({"chain.elements": 3, "solver.tolerance": 2e-5, **COARSE}))
    command = Command(trolley_a_cmd=0.8)
    for _ in range(5):
        crane.advance(SAMPLE, command)
    state = crane.save()
    with monkeypatch.context() as patch:
        patch.setattr(TolerantCrane, "outputs", lambda _: {"payload.x": float("inf")})
        with pytest.raises(BadValue, match=r"payload\.x = inf is not allowed: inputs"):
            crane.advance(SAMPLE, command)
    assert crane.save() == state
