"""Rung 8, real importers. References: another tool each, against FMPy, on the paper's run."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import logging
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import PAYLOADS, SPEED, STOP_AT, paper_motion
from importers.case import Case

from chaincrane.plant.interface import OUTPUTS
from chaincrane_driver.processes import simulate_all
from chaincrane_driver.simulate import Job
from chaincrane_driver.tables import read_table

STEP = 0.005
EVERY_MODEL = ["crane_nl", "crane_lin", "crane_nl_native", "crane_lin_native"]
REAL_OUTPUTS = [variable.name for variable in OUTPUTS if variable.kind == "Real"]
COFMUPY = "CHAINCRANE_COFMUPY"  # a Python with cofmupy, whose pins do not go with ours


@pytest.fixture(scope="module")
def every_fmu(fmus: Path, native_fmus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One folder with all cranes: with Python inside, and native."""
    folder = tmp_path_factory.mktemp("every_fmu")
    for model in EVERY_MODEL:
        shutil.copy((native_fmus if "native" in model else fmus) / f"{model}.fmu", folder)
    return folder


def python_for(script: str) -> str:
    """The Python that has an importer; skips the test, with the reason, where there is none."""
    package = {"libcosim": "libcosimpy", "ecos": "ecospy", "container": "fmu_manipulation_toolbox"}
    if script == "cofmu":
        if not os.environ.get(COFMUPY):
            pytest.skip(f"set {COFMUPY} to a Python with cofmupy 1.0.0: it needs a venv of its own")
        return os.environ[COFMUPY]
    if importlib.util.find_spec(package[script]) is None:
        pytest.skip(f"{package[script]} is not installed: pip install -e '.[importers]'")
    if script == "ecos":
        done = subprocess.run(
            [sys.executable, "-c", "import ecospy"], capture_output=True, text=True
        )
        if "libtbb" in done.stderr:
            pytest.skip("ecospy needs the system library libtbb.so.12 (Debian: libtbb12)")
    return sys.executable


@pytest.mark.parametrize("payload", PAYLOADS.values(), ids=PAYLOADS.keys())
@pytest.mark.parametrize("model", EVERY_MODEL)
@pytest.mark.parametrize("script", ["libcosim", "ecos", "cofmu", "container"])
def test_importer_agrees_with_fmpy(
    every_fmu: Path, tmp_path: Path, script: str, model: str, payload: float
) -> None:
    """Every Real output at every communication point, to 1e-9 m (forces, a stiff chain: 1e-5 N).

    They step alike but for round-off of the step size: 0.005 or 0.005000000000000338 s.
    """
    start: dict[str, float | str] = {"payload.mass": payload}
    if script != "cofmu":  # which sets each parameter as a Real
        start |= {"chain.elements": 8, "solver.scheme": "energy_momentum"}
    case = Case(
        fmu=str(every_fmu / f"{model}.fmu"),
        out=str(tmp_path / "out.csv"),
        step=STEP,
        stop=4.0,
        start=start,
        outputs=REAL_OUTPUTS,
        input=[(0.0, {"trolley.v_cmd": SPEED}), (STOP_AT, {"trolley.v_cmd": 0.0})],
    )
    python = python_for(script)
    done = subprocess.run(
        [python, "-m", f"importers.{script}", json.dumps(dataclasses.asdict(case))],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ | {"TMPDIR": str(tmp_path)},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    result = read_table(Path(case.out))
    (truth,) = simulate_all([Job(Path(case.fmu), start, paper_motion(), 4.0, STEP)], script)
    assert len(result) == len(truth) == 801
    np.testing.assert_allclose(result["time"], truth["time"], atol=1e-9)
    for name in REAL_OUTPUTS:
        allowed = 1e-5 if name.startswith(("trolley.fx", "chain.tension")) else 1e-9
        assert np.abs(result[name] - truth[name]).max() < allowed, name


@pytest.mark.parametrize("model", EVERY_MODEL)
def test_the_toolboxs_checker_has_no_complaint(every_fmu: Path, model: str) -> None:
    if importlib.util.find_spec("fmu_manipulation_toolbox") is None:
        pytest.skip("fmu-manipulation-toolbox is not installed: pip install -e '.[importers]'")
    from fmu_manipulation_toolbox.checker import get_checkers
    from fmu_manipulation_toolbox.operations import FMU

    complaints: list[str] = []

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            complaints.append(record.getMessage())

    logger, handler = logging.getLogger("fmu_manipulation_toolbox"), Keep(logging.WARNING)
    logger.addHandler(handler)
    try:
        with FMU(str(every_fmu / f"{model}.fmu")) as opened:
            for checker in get_checkers():
                opened.apply_operation(checker())
    finally:
        logger.removeHandler(handler)
    assert complaints == []
