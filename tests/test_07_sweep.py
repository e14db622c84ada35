"""Rung 7, sweeps: what varies, what comes out, and that nothing is lost or doubled.

References: single runs of the same FMU, to the bit, and the same sweep undisturbed.
"""

from __future__ import annotations

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Generator, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from test_07_scenarios import chaincrane, one_line_error

from chaincrane_driver import dataset, journal, scenario, vary
from chaincrane_driver.errors import UserError
from chaincrane_driver.instances import Instances
from chaincrane_driver.subjects import Metric, Outcome, failed
from chaincrane_driver.sweep import Numbered, Scheduler, local, sweep
from chaincrane_driver.vary import Case, Design

HEAVY = ROOT / "scenarios" / "paper_heavy"
POSIX_ONLY = pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX's")


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


# --- what varies --------------------------------------------------------------------------------


def test_ranges_and_values_make_a_grid() -> None:
    design = vary.design(["a=0:1:3", "b=2,5", "c=1:100:3:log", "e=2:10:5"])
    assert design.dimensions == {"a": 3, "b": 2, "c": 3, "e": 5}
    assert len(design) == 90
    assert design.values("a") == (0.0, 0.5, 1.0)
    assert design.values("c") == pytest.approx((1.0, 10.0, 100.0))
    assert design.values("e") == (2, 4, 6, 8, 10) and isinstance(design.values("e")[0], int)
    cases = [case for _, case in design.cases()]
    assert len({tuple(case.values()) for case in cases}) == 90
    assert cases[1] == {"a": 0.0, "b": 2, "c": pytest.approx(1.0), "e": 4}


@pytest.mark.parametrize("method", vary.METHODS)
def test_draws_are_a_seeds_own(method: str) -> None:
    def drawn(seed: int) -> Design:
        return vary.design(["a=uniform(2,3)", "b=normal(5,0.1)"], 64, method, seed)

    one = drawn(3)
    assert one == drawn(3) != drawn(4)
    assert one.dimensions == {"sample": 64}
    a, b = np.array(one.values("a")), np.array(one.values("b"))
    assert a.min() >= 2.0 and a.max() <= 3.0
    # a standard error of the mean of 64 independent draws is 0.036 and 0.0125: four of them
    assert a.mean() == pytest.approx(2.5, abs=0.15)
    assert b.mean() == pytest.approx(5.0, abs=0.05)
    if method != "random":  # one in each 64th: so both fill what they are drawn from
        np.testing.assert_array_equal(np.sort(np.floor(64 * (a - 2.0))), np.arange(64))


def test_each_draw_is_run_at_each_point_of_the_grid() -> None:
    design = vary.design(["n=2,5,10", "m=loguniform(0.01,1)"], 4, "lhs")
    assert design.dimensions == {"n": 3, "sample": 4}
    cases = [case for _, case in design.cases()]
    assert [case["n"] for case in cases] == [2] * 4 + [5] * 4 + [10] * 4
    assert [case["m"] for case in cases[:4]] == [case["m"] for case in cases[4:8]]


@pytest.mark.parametrize(
    ("varied", "more", "message"),
    [
        ([], {}, "nothing varies"),
        (["payload.mass"], {}, "is not like payload.mass=0.05:0.5:50"),
        (["a=1:2"], {}, "a range is FIRST:LAST:COUNT"),
        (["a=1:x:3"], {}, "'x' is not a finite number"),
        (["a=1:1:3"], {}, "needs two ends and a count of 2 or more"),
        (["a=1:2:1.5"], {}, "a count of 2 or more"),
        (["a=-1:2:3:log"], {}, "needs ends above 0"),
        (["a=1,2,1"], {}, "has a value twice"),
        (["a=1,2", "a=3,4"], {}, "a is varied twice"),
        (["a=triangle(1,2)"], {"samples": 3}, "triangle is none of uniform, loguniform, normal"),
        (["a=uniform(2,1)"], {"samples": 3}, "the first limit must be below the second"),
        (["a=normal(2,0)"], {"samples": 3}, "the standard deviation must be above 0"),
        (["a=loguniform(0,1)"], {"samples": 3}, "limits must be above 0"),
        (["a=uniform(1,2)"], {}, "random variables need --samples"),
        (["a=1,2"], {"samples": 3}, "--samples is for random variables"),
        (["a=uniform(1,2)"], {"cases": Path("x.csv")}, "--cases takes the place of random"),
        ([], {"cases": Path("none.csv")}, "none.csv: cannot be read"),
    ],
)
def test_wrong_grammar_is_told(varied: list[str], more: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError) as error:
        vary.design(varied, **more)
    assert message in str(error.value)


