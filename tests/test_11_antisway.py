"""Rung 11, the controller and the loop. References: definitions, other masters, documents."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from conftest import PAYLOADS, ROOT, in_fresh_process
from fmpy.ssp.ssd import read_ssd
from fmpy.validation import validate_fmu
from hypothesis import given, settings
from hypothesis import strategies as st

from chaincrane.control.antisway import (
    AntiSway,
    AntiSwayInput,
    AntiSwaySettings,
    Limits,
    Scales,
    design_model,
    discretised,
    regulator,
    trapezoid,
    velocity_gained,
    zv_shaped,
)
from chaincrane.plant.chain import discretise
from chaincrane.plant.command import Command
from chaincrane.plant.linear import LinearCrane, TautString
from chaincrane.plant.parameters import Crane, Damping, Initial, Numerics, Payload
from chaincrane_driver import study
from chaincrane_driver.antisway import Setup, measure
from chaincrane_driver.errors import UserError
from chaincrane_driver.loop import ANTISWAY, CRANE, OBSERVER, column
from chaincrane_driver.masters import Package
from chaincrane_driver.processes import simulate_all
from chaincrane_driver.ssp import write_ssp
from chaincrane_driver.tables import Table

HEAVY, LIGHT = PAYLOADS.values()
A_CMD, V, X = column(ANTISWAY, "trolley.a_cmd"), column(CRANE, "trolley.v"), "crane::trolley.x"


# --- equations ---------------------------------------------------------------------------------


@pytest.mark.parametrize("air", [0.0, 0.5])
def test_the_design_model_is_the_linear_crane(air: float) -> None:
    """Trolley and modes after a push by a held acceleration, against the stepped crane."""
    crane = Crane(payload=Payload(LIGHT), damping=Damping(air))
    truth = LinearCrane(crane, Initial(0.0), Numerics(elements=2))
    Ad, Bd = discretised(*design_model(truth.string, 2), 0.3)
    truth.step(0.3, Command(trolley_a_cmd=0.4))
    truth.step(0.3, Command(trolley_a_cmd=-0.7))
    x = Ad @ (Bd[:, 0] * 0.4) - Bd[:, 0] * 0.7
    seen = truth.outputs()
    assert x[0] == pytest.approx(seen["trolley.x"], abs=1e-12)
    assert x[2] + x[4] == pytest.approx(seen["payload.x_rel"], abs=1e-12)
    assert x[3] + x[5] == pytest.approx(seen["payload.vx"] - seen["trolley.v"], abs=1e-12)


@pytest.mark.parametrize("modes", [1, 2])
def test_the_regulator_is_stable_and_optimal(modes: int) -> None:
    """Every other gain nearby costs more: x^T Q x + a^2 R, summed for ever (Lyapunov)."""
    string = TautString(discretise(Crane(payload=Payload(HEAVY)), 2))
    Ad, Bd = discretised(*design_model(string, modes), 0.05)
    K = regulator(Ad, Bd, Scales())
    assert np.abs(np.linalg.eigvals(Ad - Bd @ K[None])).max() < 1.0

    weights = np.zeros(len(Ad))
    weights[0], weights[2::2] = 0.2**-2, 0.1**-2

    def cost(gain: np.ndarray) -> float:
        each = np.diag(weights) + np.outer(gain, gain) / 0.5**2
        closed = Ad - Bd @ gain[None]
        return float(np.trace(scipy.linalg.solve_discrete_lyapunov(closed.T, each)))

    best = cost(K)
    for i in range(len(K)):
        for factor in (0.99, 1.01):
            other = K.copy()
            other[i] *= factor
            assert cost(other) > best


@given(
    distance=st.floats(-20.0, 20.0).filter(lambda d: abs(d) > 1e-6),
    v=st.floats(0.01, 3.0),
    a=st.floats(0.05, 5.0),
    h=st.sampled_from([0.001, 0.01, 0.03]),
)
def test_a_trapezoid_keeps_its_limits_and_ends_where_it_should(
    distance: float, v: float, a: float, h: float
) -> None:
    pieces = trapezoid(distance, Limits(v, a), h)
    times = [0.0, *(t for p in pieces for t in (p.start, p.end))]
    speeds = [velocity_gained(pieces, t) for t in times]
    assert max(abs(p.a) for p in pieces) <= a * (1 + 1e-8)
    assert max(map(abs, speeds)) <= v * (1 + 1e-8)
    assert speeds[-1] == pytest.approx(0.0, abs=1e-9)
    path = np.trapezoid(speeds, times)
    assert path == pytest.approx(distance, rel=1e-9)


@pytest.mark.parametrize("air", [0.0, 0.4])
def test_zv_leaves_no_swing_in_its_mode(air: float) -> None:
    """The residual of mode 1 by its integral: below a thousandth of the unshaped move's."""
    crane = Crane(payload=Payload(LIGHT), damping=Damping(air))
    string = TautString(discretise(crane, 2))
    omega = float(string.modes.omega[0])
    turned = np.sqrt(omega**2 - 0.25 * air**2)
    plain = trapezoid(1.0, Limits(), 0.01)

    def swing(pieces: Any) -> float:
        t = np.linspace(0.0, 8.0, 800001)
        a = sum(p.a * ((t >= p.start) & (t < p.end)) for p in pieces)
        return float(abs(np.sum(a * np.exp((0.5 * air + 1j * turned) * t)) * (t[1] - t[0])))

    assert swing(zv_shaped(plain, omega, air)) < 1e-3 * swing(plain)


