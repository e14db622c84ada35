"""Rung 7, a Dask cluster of real processes here. Reference: the same sweep without it."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT
from test_07_scenarios import one_line_error
from test_07_sweep import Squares, squares

from chaincrane_driver import vary
from chaincrane_driver.cli import main
from chaincrane_driver.cluster import dask
from chaincrane_driver.sweep import sweep

distributed = pytest.importorskip("distributed")
HEAVY = ROOT / "scenarios" / "paper_heavy"
POSIX_ONLY = pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX's")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two workers, processes with a nanny each."""
    python_path = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = str(Path(__file__).parent)  # Squares is here
    try:
        with distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as made:
            yield made
    finally:
        os.environ.pop("PYTHONPATH")
        if python_path is not None:
            os.environ["PYTHONPATH"] = python_path


def test_a_cluster_gives_what_one_machine_does(
    native_fmus: Path, tmp_path: Path, cluster: Any
) -> None:
    command = ["sweep", str(HEAVY), "--run", "nonlinear", "--vary", "payload.mass=-0.1:0.4:11"]
    command += ["--fmu", str(native_fmus / "crane_nl_native.fmu")]
    for place, more in (("here", []), ("there", ["--scheduler", cluster.scheduler_address])):
        assert main([*command, "--out", str(tmp_path / place), *more]) == 0
    here, there = ((tmp_path / place / "sweep.csv").read_text() for place in ("here", "there"))
    assert here == there
    assert "not allowed" in there


@POSIX_ONLY
def test_a_dask_worker_that_is_killed_loses_nothing(tmp_path: Path, cluster: Any) -> None:
    """In the middle of its batch; nor does work that kills the process that it is in."""
    design = vary.design(["x=0:99:100"])
    subject = Squares(kills=frozenset({70}), lasts=0.03, tells=tmp_path)
    (tmp_path / "at 60").unlink(missing_ok=True)
    schedule = dask(cluster.scheduler_address)
    killed: list[int] = []

    def disturbed(*arguments: Any) -> Any:
        for outcome in schedule(*arguments):
            if not killed:
                with distributed.Client(cluster, set_as_default=False) as client:
                    killed.extend(client.run(os.getpid).values())
                os.kill(killed[0], signal.SIGKILL)
            yield outcome

    sweep(subject, design, tmp_path, disturbed)
    found = squares(tmp_path)
    assert [x for x in range(100) if found[x] != x * x] == [70]


def test_no_scheduler_is_one_line(fmus: Path, tmp_path: Path) -> None:
    command: list[object] = ["sweep", HEAVY, "--fmus", fmus, "--out", tmp_path]
    command += ["--vary", "payload.mass=1,2", "--scheduler", "nonsense://here"]
    one_line_error(command, "--scheduler nonsense://here: no Dask scheduler there")