def test_cases_come_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "cases.csv"
    file.write_text("payload.mass, solver.scheme\n0.1,newmark\n0.2,energy_momentum\n")
    design = vary.design(["chain.elements=2,5"], cases=file)
    assert design.dimensions == {"chain.elements": 2, "case": 2}
    assert design.case(3) == {
        "chain.elements": 5,
        "payload.mass": 0.2,
        "solver.scheme": "energy_momentum",
    }
    file.write_text("a,b\n1\n")
    with pytest.raises(UserError, match="row 2: 1 values for 2 columns"):
        vary.design([], cases=file)


# --- what comes out -----------------------------------------------------------------------------


def test_a_sweep_is_its_single_runs(native_fmus: Path, tmp_path: Path) -> None:
    """Metrics and series of each case, to the bit; a case that is refused is a row that says so."""
    xarray = pytest.importorskip("xarray")
    fmu = native_fmus / "crane_nl_native.fmu"
    done = chaincrane(
        *("sweep", HEAVY, "--run", "nonlinear", "--fmu", fmu, "--out", tmp_path),
        *("--vary", "payload.mass=-0.1,0.1,0.3", "--vary", "chain.elements=2,10"),
        *("--keep", "payload.x,trolley.fx", "--signals", "payload.vx"),
    )
    assert done.returncode == 0, done.stderr
    assert "4 of 6 runs done, 2 failed, the first: payload.mass = -0.1 is not" in done.stdout
    one = scenario.load(HEAVY)
    job, instances = one.job(one.runs[0], fmu), Instances()
    with xarray.open_dataset(tmp_path / "sweep.nc", engine="h5netcdf") as found:
        assert dict(found.sizes) == {"payload.mass": 3, "chain.elements": 2, "run": 1, "time": 801}
        assert found["payload.x"].attrs["units"] == "m"
        assert found["payload.vx.peak"].attrs["units"] == "m/s"
        for mass in (0.1, 0.3):
            for elements in (2, 10):
                start = {**job.start_values, "payload.mass": mass, "chain.elements": elements}
                table = replace(job, start_values=start).run(instances)
                at = found.sel({"payload.mass": mass, "chain.elements": elements}).isel(run=0)
                for name in ("payload.x", "trolley.fx", "time"):
                    np.testing.assert_array_equal(at[name], table[name])
                assert at["payload.x_rel.peak"] == np.abs(table["payload.x_rel"]).max()
                assert at["payload.x_rel.last"] == table["payload.x_rel"][-1]
                assert at["payload.vx.rms"] == np.sqrt(np.mean(table["payload.vx"] ** 2))
                assert at["message"] == ""
        refused = found.sel({"payload.mass": -0.1})
        assert np.isnan(refused["payload.x"]).all()
        assert all("not allowed" in str(text) for text in refused["message"].values.flat)
        table_rows = rows_of(tmp_path / "sweep.csv")
        assert [float(row["payload.x_rel.peak"] or "nan") for row in table_rows] == pytest.approx(
            found["payload.x_rel.peak"].values.ravel().tolist(), rel=0, abs=0, nan_ok=True
        )
    assert (tmp_path / "sweep.svg").stat().st_size > 10_000


def test_a_comparison_has_its_differences(native_fmus: Path, tmp_path: Path) -> None:
    """Of the linear run to the nonlinear one; the first has none to itself."""
    copy = tmp_path / "paper"
    shutil.copytree(HEAVY, copy)
    text = (copy / "scenario.toml").read_text()
    text = text.replace("crane_nl.fmu", "crane_nl_native.fmu")
    (copy / "scenario.toml").write_text(text.replace("crane_lin.fmu", "crane_lin_native.fmu"))
    done = chaincrane(
        *("sweep", copy, "--run", "nonlinear", "--run", "linear_10", "--fmus", native_fmus),
        *("--vary", "payload.mass=uniform(0.1,0.4)", "--vary", "gravity=uniform(9,10)"),
        *("--samples", 4, "--method", "sobol", "--out", tmp_path / "out"),
    )
    assert done.returncode == 0, done.stderr
    first, second = rows_of(tmp_path / "out" / "sweep.csv")[:2]
    one, instances = scenario.load(copy), Instances()
    start = {name: float(first[name]) for name in ("payload.mass", "gravity")}
    tables = []
    for run in one.runs[:2]:
        job = one.job(run, native_fmus / run.fmu)
        tables.append(replace(job, start_values={**job.start_values, **start}).run(instances))
    gap = tables[1]["payload.x_rel"] - tables[0]["payload.x_rel"]
    assert float(second["payload.x_rel.difference_largest"]) == np.abs(gap).max()
    assert first["payload.x_rel.difference_largest"] == ""