@settings(max_examples=60, deadline=None)
@given(
    method=st.sampled_from(["lqr", "zv", "trapezoid"]),
    targets=st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=4),
    sway=st.lists(st.floats(-0.5, 0.5), min_size=4, max_size=4),
    h=st.sampled_from([0.002, 0.01, 0.05]),
)
def test_limits_hold_exactly_whatever_comes_in(
    method: str, targets: list[float], sway: list[float], h: float
) -> None:
    """Also with a target that moves and an estimate that is nonsense."""
    limits = Limits(0.37, 0.9)
    control = AntiSway(AntiSwaySettings(method=method, limits=limits))
    x = v = a = 0.0
    for number in range(300):
        shaken = [value * np.cos(number) for value in sway]
        told = AntiSwayInput(
            target_x=targets[number * len(targets) // 300],
            trolley_x=x,
            trolley_v=v,
            mode_x_rel_1=shaken[0],
            mode_x_rel_2=shaken[1],
            mode_vx_rel_1=shaken[2],
            mode_vx_rel_2=shaken[3],
        )
        control.step(h, told)
        x, v = x + h * v + 0.5 * h * h * a, v + h * a
        a = control.outputs()["trolley.a_cmd"]
        assert abs(v) <= limits.velocity
        assert abs(a) <= limits.acceleration


def test_open_loop_takes_the_next_target_after_the_move() -> None:
    control = AntiSway(AntiSwaySettings(method="zv"))
    x = v = a = 0.0
    for number in range(1500):
        target = 1.0 if number < 50 else 0.4
        control.step(0.01, AntiSwayInput(target_x=target, trolley_x=x, trolley_v=v))
        x, v = x + 0.01 * v + 0.5e-4 * a, v + 0.01 * a
        a = control.outputs()["trolley.a_cmd"]
    assert (x, v, a) == pytest.approx((0.4, 0.0, 0.0), abs=1e-9)


# --- the FMU -----------------------------------------------------------------------------------


def test_fmpy_validates(fmus: Path) -> None:
    assert validate_fmu(str(fmus / "crane_antisway.fmu")) == []


BAD = [
    ({"antisway.method": "magic"}, "antisway.method = 'magic' is not allowed: one of lqr, zv"),
    ({"antisway.model": "beam"}, "antisway.model = 'beam' is not allowed: one of chain, pendulum"),
    ({"antisway.modes": 3}, "antisway.modes = 3 is not allowed: a whole number from 1 to 2"),
    (
        {"antisway.model": "pendulum", "antisway.modes": 2},
        "antisway.modes = 2 is not allowed: a whole number from 1 to 1",
    ),
    ({"limit.velocity": 0.0}, "limit.velocity = 0.0 is not allowed: a finite number above 0"),
    ({"limit.acceleration": -1.0}, "limit.acceleration = -1.0 is not allowed: a finite number"),
    ({"antisway.scale.sway": 0.0}, "antisway.scale.sway = 0.0 is not allowed: a finite number"),
    ({"target.x": float("nan")}, "target.x = nan is not allowed: a finite number"),
]


def _refused(fmu: str, cases: list[Any]) -> list[Any]:
    from slave_host import LOG, Host

    seen = []
    for start in cases:
        LOG.clear()
        host = Host(fmu, **{name.replace(".", "__"): value for name, value in start.items()})
        seen.append([host.step(0.01), list(LOG)])
        host.close()
    return seen


def test_bad_settings_are_refused_clearly(fmus: Path) -> None:
    seen = in_fresh_process(_refused, str(fmus / "crane_antisway.fmu"), [case for case, _ in BAD])
    for (case, expected), (status, log) in zip(BAD, seen, strict=True):
        assert status == 2, case
        assert any(expected in line for line in log), (case, log)


# --- the loop ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def moves(fmus: Path) -> dict[tuple[float, str], Table]:
    """1 m with the nonlinear crane, the rope-angle sensor with 0.5 degrees of noise."""
    cases = [(mass, method) for mass in (HEAVY, LIGHT) for method in ("lqr", "zv", "trapezoid")]
    loops = [Setup(payload=mass, method=method).loop(fmus) for mass, method in cases]
    return dict(zip(cases, simulate_all(loops, "moves"), strict=True))


@pytest.mark.parametrize("mass", [HEAVY, LIGHT], ids=PAYLOADS.keys())
@pytest.mark.parametrize("method", ["lqr", "zv"])
def test_residual_sway_is_below_a_tenth_of_the_plain_moves(
    moves: dict[tuple[float, str], Table], mass: float, method: str
) -> None:
    assert measure(moves[mass, method]).residual < 0.1 * measure(moves[mass, "trapezoid"]).residual


@pytest.mark.parametrize("mass", [HEAVY, LIGHT], ids=PAYLOADS.keys())
@pytest.mark.parametrize("method", ["lqr", "zv", "trapezoid"])
def test_limits_hold_and_the_trolley_settles(
    moves: dict[tuple[float, str], Table], mass: float, method: str
) -> None:
    """Open loop to 1e-9 m; in closed loop the trolley moves on with the noise, by millimetres."""
    result = moves[mass, method]
    assert np.abs(result[A_CMD]).max() <= 1.0
    assert np.abs(result[V]).max() <= 0.5
    late = result[result["time"] > 7.0]
    assert np.abs(late[X] - 1.0).max() < (3e-3 if method == "lqr" else 1e-9)
    assert np.abs(late[V]).max() < (0.02 if method == "lqr" else 1e-12)


def test_without_noise_on_the_linear_crane_it_comes_to_rest(fmus: Path) -> None:
    """Two elements seen by two elements: what is left is the filter's and the LQR's tail."""
    setup = Setup(
        plant="crane_lin", noisy=False, stop_time=60.0, more={CRANE: {"chain.elements": 2}}
    )
    (result,) = simulate_all([setup.loop(fmus)], "rest")
    assert abs(result[X][-1] - 1.0) < 1e-6
    assert abs(result[V][-1]) < 1e-6


def test_the_same_seed_gives_the_same_bits(fmus: Path) -> None:
    setup = Setup(stop_time=2.0)
    other = replace(setup, more={OBSERVER: {"sensor.seed": 2}})
    one, again, different = simulate_all([s.loop(fmus) for s in (setup, setup, other)], "seeds")
    assert np.array_equal(one, again)
    assert not np.array_equal(one, different)


@pytest.mark.parametrize("step", [0.01, 0.02])
def test_step_orders_agree_but_for_the_sample_that_is_a_step_newer(fmus: Path, step: float) -> None:
    """Linear plant, no noise, the filter's model exact: a predicted step costs nothing at all."""
    more: dict[str, Any] = {CRANE: {"chain.elements": 2}, OBSERVER: {"sensor.sample_time": step}}
    base = Setup(plant="crane_lin", noisy=False, step=step, stop_time=6.0, more=more)
    setups = [base, replace(base, order="sequential"), replace(base, late=True)]
    parallel, sequential, late = simulate_all([s.loop(fmus) for s in setups], "orders")
    assert np.abs(parallel[A_CMD] - sequential[A_CMD]).max() < 1e-9
    assert np.abs(parallel[A_CMD] - late[A_CMD]).max() > 1e-2


@pytest.mark.parametrize("master", ["ecos", "libcosim"])
def test_other_masters_agree_with_fmpy(fmus: Path, tmp_path: Path, master: str) -> None:
    """The SSP package, every signal to 1e-9 (SI): they differ by the round-off of their clocks."""
    package = {"ecos": "ecospy", "libcosim": "libcosimpy"}[master]
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed: pip install -e '.[importers]'")
    loop = Setup(payload=LIGHT).loop(fmus)
    ssp = write_ssp(tmp_path / "crane_antisway.ssp", loop)
    try:
        theirs, ours = simulate_all([Package(master, ssp, loop), loop], master)
    except UserError as error:
        if "libtbb12" in str(error):
            pytest.skip("ecospy needs the system library libtbb.so.12 (Debian: libtbb12)")
        raise
    assert theirs.dtype.names == ours.dtype.names and len(theirs) == 1201
    for name in ours.dtype.names or ():
        assert np.abs(theirs[name] - ours[name]).max() < 1e-9, name


def test_the_package_is_valid_and_repeatable(fmus: Path, tmp_path: Path) -> None:
    """By FMPy's SSP schema; the same loop gives the same bytes."""
    one = write_ssp(tmp_path / "one" / "crane_antisway.ssp", Setup().loop(fmus))
    two = write_ssp(tmp_path / "two" / "crane_antisway.ssp", Setup().loop(fmus))
    assert one.read_bytes() == two.read_bytes()
    system = read_ssd(str(one)).system
    assert {element.name for element in system.elements} == {CRANE, OBSERVER, ANTISWAY}
    assert len(system.connections) == 10


# --- commands and study ------------------------------------------------------------------------


def chaincrane(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "chaincrane_driver.cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


def test_one_command_runs_the_loop(fmus: Path, tmp_path: Path) -> None:
    done = chaincrane("antisway", "--fmus", fmus, "--out", tmp_path, "--stop", 6, "--elements", 0)
    assert done.returncode == 0, done.stderr
    for text in ("LQR on the estimate", "ZV-shaped", "plain", "residual sway"):
        assert text in done.stdout
    for name in ("antisway.png", "antisway.svg", "fmpy.csv", "crane_antisway.ssp"):
        assert (tmp_path / name).stat().st_size > 1000


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--set", "foo"), "'foo' is not a setting like observer::sensor.delay=0.02"),
        (("--set", "observer::foo=1"), "there is no variable 'foo'"),
        (("--set", "observer::observer.sensor=sonar"), "one of camera, rope"),
        (("--set", "antisway::limit.velocity=0"), "limit.velocity = 0.0 is not allowed"),
        (("--step", "0"), "--step and --stop"),
        (("--master", "ecos", "--order", "sequential"), "step side by side"),
    ],
)
def test_errors_are_one_line(fmus: Path, tmp_path: Path, options: Any, message: str) -> None:
    done = chaincrane("antisway", "--fmus", fmus, "--out", tmp_path, *options)
    assert done.returncode == 2
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("chaincrane: ")]
    assert message in line
    assert "Traceback" not in done.stderr


