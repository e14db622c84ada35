"""Shared by all rungs of the ladder: the FMUs, built once, and fresh processes to run them in."""

from __future__ import annotations

import inspect
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
# what is not in a package: build_fmu.py, benchmarks
sys.path[:0] = [str(ROOT / folder) for folder in (".", "benchmarks")]

from chaincrane.plant.kernel import load_library  # noqa: E402
from chaincrane_builder.compile_c import kernel_for_host  # noqa: E402
from chaincrane_builder.fmus import MODELS, NATIVE_MODELS  # noqa: E402
from chaincrane_builder.pack import build  # noqa: E402

STOP_AT = 1.0  # s, when the paper's trolley stops
SPEED = 0.8  # m/s, until then
PAYLOADS = {"heavy": 0.42, "light": 0.07}  # kg

compiler = shutil.which(os.environ.get("CC", "cc"))
linux_host = pytest.mark.skipif(
    not sys.platform.startswith("linux") or compiler is None,
    reason="compiles and runs a host in C on Linux",
)


@pytest.fixture(scope="session", autouse=True)
def _ctrl_c_stops() -> None:
    """Also where a shell has put the tests into the background: what it starts there ignores it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def _no_litter(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What tools leave in the temporary folder, FMUs unpacked by workers that died say, goes."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("temporary")
        patch.setenv("TMPDIR", str(folder))
        patch.setattr(tempfile, "tempdir", str(folder))
        yield
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="session")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of all FMUs; skips the test where pythonfmu has no wrapper to run them."""
    if sys.platform == "darwin":
        pytest.skip("pythonfmu has no wrapper for macOS")
    folder = tmp_path_factory.mktemp("fmus")
    for model in MODELS:
        build(model, folder)
    return folder


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The nonlinear crane's kernel, compiled for this machine as the FMU's is."""
    return load_library(str(kernel_for_host(tmp_path_factory.mktemp("kernel"))))


@pytest.fixture(scope="session")
def linear_library(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The linear crane in C, as a kernel."""
    folder = tmp_path_factory.mktemp("linear_kernel")
    return load_library(str(kernel_for_host(folder, "linear.c")))


@pytest.fixture(scope="session")
def native_fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of crane_nl_native.fmu and crane_lin_native.fmu."""
    folder = tmp_path_factory.mktemp("native_fmus")
    for model in NATIVE_MODELS:
        build(model, folder)
    return folder


def paper_motion() -> np.ndarray:
    """The paper's trolley motion as FMPy's input table: 0.8 m/s for a second, then a stop."""
    rows = [(0.0, SPEED), (STOP_AT, SPEED), (STOP_AT, 0.0), (4.0, 0.0)]
    return np.array(rows, dtype=[("time", float), ("trolley.v_cmd", float)])


def in_fresh_process(function: Callable[..., Any], *arguments: Any, check: bool = True) -> Any:
    """Call a self-contained function in a new Python process; arguments and result as JSON.

    With ``check`` off the completed process is returned, whatever its end.
    """
    source = textwrap.dedent(inspect.getsource(function))
    call = f"{function.__name__}(*json.loads({json.dumps(json.dumps(arguments))}))"
    script = "from __future__ import annotations\n"
    script += f"import json, os, sys\n{source}\nprint('\\n' + json.dumps({call}), flush=True)\n"
    script += "os._exit(0)\n"
    done = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-c", script],
        cwd=Path(__file__).parent,  # so that it can import slave_host
        capture_output=True,
        text=True,
        timeout=600,
    )
    if not check:
        return done
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout.splitlines()[-1])
