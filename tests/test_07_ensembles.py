"""Rung 7, many runs: kept FMUs, workers, the stepper. References: FMPy's own loop, to the bit."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from fmpy import simulate_fmu

from chaincrane_driver import scenario, stepper
from chaincrane_driver.antisway import Setup
from chaincrane_driver.errors import UserError
from chaincrane_driver.grid import all_inputs
from chaincrane_driver.instances import Instances
from chaincrane_driver.loop import Series
from chaincrane_driver.processes import Failure, Workers, early_workers, workers_for
from chaincrane_driver.progress import Progress
from chaincrane_driver.simulate import Job

SCENARIOS = ROOT / "scenarios"
INPUTS = ("trolley.v_cmd", "trolley.a_cmd", "payload.fx")
HOST_ONLY = pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX's")


@pytest.fixture(scope="module")
def instances() -> Instances:
    return Instances()


@pytest.fixture(params=["C", "Python"])
def loop(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Both loops over communication steps."""
    if request.param == "Python":
        monkeypatch.setenv(stepper.NOT_COMPILED, "1")
    stepper.library.cache_clear()
    assert (stepper.library() is None) == (request.param == "Python")
    yield request.param
    stepper.library.cache_clear()


def job_of(name: str, fmu: Path) -> Job:
    one = scenario.load(SCENARIOS / name)
    return one.job(one.runs[0], fmu)


def short(job: Job, stop_time: float = 0.1) -> Job:
    return replace(job, stop_time=stop_time)


def test_a_process_that_runs_fmus_leaves_no_folder(fmus: Path, tmp_path: Path) -> None:
    """Its own, without a worker: what was unpacked goes at its end, whatever that is."""
    code = "import sys\nfrom chaincrane_driver.instances import Instances\n"
    code += f"Instances().get(__import__('pathlib').Path({str(fmus / 'crane_lin.fmu')!r}))\n"
    for end in ("", "raise KeyboardInterrupt"):
        environment = {**os.environ, "TMPDIR": str(tmp_path)}
        subprocess.run([sys.executable, "-c", code + end], env=environment, capture_output=True)
        assert not list(tmp_path.iterdir())


# --- one run ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["paper_heavy", "smooth_travel", "payload_push"])
def test_a_run_is_fmpys_to_the_bit(
    native_fmus: Path, instances: Instances, loop: str, name: str
) -> None:
    """Columns, their order and types, times and every value; the second time after a reset."""
    job = job_of(name, native_fmus / "crane_nl_native.fmu")
    fmpys = simulate_fmu(
        str(job.fmu),
        start_values=dict(job.start_values),
        input=all_inputs(INPUTS, job.inputs, dict.fromkeys(INPUTS, 0.0)),
        stop_time=job.stop_time,
        output_interval=job.output_interval,
    )
    for _ in range(2):
        ours = job.run(instances)
        assert ours.dtype == fmpys.dtype
        assert ours.tobytes() == np.asarray(fmpys).tobytes()


def test_a_jump_between_output_points_is_stepped_to(
    native_fmus: Path, instances: Instances, loop: str
) -> None:
    """As FMPy does; a stop time that is no multiple of the interval, too."""
    job = short(job_of("paper_heavy", native_fmus / "crane_nl_native.fmu"), 0.0377)
    assert job.inputs is not None
    inputs = job.inputs.copy()
    inputs["time"] = 0.0, 0.0123, 0.0123, 0.05
    fmpys = simulate_fmu(
        str(job.fmu),
        start_values=dict(job.start_values),
        input=all_inputs(INPUTS, inputs, dict.fromkeys(INPUTS, 0.0)),
        stop_time=job.stop_time,
        output_interval=job.output_interval,
    )
    ours = replace(job, inputs=inputs).run(instances)
    assert 0.0123 in ours["time"] and ours["time"][-1] == 0.0377
    assert ours.tobytes() == np.asarray(fmpys).tobytes()