def table_rows(text: str, first: str) -> list[list[str]]:
    """Rows of the Markdown table whose header begins with ``first``."""
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(f"| {first}"))
    rows = []
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def test_the_study_has_all_its_rows() -> None:
    named = [(case.table, *case.cells) for case in study.cases()]
    assert len(named) == len(set(named)) == 158
    assert {name for name, *_ in named} == set(study.TITLES)


def test_the_summary_is_the_studys_and_the_study_the_fmus(fmus: Path) -> None:
    """docs/observer.md against the study, all rows; the study against the FMUs, four runs of it."""
    document = (ROOT / "docs" / "observer_study.md").read_text()
    summary = (ROOT / "docs" / "observer.md").read_text()
    closed = {tuple(row[:4]): row[4:] for row in table_rows(document, "payload | sensor")}
    seen = 0
    for name, *cells in table_rows(summary, "observer  "):
        places = [(p, s) for p in ("heavy", "light") for s in ("camera", "rope")]
        for (payload, sensor), cell in zip(places, cells, strict=False):
            error, _, _, residual, *_ = closed[payload, sensor, name, "noisy"]
            numbers = [float(text.split()[0]) for text in (error, residual)]
            told = [float(text) for text in re.findall(r"[\d.]+", cell)]
            assert told == pytest.approx(numbers, abs=0.056), (name, cell)
            seen += 1
    assert seen == 20
    chosen = [
        case
        for case in study.cases()
        if case.table == "loop" and case.cells[1] == "rope" and case.cells[3] == "noisy"
        if case.cells[2] in ("2 elements", "pendulum")
    ]
    results = simulate_all([case.loop(fmus) for case in chosen], "study")
    for case, result in zip(chosen, results, strict=True):
        expected = closed[case.cells]
        found = measure(result).cells()
        for one, other in zip(expected[:4], found[:4], strict=True):
            assert float(one.split()[0]) == pytest.approx(float(other.split()[0]), abs=0.02)
