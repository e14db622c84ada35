"""Rung 7, time and mesh errors from FMU runs. References: sequences of known order and error."""

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from test_07_scenarios import chaincrane, one_line_error

from chaincrane_driver.converge import (
    Estimate,
    Values,
    estimate,
    internal_step,
    lost_at,
    number,
    observed_order,
)

PUSH = ROOT / "scenarios" / "payload_push"
TIME = np.linspace(0.0, 4.0, 801)
SWAY = np.sin(3.6 * TIME)


def of_order(order: float, error: float) -> Estimate:
    """The estimate for a sequence whose first run is off by ``error`` sin(5 t), exactly."""
    runs = [SWAY + error * 0.5 ** (order * halvings) * np.sin(5 * TIME) for halvings in range(3)]
    return estimate(TIME, runs, scale=1.0)


# --- Richardson ---------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0, 4.0])
def test_a_known_order_and_error_are_found(order: float) -> None:
    found = of_order(order, 0.03)
    assert found.order == pytest.approx(order, abs=1e-9)
    assert found.trusted and not found.exact
    assert found.lost_at is None
    np.testing.assert_allclose(found.local, 0.03 * np.abs(np.sin(5 * TIME)), atol=1e-12)
    assert found.largest == pytest.approx(0.03, rel=1e-3)
    assert found.rms == pytest.approx(0.03 * np.sqrt(np.mean(np.sin(5 * TIME) ** 2)))
    assert found.running[-1] == found.largest
    assert (np.diff(found.running) >= 0.0).all()


@pytest.mark.parametrize("order", [0.6, 6.0])
def test_an_order_that_is_not_plausible_is_not_extrapolated(order: float) -> None:
    found = of_order(order, 0.03)
    assert found.order == pytest.approx(order, abs=1e-9)
    assert not found.trusted
    assert found.rms == pytest.approx(found.first[1] + found.second[1])  # to the finest run


def test_two_orders_at_once_are_within_a_factor_of_two() -> None:
    shape = np.sin(5 * TIME)
    runs = [SWAY + 0.01 * (h + 2 * h**2) * shape for h in (1.0, 0.5, 0.25)]
    found = estimate(TIME, runs, scale=1.0)
    assert 1.0 < found.order < 2.0
    assert 0.5 < found.largest / 0.03 < 2.0


def test_runs_that_are_the_same_are_exact() -> None:
    noise = 1e-14 * np.cos(1e3 * TIME)
    found = estimate(TIME, [SWAY, SWAY + noise, SWAY - noise], scale=1.0)
    assert found.exact and not found.trusted
    assert np.isnan(found.order)
    assert found.lost_at is None


def chaotic(smallest: float) -> list[Values]:
    """Three runs of order 2 whose phases part by a factor of e^10 each second."""
    phases = [smallest * 0.25**halvings * np.exp(10 * TIME) for halvings in range(3)]
    return [np.sin(3.6 * TIME + phase) for phase in phases]


def test_chaos_is_told_with_its_time() -> None:
    """The second difference is as large as the first once its phase, 1e-9 e^(10 t), is."""
    found = estimate(TIME, chaotic(1e-9), scale=1.0)
    assert found.lost_at is not None
    assert 2.0 < found.lost_at < 2.5
    assert not found.trusted
    assert found.largest > 1.0
    assert found.running[300] < 0.02  # at 1.5 s it is still small


def test_chaos_that_has_not_shown_yet_is_no_chaos() -> None:
    assert estimate(TIME, chaotic(1e-20), scale=1.0).lost_at is None


@pytest.mark.parametrize(("scale", "lost"), [(1.0, None), (0.1, 0.0)])
def test_what_does_not_shrink_but_is_small_is_predictable(scale: float, lost: float | None) -> None:
    difference = np.full(len(TIME), 0.005)
    assert lost_at(TIME, difference, difference, scale) == lost


def test_what_shrinks_but_is_large_is_not_predictable() -> None:
    growing = 0.1 * TIME
    assert lost_at(TIME, growing, 0.25 * growing, scale=1.0) == pytest.approx(2.0, abs=0.01)


def test_order_of_differences() -> None:
    assert observed_order(4.0, 1.0) == 2.0
    assert observed_order(1.0, 2.0) == -1.0
    assert observed_order(1.0, 0.0) == float("inf")
    assert observed_order(0.0, 1.0) == -float("inf")


