"""Rung 7, fits: what was put in comes out, with the errors that theory has.

References: the values that the data were made with; for a bias alone, the mean and its error.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from test_07_scenarios import chaincrane, one_line_error

from chaincrane_driver import fit, scenario
from chaincrane_driver.instances import Instances
from chaincrane_driver.simulate import Job

HEAVY = ROOT / "scenarios" / "paper_heavy"
TRUE = {"payload.mass": 0.3, "chain.length": 0.75, "damping.air": 0.08}
SHIFT, BIAS, NOISE, QUANTUM, LOST = 0.013, 0.004, 0.003, 0.001, 0.1  # s, m, m, m, of all samples
SIGNAL = "payload.x_rel"


def heavy(fmu: Path) -> Job:
    one = scenario.load(HEAVY)
    return one.job(one.runs[0], fmu)


def measured(fmu: Path, seed: int, true: dict[str, float] = TRUE) -> fit.Measured:
    """A camera at 50 Hz: late, biased, noisy, in steps of 1 mm, a tenth of its samples lost."""
    job = heavy(fmu)
    start = {**job.start_values, **true}
    table = replace(job, start_values=start, outputs=(SIGNAL,)).run(Instances())
    random, times = np.random.default_rng(seed), np.arange(0.0, 4.0, 0.02)
    values = np.interp(times - SHIFT, table["time"], table[SIGNAL]) + BIAS
    values = np.round((values + random.normal(0.0, NOISE, len(times))) / QUANTUM) * QUANTUM
    values[random.random(len(times)) < LOST] = np.nan
    return fit.Measured(times, {SIGNAL: values})


def test_values_come_back_from_starts_wrong_by_two(native_fmus: Path, tmp_path: Path) -> None:
    """By the command: each within three standard errors (of five, one in 80 fits is farther)."""
    fmu = native_fmus / "crane_nl_native.fmu"
    data = measured(fmu, seed=1)
    file = tmp_path / "camera.csv"
    rows = zip(data.times, data.signals[SIGNAL], strict=True)
    lines = [f"{time:.6g},{'' if np.isnan(x) else f'{x:.6g}'}" for time, x in rows]
    file.write_text("\n".join([f"time,{SIGNAL}", *lines]) + "\n")
    done = chaincrane(
        *("fit", HEAVY, file, "--fmu", fmu, "--shift", "--bias", "--out", tmp_path / "out"),
        *("--fit", "payload.mass=0.6", "--fit", "chain.length=0.4", "--fit", "damping.air=0.16"),
    )
    assert done.returncode == 0, done.stderr
    assert "note:" not in done.stdout
    found = {}
    for line in (tmp_path / "out" / "fit.csv").read_text().splitlines()[1:]:
        name, _, *numbers = line.split(",")
        found[name] = [float(number) for number in numbers]
    for name, true in {**TRUE, fit.SHIFT: SHIFT, f"{fit.BIAS}{SIGNAL}": BIAS}.items():
        value, error = found[name]
        assert abs(value - true) < 3.0 * error, name
        assert 0.0 < error < 0.2 * true, name
    assert (tmp_path / "out" / "fit.svg").stat().st_size > 10_000


def test_a_bias_alone_is_the_mean_with_its_error(native_fmus: Path) -> None:
    """Analytic: the mean of the residual, and its standard deviation over the root of its count."""
    job = heavy(native_fmus / "crane_nl_native.fmu")
    data = measured(job.fmu, seed=2, true={})
    asked = fit.parameters(job, data, [], shift=False, bias=True)
    found = fit.fit(job, data, asked)
    table = job.run(Instances())
    gap = data.signals[SIGNAL] - np.interp(data.times, table["time"], table[SIGNAL])
    there = np.isfinite(gap)
    assert found.values[0] == pytest.approx(gap[there].mean(), rel=1e-6)
    expected = gap[there].std(ddof=1) / np.sqrt(there.sum())
    assert found.errors[0] == pytest.approx(expected, rel=1e-6)


def test_what_data_cannot_tell_apart_is_said(native_fmus: Path) -> None:
    """Sway depends on gravity over length, nearly: only their ratio is measured."""
    job = heavy(native_fmus / "crane_nl_native.fmu")
    data = measured(job.fmu, seed=3, true={})
    asked = fit.parameters(job, data, ["chain.length", "gravity"], shift=False, bias=True)
    found = fit.fit(job, data, asked)
    notes = " ".join(found.warnings())
    assert "cannot tell chain.length and gravity apart: correlation 0.99" in notes
    assert found.values[0] / found.values[1] == pytest.approx(0.8 / 9.81, rel=0.01)


def test_a_model_that_is_not_the_cranes_is_said(native_fmus: Path) -> None:
    """The data's chain is shorter; only a bias is fitted."""
    job = heavy(native_fmus / "crane_nl_native.fmu")
    data = measured(job.fmu, seed=4, true={"chain.length": 0.7})
    asked = fit.parameters(job, data, [], shift=False, bias=True)
    notes = " ".join(fit.fit(job, data, asked).warnings())
    assert f"the residual of {SIGNAL} is no white noise" in notes


@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        ("t,payload.x\n0,1\n", [], "the header needs 'time' first"),
        ("time,payload.x\n0,1,2\n", [], "row 2: 3 values for 2 columns"),
        ("time,payload.x\n0,one\n", [], "row 2, payload.x: 'one' is not a number"),
        ("time,payload.x\n1,1\n0,1\n", [], "times must be finite and not go backwards"),
        ("time,payload.z\n0,1\n", ["--bias"], "there is no output 'payload.z'"),
        ("time,payload.x\n0,1\n1,1\n", [], "nothing to fit"),
        ("time,payload.x\n0,1\n1,\n", ["--bias"], "too few measured values for 1 parameters"),
        ("time,payload.x\n0,1\n", ["--fit", "mass"], "no Real parameter is 'mass'"),
        ("time,payload.x\n0,1\n", ["--fit", "payload.mass=x"], "'x' is not a finite number"),
        ("time,payload.x\n0,1\n", ["--fit", "payload.mass=-1"], "is not allowed: above 0"),
        ("time,payload.x\n0,1\n9,1\n", ["--bias"], "within the scenario's 0 to 4 s"),
        ("time,payload.x\n0,1\n", ["--run", "non", "--bias"], "there is no run 'non'"),
    ],
)
def test_errors_are_one_clear_line(
    native_fmus: Path, tmp_path: Path, content: str, options: list[object], message: str
) -> None:
    file = tmp_path / "measured.csv"
    file.write_text(content)
    fmu = native_fmus / "crane_nl_native.fmu"
    one_line_error(["fit", HEAVY, file, "--fmu", fmu, "--out", tmp_path, *options], message)