def test_the_closed_loop_is_swept(fmus: Path, tmp_path: Path) -> None:
    """In its own words and in its parts' start values: as chaincrane antisway runs it."""
    from chaincrane_driver.antisway import Setup, measure

    done = chaincrane(
        *("sweep", "antisway", "--fmus", fmus, "--out", tmp_path),
        *("--vary", "sensor=rope,camera", "--vary", "observer::rope.noise=0.0,0.002"),
        *("--vary", "stop=6", "--vary", "elements=1"),
    )
    assert done.returncode == 0, done.stderr
    rows = rows_of(tmp_path / "sweep.csv")
    assert len(rows) == 4
    more = {"observer": {"rope.noise": 0.002}}
    setup = Setup(sensor="rope", stop_time=6.0, observer=1, more=more)
    own = measure(setup.loop(fmus).run(Instances()))
    (row,) = [r for r in rows if (r["sensor"], r["observer::rope.noise"]) == ("rope", "0.002")]
    assert float(row["residual"]) == own.residual
    assert float(row["payload_rms"]) == own.payload_rms


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--vary", "payload.mas=1,2"), ["no variable 'payload.mas'", "'payload.mass'"]),
        (("--vary", "payload.x=1,2"), ["payload.x is an output"]),
        (("--vary", "chain.elements=1:2:3"), ["chain.elements = 1.0", "a whole number"]),
        (("--vary", "payload.mass=heavy,light"), ["payload.mass = 'heavy'"]),
        (("--vary", "payload.mass=1,2", "--keep", "payload.z"), ["no Real output 'payload.z'"]),
        (("--vary", "payload.mass=1,2", "--draw", "peak"), ["--draw: there is no metric 'peak'"]),
        (("--vary", "payload.mass=1,2", "--run", "non"), ["there is no run 'non'"]),
        (("--vary", "payload.mass=1,2", "--set", "crane::a=1"), ["--set is for the closed loop"]),
        (("--vary", "payload.mass=1,2", "--processes", "0"), ["--processes 0 is not allowed"]),
    ],
)
def test_errors_are_one_clear_line(
    fmus: Path, tmp_path: Path, options: tuple[str, ...], parts: list[str]
) -> None:
    one_line_error(["sweep", HEAVY, "--fmus", fmus, "--out", tmp_path, *options], *parts)


# --- nothing lost, nothing doubled --------------------------------------------------------------


@dataclass(frozen=True)
class Squares:
    """A subject without an FMU: the square of x. Some x fail, kill their worker, or take time."""

    fails: frozenset[float] = frozenset()
    kills: frozenset[float] = frozenset()
    lasts: float = 0.0  # s
    marker: Path | None = None  # a worker is killed once for all cases, and leaves this
    tells: Path | None = None  # folder where a file says that x = 60 is run
    runs: tuple[str, ...] = ("square",)
    kept: tuple[str, ...] = ("thrice",)
    drawn: tuple[str, ...] = ("square",)
    units: Mapping[str, str] = field(default_factory=dict)
    fmus: Mapping[str, Path] = field(default_factory=dict)

    @property
    def metrics(self) -> tuple[Metric, ...]:
        return (Metric("square", "", "x times x"),)

    def check(self, design: Design) -> None:
        assert design.names == ("x",)

    def times(self) -> np.ndarray:
        return np.arange(3.0)

    def run(self, case: Case, instances: Instances) -> Outcome:
        x = case["x"]
        time.sleep(self.lasts)
        if x == 60 and self.tells:
            (self.tells / "at 60").touch()
        if x in self.kills and not (self.marker and self.marker.exists()):
            if self.marker:
                self.marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if x in self.fails:
            return failed(self, [f"{x} is refused"])
        return Outcome(np.array([[x * x]]), x * np.ones((1, 1, 3)), ("",))

    def with_fmus(self, fmus: Mapping[str, Path]) -> Squares:
        return self

    def fingerprint(self) -> dict[str, str]:
        return {"squares": "1"}


def counting(
    done: list[int], stop_after: int | None = None, error: BaseException | None = None
) -> Scheduler:
    """A scheduler in this process that notes which cases it was given, and may be stopped."""

    def schedule(
        subject: Any, cases: Iterable[Numbered]
    ) -> Generator[tuple[int, Outcome], None, None]:
        for place, (number, case) in enumerate(cases):
            if place == stop_after and error is not None:
                raise error
            done.append(number)
            yield number, subject.run(case, Instances())

    return schedule