def test_the_internal_step_divides_a_communication_step() -> None:
    """As the FMU does it: a ratio that is whole but for round-off is whole."""
    assert internal_step(0.005, 0.001) == pytest.approx(0.001)
    assert internal_step(0.005, 0.0015) == pytest.approx(0.00125)
    assert internal_step(0.013, 0.001) == pytest.approx(0.001)
    assert internal_step(0.005, 0.02) == pytest.approx(0.005)


def test_numbers_are_shown_with_their_leading_digits() -> None:
    shown = [number(value, 2) for value in (0.0, 1.234, 0.01234, 1234.0, -0.5, 1.234e-6)]
    assert shown == ["0", "1.2", "0.012", "1200", "-0.5", "1.2e-06"]


# --- the command --------------------------------------------------------------------------------


def short_push(tmp_path: Path, old: str = "", new: str = "") -> Path:
    """A copy of payload_push that ends at 0.5 s, without its last two runs, one thing replaced."""
    copy = tmp_path / "payload_push"
    shutil.copytree(PUSH, copy, ignore=shutil.ignore_patterns("reference*"))
    text = (PUSH / "scenario.toml").read_text().replace("stop_time = 4.0", "stop_time = 0.5")
    text = text[: text.index('[[run]]\nname = "linear_2"')]
    assert old in text
    (copy / "scenario.toml").write_text(text.replace(old, new, 1))
    return copy


def test_converge_prints_tables_and_writes_files(fmus: Path, tmp_path: Path) -> None:
    done = chaincrane("converge", short_push(tmp_path), "--fmus", fmus, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "nonlinear, 10 elements; steps of 1, 0.5, 0.25 ms; 10, 20, 40 elements" in done.stdout
    assert "| payload.x_rel     | " in done.stdout
    assert "| chain.top_angle   | " in done.stdout
    folder = tmp_path / "out" / "payload_push"
    assert (folder / "convergence.svg").stat().st_size > 10_000
    assert (folder / "convergence.png").stat().st_size > 10_000
    with (folder / "convergence.csv").open(newline="") as file:
        rows = {(row["run"], row["signal"]): row for row in csv.DictReader(file)}
    assert len(rows) == 14
    for (run, _), row in rows.items():
        if run == "linear_10":
            assert row["time_exact"] == "yes"
    sway = rows["nonlinear", "payload.x_rel"]
    assert float(sway["time_order_of_rms"]) == pytest.approx(2.0, abs=0.1)
    assert float(sway["mesh_order_of_rms"]) == pytest.approx(2.0, abs=0.3)
    assert 0.0 < float(sway["time_error_largest"]) < float(sway["mesh_error_largest"]) < 1e-3


@pytest.mark.parametrize(
    ("old", "new", "options", "parts"),
    [
        ("", "", ["--run", "linear"], ["no run 'linear'", "the nearest is 'nonlinear'"]),
        ("", "", ["--signals", "payload.z"], ["crane_nl.fmu", "no Real output 'payload.z'"]),
        ("", "", ["--signals", "solver.steps"], ["no Real output 'solver.steps'"]),
        ("crane_nl", "crane_observer", [], ["crane_observer.fmu", "has no 'solver.max_step'"]),
        ('"initial.speed" = 0.0', '"solver.max_step" = "x"', [], ["solver.max_step = 'x'"]),
        (
            '"initial.speed" = 0.0',
            '"chain.EA" = 1e12',  # allowed with 20 elements, not with 40
            ["--run", "nonlinear"],
            [
                "payload_push, nonlinear, 10 elements, chain.elements = 40: ",
                "chain.EA",
                "is not allowed",
            ],
        ),
    ],
)
def test_errors_are_one_clear_line(
    fmus: Path, tmp_path: Path, old: str, new: str, options: list[str], parts: list[str]
) -> None:
    folder = short_push(tmp_path, old, new)
    one_line_error(["converge", folder, "--fmus", fmus, "--out", tmp_path, *options], *parts)


def test_help_has_an_example() -> None:
    done = chaincrane("converge", "--help")
    assert done.returncode == 0
    assert "example: chaincrane converge paper_heavy" in done.stdout
