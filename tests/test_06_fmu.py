"""Rung 6, the FMUs, driven by FMPy from their files. Each run has a process of its own."""

import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from conftest import PAYLOADS, SPEED, STOP_AT, paper_motion
from fmpy.validation import validate_fmu

from chaincrane.plant.chain import discretise, hanging_tension
from chaincrane.plant.command import Command
from chaincrane.plant.interface import PARAMETERS
from chaincrane.plant.kernel import NativeCrane
from chaincrane.plant.linear import LinearCrane
from chaincrane.plant.parameters import Chain, Crane, Damping, Initial, Numerics, Payload
from chaincrane_driver.errors import UserError
from chaincrane_driver.processes import simulate_all
from chaincrane_driver.simulate import Job

STEPS = (0.001, 0.005, 0.013, 0.05)  # s, communication steps


def paper_job(fmu: Path, payload: float, step: float, **start: Any) -> Job:
    values = {"payload.mass": payload} | {k.replace("__", "."): v for k, v in start.items()}
    return Job(fmu, values, paper_motion(), 4.0, step)


def closed_form(payload: float, times: np.ndarray, elements: int = 10) -> dict[str, np.ndarray]:
    """Analytic: the string's response to the stop, mode by mode, assembled here from MODEL's text.

    q(t) = sum over modes of phi (phi^T b) v sin(w (t - 1))/w, b = M 1 including node 0's coupling.
    """
    crane = Crane(payload=Payload(payload))
    n, L0 = elements, 0.8 / elements
    tension = hanging_tension(crane, n)
    M, K = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))
    for e in range(n):
        M[e : e + 2, e : e + 2] += 0.22 / n / 6.0 * np.array([[2.0, 1.0], [1.0, 2.0]])
        K[e : e + 2, e : e + 2] += tension[e] / L0 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    M[n, n] += payload
    squares, shapes = scipy.linalg.eigh(K[1:, 1:], M[1:, 1:])
    omega = np.sqrt(squares)
    load = shapes.T @ M[1:].sum(axis=1) * SPEED
    since = np.maximum(times - STOP_AT, 0.0)
    q = shapes @ (load[:, None] * np.sin(omega[:, None] * since) / omega[:, None])
    return {"payload.x_rel": q[-1], "chain.mid_x_rel": q[n // 2 - 1]}


@pytest.mark.parametrize("model", ["crane_nl", "crane_lin"])
def test_fmpy_validates(fmus: Path, model: str) -> None:
    assert validate_fmu(str(fmus / f"{model}.fmu")) == []


def test_linear_fmu_equals_the_closed_form(fmus: Path) -> None:
    """To 1e-9 m over 4 s, whatever the communication step: nothing but round-off is left."""
    cases = [(payload, step) for payload in PAYLOADS.values() for step in STEPS]
    jobs = [paper_job(fmus / "crane_lin.fmu", payload, step) for payload, step in cases]
    for (payload, step), result in zip(cases, simulate_all(jobs, "closed form"), strict=True):
        expected = closed_form(payload, result["time"])
        for name, values in expected.items():
            assert np.abs(result[name] - values).max() < 1e-9, (payload, step, name)
        assert result["time"][-1] == pytest.approx(4.0)


@pytest.mark.parametrize("payload", PAYLOADS.values(), ids=PAYLOADS.keys())
def test_nonlinear_fmu_is_near_its_converged_solution(fmus: Path, payload: float) -> None:
    """Payload within 2e-4 m over 4 s, at communication steps of 1, 5 and 13 ms.

    The converged solution is the FMU's own at an eighth of the internal step; as the error is of
    second order it is 64 times nearer to the limit, 1e-6 m.
    """
    jobs = [paper_job(fmus / "crane_nl.fmu", payload, step) for step in STEPS[:3]]
    fine = {"solver__max_step": 1.25e-4}
    jobs += [paper_job(fmus / "crane_nl.fmu", payload, step, **fine) for step in STEPS[1:3]]
    *coarse, fine_5, fine_13 = simulate_all(jobs, "converged")
    truths = {0.001: fine_5, 0.005: fine_5, 0.013: fine_13}
    for step, result in zip(STEPS[:3], coarse, strict=True):
        truth = truths[step]
        rows = result[::5] if step == 0.001 else result
        away = np.hypot(
            rows["payload.x"] - truth["payload.x"], rows["payload.y"] - truth["payload.y"]
        )
        np.testing.assert_allclose(rows["time"], truth["time"], atol=1e-9)
        assert away.max() < 2e-4, step


@pytest.mark.parametrize("payload", PAYLOADS.values(), ids=PAYLOADS.keys())
def test_energy_after_the_stop_is_constant(fmus: Path, payload: float) -> None:
    """To 1e-4 of the swing's energy, 3 s long."""
    (result,) = simulate_all([paper_job(fmus / "crane_nl.fmu", payload, 0.005)], "energy")
    swinging = result["energy.total"][result["time"] > STOP_AT + 1e-9]
    assert np.ptp(swinging) < 1e-4 * swinging[0]
    assert np.abs(result["energy.error"]).max() < 1e-9 * swinging[0]


@pytest.mark.parametrize("model", ["crane_nl", "crane_lin"])
def test_at_rest_without_input_it_rests_for_a_minute(fmus: Path, model: str) -> None:
    job = Job(fmus / f"{model}.fmu", {"initial.speed": 0.0}, None, 60.0, 0.05)
    (result,) = simulate_all([job], "rest")
    assert result.dtype.names is not None
    for name in result.dtype.names:
        if name.startswith(
            ("trolley.x", "trolley.v", "payload", "chain.x", "chain.y", "chain.mid")
        ):
            assert np.abs(result[name] - result[name][0]).max() <= 1e-12, name


def test_nothing_set_it_is_the_papers_crane_just_stopped(fmus: Path) -> None:
    jobs = [Job(fmus / f"{model}.fmu", {}, None, 4.0, 0.005) for model in ("crane_nl", "crane_lin")]
    for result in simulate_all(jobs, "default"):
        assert result["trolley.v"][0] == SPEED
        assert np.all(result["trolley.v"][1:] == 0.0)
        assert 0.2 < np.abs(result["payload.x_rel"]).max() < 0.3
        assert result["payload.x"][0] == 0.0


@pytest.mark.parametrize("model", ["crane_nl", "crane_lin"])
def test_fmu_is_the_model(fmus: Path, library: Any, model: str) -> None:
    """Every parameter, input and output goes through the FMU unchanged, bit for bit."""
    native = partial(NativeCrane, library=library)
    cranes: dict[str, Callable[..., Any]] = {"crane_nl": native, "crane_lin": LinearCrane}
    start = {
        "chain.length": 0.9,
        "chain.mass": 0.3,
        "chain.EA": 2e5,
        "chain.elements": 7,
        "payload.mass": 0.2,
        "gravity": 9.5,
        "damping.air": 0.1,
        "damping.chain": 1e-5,
        "initial.speed": 0.3,
        "initial.sway_angle": 0.1,
        "solver.max_step": 2e-3,
        "solver.scheme": "newmark",
        "chain.mass_matrix": "averaged",
        "solver.error_estimate": "companion",
        "solver.tolerance": 1e-4,
        "solver.tolerance_from": "parameter",
        "chain.formulation": "truss",
    }
    assert set(start) == {variable.name for variable in PARAMETERS}
    inputs = np.array(
        [(0.0, 0.1, 0.2, 0.3)],
        dtype=[(n, float) for n in ("time", "trolley.v_cmd", "trolley.a_cmd", "payload.fx")],
    )
    (result,) = simulate_all([Job(fmus / f"{model}.fmu", start, inputs, 0.5, 0.5)], "model")
    crane = cranes[model](
        Crane(
            chain=Chain(0.9, 0.3, 2e5),
            payload=Payload(0.2),
            gravity=9.5,
            damping=Damping(0.1, 1e-5),
        ),
        Initial(0.3, 0.1),
        Numerics(7, 2e-3, "newmark", "averaged", error_estimate="companion", tolerance=1e-4),
    )
    for row in range(2):
        for name, value in crane.outputs().items():
            assert result[name][row] == value, (row, name)
        if row == 0:
            crane.step(0.5, Command(trolley_v_cmd=0.1, trolley_a_cmd=0.2, payload_fx=0.3))


def test_chain_points_do_not_depend_on_the_mesh(fmus: Path) -> None:
    """chain.x[i] is the point at i/10 of the chain, for any chain.elements."""
    jobs = [
        Job(
            fmus / "crane_nl.fmu",
            {"chain.elements": n, "initial.sway_angle": 0.3, "initial.speed": 0.0},
            None,
            0.005,
            0.005,
        )
        for n in (1, 3, 10, 25)
    ]
    for result in simulate_all(jobs, "points"):
        x = [result[f"chain.x[{i}]"][0] for i in range(1, 11)]
        np.testing.assert_allclose(x, 0.08 * np.arange(1, 11) * np.sin(0.3), rtol=1e-5)
        assert x[9] == result["payload.x"][0]
        assert abs(x[4] - result["chain.mid_x_rel"][0]) < 1e-15


def test_linear_fmu_keeps_the_rest_values_it_cannot_vary(fmus: Path) -> None:
    (result,) = simulate_all([paper_job(fmus / "crane_lin.fmu", 0.42, 0.05)], "rest values")
    assert np.all(result["payload.y"] == discretise(Crane(), 10).rest[-1, 1])
    assert np.all(result["payload.vy"] == 0.0)
    assert np.ptp(result["chain.tension_top"]) == 0.0
    weight = (0.42 + 0.22) * 9.81
    assert result["chain.tension_top"][0] == pytest.approx(weight, rel=0.02)


def test_fmpy_command_line_needs_no_option(fmus: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    command = [sys.executable, "-m", "fmpy", "simulate", str(fmus / "crane_nl.fmu")]
    subprocess.run([*command, f"--output-file={out}"], check=True)
    rows = np.genfromtxt(out, delimiter=",", names=True, deletechars="")
    assert len(rows) == 801
    assert 0.2 < np.abs(rows["payload.x_rel"]).max() < 0.3


def test_the_formulation_is_chosen_by_its_name(fmus: Path, native_fmus: Path) -> None:
    """The inextensible chain in both FMUs is the kernel's; too many points are refused by name."""
    chosen = {"chain.formulation": "inextensible", "chain.elements": 8}
    files = [fmus / "crane_nl.fmu", native_fmus / "crane_nl_native.fmu"]
    jobs = [Job(file, chosen, paper_motion(), 2.0, 0.005) for file in files]
    python, native = simulate_all(jobs, "named")
    for name in ("payload.x", "chain.y[5]", "trolley.fx", "chain.tension_min", "energy.error"):
        assert np.abs(python[name] - native[name]).max() < 1e-9, name
    assert np.abs(python["payload.x"]).max() > 0.5
    for file in files:
        many = chosen | {"chain.elements": 41}
        with pytest.raises(UserError, match=r"chain\.elements = 41 is not allowed: at most 40"):
            simulate_all([Job(file, many, paper_motion(), 0.1, 0.005)], "refused")