DESIGN = vary.design(["x=0:99:100"])


def squares(path: Path) -> list[float]:
    return [float(row["square"] or "nan") for row in rows_of(path / "sweep.csv")]


def test_a_sweep_goes_on_where_ctrl_c_stopped_it(tmp_path: Path) -> None:
    given: list[int] = []
    stop = counting(given, 30, KeyboardInterrupt())
    with pytest.raises(UserError, match=r"stopped: 30 of 100 cases are kept in .*goes on"):
        sweep(Squares(), DESIGN, tmp_path, stop)
    assert not (tmp_path / "sweep.csv").exists()
    sweep(Squares(), DESIGN, tmp_path, counting(given))
    assert given == list(range(100))  # each once
    assert squares(tmp_path) == [float(x * x) for x in range(100)]
    assert not (tmp_path / journal.FILE).exists()
    sweep(Squares(), DESIGN, tmp_path, counting(given))
    assert len(given) == 100  # all is there: nothing is run


def test_what_is_done_is_kept_where_a_scheduler_fails(tmp_path: Path) -> None:
    given: list[int] = []
    with pytest.raises(UserError, match="the cluster is gone"):
        sweep(Squares(), DESIGN, tmp_path, counting(given, 7, UserError("the cluster is gone")))
    sweep(Squares(), DESIGN, tmp_path, counting(given))
    assert given == list(range(100))


def test_another_sweeps_results_are_never_mixed_in(tmp_path: Path) -> None:
    """Of another FMU, another design: half done or whole; --anew discards them."""
    fmu = tmp_path / "a.fmu"
    fmu.write_text("one build")
    subject, out = Squares(fmus={"a.fmu": fmu}), tmp_path / "out"
    with pytest.raises(UserError, match="stopped"):
        sweep(subject, DESIGN, out, counting([], 30, KeyboardInterrupt()))
    for whole in (False, True):
        fmu.write_text("another build")
        with pytest.raises(UserError, match=r"another sweep: a\.fmu changed; give another --out"):
            sweep(subject, DESIGN, out, counting([]))
        fmu.write_text("one build")
        with pytest.raises(UserError, match="another sweep: what varies changed"):
            sweep(subject, vary.design(["x=0:99:50"]), out, counting([]))
        if not whole:
            sweep(subject, DESIGN, out, counting([]))
    given: list[int] = []
    fmu.write_text("another build")
    sweep(subject, DESIGN, out, counting(given), anew=True)
    assert len(given) == 100


def test_an_fmu_that_is_built_anew_meanwhile_is_not_run(tmp_path: Path) -> None:
    """Workers have the file that the sweep began with."""
    fmu = tmp_path / "a.fmu"
    fmu.write_text("one build")
    seen: list[str] = []

    @dataclass(frozen=True)
    class Reads(Squares):
        def run(self, case: Case, instances: Instances) -> Outcome:
            fmu.write_text("another build")
            seen.append(self.fmus["a.fmu"].read_text())
            return super().run(case, instances)

        def with_fmus(self, fmus: Mapping[str, Path]) -> Squares:
            return replace(self, fmus=fmus)

    sweep(Reads(fmus={"a.fmu": fmu}), DESIGN, tmp_path / "out", counting([]))
    assert seen == ["one build"] * 100


def test_two_sweeps_into_one_folder(tmp_path: Path) -> None:
    """The second is refused while the first runs; then it finds all done."""

    def meanwhile(subject: Any, cases: Any) -> Generator[tuple[int, Outcome], None, None]:
        for anew in (False, True):
            with pytest.raises(UserError, match="another sweep is writing into this folder"):
                sweep(Squares(), DESIGN, tmp_path, counting([]), anew)
        yield from counting([])(subject, cases)

    sweep(Squares(), DESIGN, tmp_path, meanwhile)
    assert squares(tmp_path) == [float(x * x) for x in range(100)]


@POSIX_ONLY
def test_a_worker_that_is_killed_loses_nothing(tmp_path: Path) -> None:
    subject = Squares(kills=frozenset({40}), marker=tmp_path / "killed")
    sweep(subject, DESIGN, tmp_path / "out", local(2))
    assert subject.marker is not None and subject.marker.exists()
    assert squares(tmp_path / "out") == [float(x * x) for x in range(100)]