@pytest.mark.parametrize("order", ["parallel", "sequential"])
def test_a_closed_loop_is_the_same_in_c_and_in_python(
    fmus: Path, monkeypatch: pytest.MonkeyPatch, order: str
) -> None:
    """Three FMUs, wires and a push; every watched signal, to the bit."""
    push = (0.1, 0.2, 0.5)
    setup = Setup(stop_time=0.5, order=order, push=push, sensor="camera")
    instances, results = Instances(), []
    for without in ("", "1"):
        monkeypatch.setenv(stepper.NOT_COMPILED, without)
        stepper.library.cache_clear()
        results.append(setup.loop(fmus).run(instances))
    stepper.library.cache_clear()
    assert np.ptp(results[0]["crane::payload.x_rel"]) > 1e-3
    assert results[0].tobytes() == results[1].tobytes()


def test_a_series_is_its_loops_one_after_the_other(fmus: Path, instances: Instances) -> None:
    setups = [Setup(payload=mass, sensor="camera", stop_time=0.2) for mass in (0.07, 0.42)]
    loops = [setup.loop(fmus) for setup in setups]
    told: list[float] = []
    results = Series(loops).run(instances, told.append)
    assert told == sorted(told) and told[-1] == pytest.approx(0.4)
    for loop, result in zip(loops, results, strict=True):
        assert result.tobytes() == loop.run(instances).tobytes()


def test_chosen_outputs_are_all_that_is_read(native_fmus: Path, instances: Instances) -> None:
    job = short(job_of("paper_heavy", native_fmus / "crane_nl_native.fmu"))
    chosen = replace(job, outputs=("solver.steps", "payload.x")).run(instances)
    assert chosen.dtype.names == ("time", "payload.x", "solver.steps")
    np.testing.assert_array_equal(chosen["payload.x"], job.run(instances)["payload.x"])


def test_an_fmu_is_loaded_once_and_again_when_its_file_changes(
    native_fmus: Path, tmp_path: Path
) -> None:
    file = tmp_path / "crane.fmu"
    file.write_bytes((native_fmus / "crane_nl_native.fmu").read_bytes())
    instances = Instances()
    first = instances.get(file)
    assert instances.get(file) is first
    file.write_bytes((native_fmus / "crane_lin_native.fmu").read_bytes())
    assert instances.get(file).description.modelName == "crane_lin_native"


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"payload.mas": 1.0}, "there is no variable 'payload.mas' to start with"),
        ({"payload.mass": "heavy"}, "payload.mass = 'heavy' is not allowed: a finite number"),
        ({"chain.elements": 2.5}, "chain.elements = 2.5 is not allowed: a whole number"),
        ({"solver.scheme": 3}, "solver.scheme = 3 is not allowed: a text in quotes"),
        ({"payload.x": 1.0}, "payload.x is an output: it has no start value"),
        ({"payload.mass": -1.0}, "payload.mass = -1.0 is not allowed: a finite number above 0"),
    ],
)
def test_a_bad_start_value_costs_its_own_run(
    native_fmus: Path, instances: Instances, start: dict[str, object], message: str
) -> None:
    job = short(job_of("paper_heavy", native_fmus / "crane_nl_native.fmu"))
    before = job.run(instances)
    with pytest.raises(UserError, match=message.replace(".", r"\.")):
        replace(job, start_values=start).run(instances)
    assert job.run(instances).tobytes() == before.tobytes()


def test_a_discarded_step_says_when_and_why(fmus: Path, instances: Instances) -> None:
    """The trolley's jump is too large for one step; the run after it is as before."""
    job = short(job_of("paper_heavy", fmus / "crane_nl.fmu"))
    before = job.run(instances)
    assert job.inputs is not None
    inputs = job.inputs.copy()
    inputs["time"] = 0.0, 0.05, 0.05, 1.0
    inputs["trolley.v_cmd"] = 0.8, 0.8, 1e300, 1e300
    with pytest.raises(UserError, match=r"stopped at 0\.05 s of 0\.1 s: .* did not converge"):
        replace(job, inputs=inputs).run(instances)
    assert job.run(instances).tobytes() == before.tobytes()


# --- workers ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Square:
    """Work of no FMU: what it gives, and what kills its worker."""

    number: int
    deadly: bool = False
    marker: Path | None = None  # it kills the first worker alone, and leaves this
    lasts: float = 0.0  # s

    @property
    def name(self) -> str:
        return f"square {self.number}"

    def run(self, instances: Instances, progress: Progress | None = None) -> int:
        time.sleep(self.lasts)
        if self.deadly and not (self.marker and self.marker.exists()):
            if self.marker:
                self.marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if self.number < 0:
            raise UserError(f"{self.number} is below 0")
        return self.number**2


