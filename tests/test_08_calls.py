"""Rung 8, when a host calls what: its times, its stop time, its phases, and what is not finite.

Reference: FMI 2.0's text, and each FMU's own run from t = 0. A refusal is an error of the call in a
native FMU; in a Python one a log line, and the next step is discarded.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from conftest import in_fresh_process
from fmpy import read_model_description
from test_08_hosts import all_fmus, every

from chaincrane.clock import TIME_TOLERANCE, is_beyond, is_now, meant_step
from chaincrane.plant.linear import LinearCrane
from chaincrane.plant.parameters import Crane, Initial, Payload
from chaincrane_builder.fmus import NATIVE_MODELS

__all__ = ["all_fmus"]
CRANES = ("crane_nl", "crane_lin", *NATIVE_MODELS)


# --- times ------------------------------------------------------------------------------------


@pytest.mark.parametrize("start", [0.0, 1.0, 41.0, 86_400.0, 1e9])
@pytest.mark.parametrize("h", [0.001, 0.005, 0.013])
def test_a_step_is_what_was_meant(start: float, h: float) -> None:
    """Of the times that a host adds up or multiplies, and of no step that is truly another."""
    whole = round(h / 0.001) * 0.001
    times = start + np.arange(1000) * h
    if h / 0.001 * np.spacing(start) < 1e-4:  # at 1e9 s a time is known to 1e-7 s
        sizes = map(float, np.diff(times))
        assert {meant_step(t, d, 0.001) for t, d in zip(times, sizes, strict=False)} == {whole}
    for other in (h * (1 + 1e-3), h * (1 - 1e-3), 0.0007):
        expected = whole if abs(other - whole) <= 1e-15 * (start + other) else other
        assert meant_step(start, other, 0.001) == expected
    for strange in (math.nan, math.inf, -1.0, 0.0, 1e-300):
        assert str(meant_step(start, strange, 0.001)) == str(strange)


def test_no_step_can_be_done_twice_or_left_out() -> None:
    """Whatever the time, a point half a step away is another one; an added-up one is the same."""
    for time in (0.0, 1.0, 86_400.0, 1e9):
        added = time
        for _ in range(1000):
            added += 0.001
        assert is_now(time + 1.0, added, 0.001) == (abs(time + 1.0 - added) <= 1e-9 + 1e-15 * time)
        for h in (1e-10, 1e-6, 0.001, 1.0):
            if h > np.spacing(time) * 8:
                assert not is_now(time - h, time, h) and not is_now(time + h, time, h)
                assert is_beyond(time + h, time, h)
        assert is_now(time, time, 0.001) and not is_beyond(time, time, 0.001)
    assert not is_beyond(1.0 + 0.9 * TIME_TOLERANCE, 1.0, 0.005)


def _from_midnight(fmu: str, start: float, h: float, steps: int) -> list[Any]:
    """Sizes as t[i+1] - t[i]; the motion, the internal steps and the time that was reached."""
    from itertools import pairwise

    from slave_host import Host

    host = Host(fmu, initialise=False)
    host.slave.setupExperiment(startTime=start, stopTime=start + steps * h)
    host.slave.enterInitializationMode()
    host.slave.exitInitializationMode()
    counted = 0.0
    times = [start + i * h for i in range(steps + 1)]
    for at, then in pairwise(times):
        assert host.step(then - at, at=at) == 0
        counted += host.get("solver.steps") if "solver.steps" in host.variables else 1.0
    back = [host.step(h, at=times[-1] - away) for away in (h, 0.6 * h)]
    return [host.outputs(), counted, back]


@every
def test_a_run_at_the_end_of_a_day_is_the_run_at_its_start(
    all_fmus: dict[str, str], model: str
) -> None:
    """The same bits, and 400 internal steps, no more; a step back in time is refused."""
    steps = 400 if model in CRANES else 40
    h = 0.001 if model in CRANES else 0.0078125  # a step that both days hold exactly
    zero, late, last = (
        in_fresh_process(_from_midnight, all_fmus[model], start, h, steps)
        for start in (0.0, 86_400.0, 1e9)
    )
    assert late == zero
    assert last == zero
    assert zero[1:] == [steps, [2, 2]]


def test_every_output_and_input_is_a_real(all_fmus: dict[str, str]) -> None:
    """For tools that read and set all of them as Reals."""
    for fmu in all_fmus.values():
        rows = read_model_description(fmu).modelVariables
        assert {v.type for v in rows if v.causality != "parameter"} == {"Real"}


def _asked_together(fmu: str) -> int:
    """Sets of Real variables that were not what each is when asked for alone."""
    import itertools

    from slave_host import Host

    host = Host(fmu)
    real = [v.valueReference for v in host.variables.values() if v.type == "Real"]
    pairs = list(itertools.islice(itertools.permutations(real[::-1], 2), 100))
    asked = [real, real[::-1], real[-3:] * 2, [real[-1], real[0]], *pairs]
    wrong = 0
    for _ in range(3):
        assert host.step() == 0
        alone = {reference: host.slave.getReal([reference])[0] for reference in real}
        for _ in range(2):
            for some in asked:
                wrong += list(host.slave.getReal(some)) != [alone[reference] for reference in some]
    return wrong


@every
def test_outputs_asked_for_together_are_those_asked_for_alone(
    all_fmus: dict[str, str], model: str
) -> None:
    assert in_fresh_process(_asked_together, all_fmus[model]) == 0


# --- stop time and phases ---------------------------------------------------------------------


def _out_of_order(fmu: str) -> list[list[Any]]:
    from fmpy.fmi1 import FMICallException
    from slave_host import LOG, Host

    seen: list[list[Any]] = []

    def told(call: Any) -> None:
        before = len(LOG)
        try:
            call()
            status = 0
        except FMICallException as error:
            status = int(error.status)
        seen.append([status, LOG[-1] if len(LOG) > before else ""])

    host = Host(fmu, initialise=False)
    slave = host.slave
    told(slave.terminate)
    told(lambda: slave.setupExperiment(startTime=1.0, stopTime=0.5))
    slave.reset()
    slave.setupExperiment(startTime=0.0, stopTime=0.05)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    for _ in range(4):
        assert host.step(0.0125) == 0  # to the stop time
    kept = host.outputs()
    told(lambda: slave.doStep(currentCommunicationPoint=0.05, communicationStepSize=0.0125))
    assert host.outputs() == kept
    told(lambda: slave.setupExperiment(startTime=0.0))
    slave.reset()
    host.initialise()
    assert host.step(0.0125) == 0
    slave.terminate()
    told(slave.terminate)
    return seen


@every
def test_calls_out_of_order_are_refused(all_fmus: dict[str, str], model: str) -> None:
    seen = in_fresh_process(_out_of_order, all_fmus[model])
    words = ["this one is instantiated", "stop time = 0.5", "end of the step = 0.0625"]
    words += ["only before initialisation mode", "this one is terminated"]
    native = model in NATIVE_MODELS
    for (status, message), word in zip(seen, words, strict=True):
        step = word.startswith("end of")
        assert status == (3 if native else 2 if step else 0), word
        assert message.startswith("logStatusError: ") and word in message


# --- what is not finite -----------------------------------------------------------------------


def _not_finite(fmu: str, name: str, value: float) -> list[Any]:
    from slave_host import LOG, Host

    host = Host(fmu)
    host.run(3)
    before = host.outputs()
    host.set(name, value)
    status, message = host.step(), LOG[-1].split(": ", 1)[1]
    same = host.outputs() == before
    host.set(name, 0.0)
    return [status, message, same, host.step()]


@pytest.mark.parametrize("name", ["trolley.v_cmd", "trolley.a_cmd", "payload.fx"])
def test_what_ends_in_no_finite_number_is_refused(all_fmus: dict[str, str], name: str) -> None:
    """The state kept, in the same words by a crane and its twin."""
    for pair in (("crane_lin", "crane_lin_native"), ("crane_nl", "crane_nl_native")):
        theirs, ours = (in_fresh_process(_not_finite, all_fmus[m], name, 1e300) for m in pair)
        assert ours == theirs
        status, message, same, after = ours
        assert (status, same, after) == (2, True, 0), message
        if pair[0] == "crane_lin":
            assert message.endswith("is not allowed: inputs and a step that keep it finite")


def _begun(fmu: str, start: dict[str, float]) -> list[Any]:
    from fmpy.fmi1 import FMICallException
    from slave_host import LOG, Host

    host = Host(fmu, initialise=False)
    try:
        host.initialise(**start)
        status = host.step()
    except FMICallException as error:
        status = int(error.status)
    return [
        status,
        LOG[-1].split(": ", 1)[1] if LOG else "",
        None if status else host.get("payload.x_rel"),
    ]


def test_parameters_that_end_in_no_finite_number_are_refused(all_fmus: dict[str, str]) -> None:
    for model in CRANES:
        status, message, _ = in_fresh_process(_begun, all_fmus[model], {"initial__speed": 1e200})
        assert status == (3 if model in NATIVE_MODELS else 2)
        assert "= inf is not allowed: parameters that keep it finite" in message, message


@pytest.mark.parametrize("mass", [1e14, 1e15, 1e16, 1e100])
def test_the_linear_crane_in_c_carries_what_its_twin_carries(
    all_fmus: dict[str, str], mass: float
) -> None:
    start = {"payload__mass": mass, "initial__speed": 0.0, "initial__sway_angle": 0.1}
    status, _, x = in_fresh_process(_begun, all_fmus["crane_lin_native"], start)
    crane = LinearCrane(Crane(payload=Payload(mass)), Initial(0.0, 0.1))
    crane.step(0.01)
    assert status == 0
    assert x == pytest.approx(crane.outputs()["payload.x_rel"], abs=1e-12)


# --- texts ------------------------------------------------------------------------------------


def _long_texts(fmu: str, texts: list[str]) -> list[str]:
    from fmpy.fmi1 import FMICallException
    from slave_host import LOG, Host

    for text in texts:
        host = Host(fmu, initialise=False)
        try:
            host.initialise(chain__mass_matrix=text)
            host.step()
        except FMICallException:
            pass
    return LOG  # whose bytes the logger has read as UTF-8


@every
def test_messages_are_whole_characters(all_fmus: dict[str, str], model: str) -> None:
    texts = ["a" * shift + "\u00fc\u20ac\U0001f3d7" * 40 for shift in range(5)] + ["%s%n"]
    log = in_fresh_process(_long_texts, all_fmus[model], texts)
    assert len(log) >= len(texts)
    assert all("chain.mass_matrix = '" in line for line in log)
    assert "'%s%n' is not allowed" in log[-1]  # and no format: a host prints, or crashes, by one