@POSIX_ONLY
def test_cases_that_fail_or_kill_are_rows(tmp_path: Path) -> None:
    subject = Squares(fails=frozenset({3}), kills=frozenset({50, 51}))
    sweep(subject, DESIGN, tmp_path, local(2))
    rows = rows_of(tmp_path / "sweep.csv")
    messages = {int(row["x"]): row["message"] for row in rows if row["message"]}
    assert messages == {
        3: "3 is refused",
        50: "x = 50: the FMU crashed, exit code -9",
        51: "x = 51: the FMU crashed, exit code -9",
    }
    expected = [np.nan if x in (3, 50, 51) else float(x * x) for x in range(100)]
    np.testing.assert_array_equal(squares(tmp_path), expected)


SCRIPT = """
import resource, sys
from pathlib import Path
sys.path[:0] = [{tests!r}]
from chaincrane_driver.cli import main
import chaincrane_driver.sweep_command as command
from chaincrane_driver import vary
from chaincrane_driver.sweep import local, sweep
from test_07_sweep import DESIGN, Squares
def run(options):
    print("begins", flush=True)
    sweep(Squares(lasts={lasts}, tells=Path({out!r})), DESIGN, Path({out!r}), local(1))
    return 0
{before}
import argparse
command_line = argparse.Namespace(action=run)
import chaincrane_driver.cli as cli
cli.parser = lambda asked: argparse.Namespace(parse_args=lambda arguments: command_line)
sys.exit(cli.main([]))
"""


def in_process(out: Path, lasts: float = 0.0, before: str = "") -> subprocess.Popen[str]:
    """A sweep as the command line runs it, in a process of its own."""
    tests = str(Path(__file__).parent)
    script = SCRIPT.format(tests=tests, out=str(out), lasts=lasts, before=before)
    return subprocess.Popen(
        [sys.executable, "-c", script], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def wait_for(file: Path) -> None:
    """Until there is such a file."""
    for _ in range(3000):
        if file.exists():
            return
        time.sleep(0.02)
    raise AssertionError(f"{file} is not written")


@POSIX_ONLY
@pytest.mark.parametrize("with_signal", [signal.SIGINT, signal.SIGKILL], ids=lambda s: s.name)
def test_a_sweep_that_is_stopped_by_a_signal_goes_on(tmp_path: Path, with_signal: int) -> None:
    """Killed in the middle it has kept what it had saved; each case is there once."""
    process = in_process(tmp_path, lasts=0.03)
    wait_for(tmp_path / "at 60")  # that is after 1.8 s: some has been saved by then
    process.send_signal(with_signal)
    _, errors = process.communicate(timeout=60)
    if with_signal == signal.SIGINT:
        assert process.returncode == 2
        (line,) = errors.strip().splitlines()
        assert line.startswith("chaincrane: stopped: ") and "of 100 cases are kept" in line
    else:
        assert process.returncode == -signal.SIGKILL
    given: list[int] = []
    sweep(Squares(), DESIGN, tmp_path, counting(given))
    assert 0 < len(given) < 100
    assert squares(tmp_path) == [float(x * x) for x in range(100)]


@POSIX_ONLY
def test_a_full_disk_is_one_line_and_loses_nothing(tmp_path: Path) -> None:
    """No file may grow beyond 30 kB: the journal, then the dataset do not fit; then they do."""
    limit = "import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
    limit += "resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, resource.RLIM_INFINITY))"
    process = in_process(tmp_path, lasts=0.02, before=limit)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    (line,) = errors.strip().splitlines()
    assert line.startswith("chaincrane: ") and journal.FILE in line
    sweep(Squares(), DESIGN, tmp_path, counting([]))
    assert squares(tmp_path) == [float(x * x) for x in range(100)]


def test_a_journal_that_is_full_says_so(tmp_path: Path) -> None:
    """SQLite's own limit, as it meets a full disk."""
    book = journal.Journal(tmp_path, {})
    outcome = Squares().run({"x": 2}, Instances())
    book.add([(0, outcome)])
    pages = book._base.execute("PRAGMA page_count").fetchone()[0]
    book._base.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(UserError, match=r"sweep\.partial: database or disk is full"):
        book.add([(number, outcome) for number in range(1, 1000)])
    assert book.done(1000).sum() == 1  # all or none
    book.close()


def test_files_that_cannot_be_written_leave_the_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that is full at the end costs no run."""
    pytest.importorskip("h5netcdf")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(dataset, "write_series", full)
        with pytest.raises(UserError, match=r"sweep\.nc: cannot be written: No space left"):
            sweep(Squares(), DESIGN, tmp_path, counting([]))
    assert not (tmp_path / "sweep.nc").exists()
    given: list[int] = []
    sweep(Squares(), DESIGN, tmp_path, counting(given))
    assert given == [] and squares(tmp_path)[-1] == 99.0**2