def outcomes(count: int, work: list[Square]) -> dict[int, object]:
    """What each number gave; none may come twice."""
    found: dict[int, object] = {}
    with Workers(count) as workers:
        for number, result in workers.run(enumerate(work)):
            assert number not in found
            found[number] = result
    return found


@HOST_ONLY
def test_what_kills_its_worker_fails_alone() -> None:
    """It is in the middle of a batch, whose rest is done by others."""
    work = [Square(n, deadly=n == 500) for n in range(1000)]
    found = outcomes(2, work)
    assert found.pop(500) == "square 500: the FMU crashed, exit code -9"
    assert isinstance(found[1], int)
    assert found == {n: n**2 for n in range(1000) if n != 500}


@HOST_ONLY
def test_a_worker_that_is_killed_costs_no_run(tmp_path: Path) -> None:
    work = [Square(n, n in (3, 7), tmp_path / str(n), lasts=0.01) for n in range(20)]
    assert outcomes(2, work) == {n: n**2 for n in range(20)}


def test_work_that_fails_is_a_failure_and_the_rest_goes_on() -> None:
    found = outcomes(1, [Square(2), Square(-3), Square(4)])
    assert found == {0: 4, 1: "-3 is below 0", 2: 16}
    assert isinstance(found[1], Failure)


def test_workers_that_are_started_early_serve_all() -> None:
    """Who asks for workers gets those that are there, and who started them ends them."""
    with early_workers(1):
        with workers_for(3) as first:
            (early,) = first._workers
            assert dict(first.run(enumerate([Square(2), Square(3)]))) == {0: 4, 1: 9}
        with workers_for(1) as second:
            assert second is first and early in first._workers
            early.process.kill()  # it costs no run
            assert dict(second.run(enumerate([Square(4)]))) == {0: 16}
    assert early.process.poll() is not None and not first._workers
    with workers_for(1) as other:
        assert other is not first


@HOST_ONLY
def test_workers_that_cannot_be_started_early_are_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with early_workers(1):
        monkeypatch.undo()
        with workers_for(1) as workers:
            assert dict(workers.run(enumerate([Square(2)]))) == {0: 4}


def test_what_is_to_be_run_next_is_shared_too() -> None:
    """One worker does not take all of it, as it may where each call, a fit's say, was quick."""
    with Workers(2) as workers:
        for _ in range(8):
            assert dict(workers.run(enumerate([Square(1), Square(2)]))) == {0: 1, 1: 4}
        last = workers.run(enumerate(Square(n, lasts=0.05) for n in range(4)))
        next(last)
        assert all(len(worker.sent) <= 1 for worker in workers._workers)
        assert len(dict(last)) == 3


def test_work_is_taken_as_it_is_needed() -> None:
    """So memory does not grow with the number of runs."""
    taken = 0

    def endless() -> Iterator[tuple[int, Square]]:
        nonlocal taken
        while True:
            yield taken, Square(taken)
            taken += 1

    with Workers(1) as workers:
        for done, _ in zip(range(100), workers.run(endless()), strict=False):
            assert taken <= done + 2 * 256 + 2


@HOST_ONLY
def test_workers_end_with_their_parent(native_fmus: Path, tmp_path: Path) -> None:
    """Also when that is killed: then nobody could end them."""
    script = tmp_path / "parent.py"
    script.write_text(
        "import os, signal, sys\n"
        f"sys.path[:0] = [{str(Path(__file__).parent)!r}]\n"
        "from test_07_ensembles import Square\n"
        "from chaincrane_driver.processes import Workers\n"
        "with Workers(1) as workers:\n"
        "    for number, _ in workers.run((n, Square(n, lasts=0.01)) for n in range(1000)):\n"
        "        print(workers._workers[0].process.pid, flush=True)\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True)
    assert done.returncode == -signal.SIGKILL, done.stderr
    worker = int(done.stdout.split()[-1])
    for _ in range(100):
        try:
            os.kill(worker, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    raise AssertionError("the worker lives on")
