"""Rung 8, FMUs in hosts that we have never seen: state, reset, errors, many FMUs, builds, XML.

Each row of what goes wrong with pythonfmu FMUs as they come is held here. Every FMU runs in a
process of its own; functions whose name begins with '_' run there.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import pytest
from conftest import ROOT, compiler, in_fresh_process, linux_host

from chaincrane.plant.interface import OUTPUTS, VARIABLES, settings
from chaincrane.plant.linear import LinearCrane
from chaincrane.plant.nonlinear import NonlinearCrane
from chaincrane_builder.fmus import NATIVE_MODELS
from chaincrane_builder.pack import build, imported

MODELS = ("crane_nl", "crane_lin")
both = pytest.mark.parametrize("model", MODELS)
EVERY = ("crane_nl", "crane_lin", "crane_observer", "crane_antisway", *NATIVE_MODELS)
every = pytest.mark.parametrize("model", EVERY)


@pytest.fixture(scope="module")
def all_fmus(fmus: Path, native_fmus: Path) -> dict[str, str]:
    """The six FMUs' files by their models."""
    return {m: str((native_fmus if m in NATIVE_MODELS else fmus) / f"{m}.fmu") for m in EVERY}


# --- one process, many FMUs -------------------------------------------------------------------


def _load_together(earth: str, moon: str, other: str) -> list[float]:
    from slave_host import Host

    import chaincrane.plant.parameters  # the host has the package too, and another one

    chaincrane.plant.parameters.Chain.length = 99.0
    hosts = [Host(fmu, initial__sway_angle=0.1) for fmu in (earth, moon, other)]
    for host in hosts:
        host.run(30)
    return [host.get("payload.x_rel") for host in hosts]


def _alone(fmu: str) -> float:
    from slave_host import Host

    host = Host(fmu, initial__sway_angle=0.1)
    host.run(30)
    return float(host.get("payload.x_rel"))


def test_two_builds_and_two_models_each_run_their_own_code(fmus: Path, tmp_path: Path) -> None:
    sources = imported("crane_nl")
    name = "chaincrane/plant/parameters.py"
    changed = sources[name].replace(b'"m/s2", 9.81', b'"m/s2", 1.62')
    assert changed != sources[name]
    moon = build("crane_nl", tmp_path, sources | {name: changed})
    files = [str(fmus / "crane_nl.fmu"), str(moon), str(fmus / "crane_lin.fmu")]
    together = in_fresh_process(_load_together, *files)
    assert together == [in_fresh_process(_alone, file) for file in files]
    assert len(set(together)) == 3
    assert abs(together[0] - together[1]) > 1e-3


# --- state ------------------------------------------------------------------------------------


def _save_and_restore(fmu: str) -> list[bool]:
    from slave_host import Host

    host = Host(fmu, payload__mass=0.07)
    first_input = next(v.name for v in host.variables.values() if v.causality == "input")
    host.run(30)
    host.set(first_input, 0.3)
    host.run(100)  # 1.3 s
    state = host.slave.getFMUState()
    data = host.slave.serializeFMUState(state)
    first = host.run(50)
    host.set(first_input, -0.9)
    host.run(5)
    host.slave.setFMUState(state)
    host.time = 1.3
    again = host.run(50)

    other = Host(fmu, payload__mass=0.5)
    restored = other.slave.deserializeFMUState(data)
    other.slave.setFMUState(restored)
    other.time = 1.3
    in_other = other.run(50)
    for one in (host, other):
        one.slave.freeFMUState(state if one is host else restored)
    return [first == again, first == in_other, other.get("payload.mass") == 0.07]


@every
def test_restored_it_runs_on_with_the_same_bits(all_fmus: dict[str, str], model: str) -> None:
    assert in_fresh_process(_save_and_restore, all_fmus[model]) == [True] * 3


def _save_to_file(fmu: str, file: str) -> list[list[float]]:
    from pathlib import Path

    from slave_host import Host

    host = Host(fmu)
    host.run(130)
    data = host.slave.serializeFMUState(host.slave.getFMUState())
    Path(file).write_bytes(data)
    return host.run(20)


def _run_from_file(fmu: str, file: str) -> list[list[float]]:
    from pathlib import Path

    from slave_host import Host

    host = Host(fmu, initialise=False)
    data = Path(file).read_bytes()
    host.slave.setFMUState(host.slave.deserializeFMUState(data))
    host.time = 1.3
    return host.run(20)


@every
def test_serialised_state_runs_on_in_a_new_process(
    all_fmus: dict[str, str], tmp_path: Path, model: str
) -> None:
    file, fmu = str(tmp_path / "state"), all_fmus[model]
    saved = in_fresh_process(_save_to_file, fmu, file)
    assert in_fresh_process(_run_from_file, fmu, file) == saved


def _restore_damaged(fmu: str, foreign: str) -> dict[str, Any]:
    from slave_host import DISCARD, LOG, OK, Host

    host, other = Host(fmu), Host(foreign)
    before = host.run(10)[-1]
    good = host.slave.serializeFMUState(host.slave.getFMUState())
    strange = other.slave.serializeFMUState(other.slave.getFMUState())
    flipped = bytearray(good)
    flipped[-20] ^= 1
    messages = []
    for data in (bytes(flipped), strange, b"rubbish", good[: len(good) // 2]):
        host.slave.setFMUState(host.slave.deserializeFMUState(data))
        messages.append(LOG[-1])
        assert host.outputs() == before
        assert host.step() == DISCARD
    host.slave.setFMUState(host.slave.deserializeFMUState(good))
    assert host.step() == OK
    return {"messages": messages}


def test_damaged_and_foreign_states_are_refused(fmus: Path) -> None:
    files = str(fmus / "crane_nl.fmu"), str(fmus / "crane_lin.fmu")
    messages = in_fresh_process(_restore_damaged, *files)["messages"]
    assert all(message.startswith("logStatusError: the saved state") for message in messages)
    assert "of crane_lin" in messages[1]
    for message in messages[0], messages[2], messages[3]:
        assert "damaged" in message


# --- reset, and memory ------------------------------------------------------------------------


def _resets(fmu: str, count: int) -> dict[str, Any]:
    import resource

    from slave_host import Host

    def memory() -> int:
        return int(open("/proc/self/statm").read().split()[1]) * resource.getpagesize()

    host = Host(fmu)
    first = host.run(3)
    same, early = True, 0
    for number in range(count):
        host.slave.reset()
        host.initialise()
        if number % 1000 == 0:
            same = same and host.run(3) == first
        if number == count // 10:
            early = memory()
    host.slave.reset()
    host.initialise()
    return {"same": same and host.run(3) == first, "grown": memory() - early}


linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")


@linux
@pytest.mark.parametrize(
    ("model", "count", "allowed"),
    [
        ("crane_nl", 10_000, 3e6),
        ("crane_lin", 10_000, 3e6),
        ("crane_antisway", 10_000, 4e6),
        ("crane_observer", 200, 1e6),  # designs its filter anew each time, 40 ms
    ],
)
def test_thousands_of_resets(fmus: Path, model: str, count: int, allowed: float) -> None:
    """The same bits; memory flat to 300 bytes a reset, of which pythonfmu keeps references, and to
    some 0.5 MB that SciPy and its like take in the first hundreds.
    """
    done = in_fresh_process(_resets, str(fmus / f"{model}.fmu"), count)
    assert done["same"]
    assert done["grown"] < allowed


def _instantiations(fmu: str, count: int) -> dict[str, Any]:
    import resource
    import sys

    from fmpy.fmi2 import FMU2Slave
    from slave_host import CALLBACKS, Host

    def memory() -> int:
        return int(open("/proc/self/statm").read().split()[1]) * resource.getpagesize()

    host = Host(fmu)
    early, paths = 0, 0
    for number in range(count):
        slave = FMU2Slave(
            guid=host.description.guid,
            unzipDirectory=host.folder,
            modelIdentifier=host.description.coSimulation.modelIdentifier,
            instanceName="again",
        )
        slave.instantiate(callbacks=CALLBACKS)
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        slave.doStep(currentCommunicationPoint=0.0, communicationStepSize=0.01)
        slave.freeInstance()
        if number == count // 10:
            early, paths = memory(), len(sys.path)
    return {"grown": memory() - early, "paths": len(sys.path) - paths}


@linux
@both
def test_a_thousand_instantiations(fmus: Path, model: str) -> None:
    """Memory flat but for what pythonfmu 0.7.0 leaks, 11 kB each: it compiles the slave's file
    anew each time and keeps it. Our own share is none: sys.path does not grow.
    """
    done = in_fresh_process(_instantiations, str(fmus / f"{model}.fmu"), 1000)
    assert done["grown"] < 900 * 15_000
    assert done["paths"] == 0


# --- the end of a process -----------------------------------------------------------------------


@linux_host
@pytest.mark.parametrize("leave", ["running", "freed", "unloaded", "freed_at_exit"])
def test_c_program_ends_well(fmus: Path, tmp_path: Path, leave: str) -> None:
    """In each way it could abort, "corrupted unsorted chunks", before we mended that."""
    shared = Path(sysconfig.get_config_var("LIBDIR"), sysconfig.get_config_var("INSTSONAME"))
    if not sysconfig.get_config_var("Py_ENABLE_SHARED") or not shared.exists():
        pytest.skip("sysconfig names no shared library of this Python")
    host = str(tmp_path / "python_host")
    headers = Path(fmpy.__file__).parent / "c-code"
    source = str(Path(__file__).with_name("python_host.c"))
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-D_POSIX_C_SOURCE=200809L"]
    subprocess.run([str(compiler), *flags, "-I", headers, source, "-o", host, "-ldl"], check=True)
    fmu = str(fmus / "crane_lin.fmu")
    extracted = fmpy.extract(fmu, str(tmp_path / "crane_lin"))
    library = f"{extracted}/binaries/linux64/crane_lin.so"
    environment = {
        "LD_PRELOAD": str(shared),
        "PYTHONHOME": sys.base_prefix,
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path.endswith("-packages")),
    }
    done = subprocess.run(
        [host, leave, extracted, library, fmpy.read_model_description(fmu).guid],
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ | environment,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")


def _extractions(fmu: str, count: int) -> int:
    """Wrappers that are loaded after so many extractions of an FMU, each freed and unloaded."""
    from slave_host import Host

    for _ in range(count):
        host = Host(fmu)
        host.close()
    with open("/proc/self/maps") as lines:
        return len({line.split()[-1] for line in lines if "/binaries/linux64/" in line})


@linux
def test_an_fmu_that_is_unloaded_is_not_kept(fmus: Path) -> None:
    """But for the first in a process, which pythonfmu's own unique symbols keep."""
    assert in_fresh_process(_extractions, str(fmus / "crane_lin.fmu"), 5) == 1


@linux
@pytest.mark.parametrize("free", [False, True], ids=["running", "freed"])
def test_python_script_ends_without_touching_freed_memory(fmus: Path, free: bool) -> None:
    """It rarely aborted, "corrupted double-linked list"; valgrind sees the cause each time."""
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        pytest.skip("valgrind is not installed (Debian: valgrind)")
    fmu = str(fmus / "crane_nl.fmu")
    script = f"from slave_host import Host; host = Host({fmu!r}); assert host.step() == 0; "
    script += "host.slave.freeInstance(); print('done')" if free else "print('done')"
    done = subprocess.run(
        [valgrind, "-q", "--error-limit=no", sys.executable, "-c", script],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert (done.returncode, done.stdout) == (0, "done\n")
    assert "finalizePythonInterpreter" not in done.stderr


# --- errors -----------------------------------------------------------------------------------


def _bad_start(fmu: str, name: str, value: Any) -> dict[str, Any]:
    from slave_host import LOG, OK, Host

    host = Host(fmu, initialise=False)
    host.initialise(**{name: float(value) if isinstance(value, str) and "n" in value else value})
    status = host.step()
    message, x = LOG[-1], host.get("payload.x")
    host.slave.reset()
    host.initialise()
    assert host.step() == OK
    host.close()
    return {"status": status, "message": message, "nan": x != x}


BAD_STARTS = [
    ("chain.mass", -1.0, "a finite number above 0"),
    ("chain.mass", "nan", "a finite number above 0"),
    ("chain.length", 0.0, "a finite number above 0"),
    ("chain.EA", "inf", "a finite number above 0"),
    (
        "chain.EA",
        1e18,
        "at most 3.14e+12 N: beyond, round-off outweighs these masses and elements",
    ),
    ("payload.mass", 0.0, "a finite number above 0"),
    ("gravity", -9.81, "a finite number above 0"),
    ("damping.air", -0.1, "a finite number, 0 or above"),
    ("damping.chain", "nan", "a finite number, 0 or above"),
    ("initial.speed", "inf", "a finite number"),
    ("initial.sway_angle", 3.2, "an angle strictly between -pi and pi rad"),
    ("solver.max_step", 0.0, "a finite number above 0"),
    ("chain.elements", 0, "a whole number from 1 to 10000"),
    ("chain.elements", 10_001, "a whole number from 1 to 10000"),
]


@pytest.mark.parametrize(("name", "value", "allowed"), BAD_STARTS)
def test_bad_start_values_are_refused(fmus: Path, name: str, value: Any, allowed: str) -> None:
    """By name, with the value and what is allowed; outputs are no number; a reset mends it."""
    done = in_fresh_process(_bad_start, str(fmus / "crane_lin.fmu"), name.replace(".", "__"), value)
    assert done["status"] == 2
    assert done["message"] == f"logStatusError: {name} = {value} is not allowed: {allowed}"
    assert done["nan"]


def _bad_scheme(fmu: str) -> dict[str, Any]:
    from slave_host import LOG, Host

    host = Host(fmu, solver__scheme="euler")
    return {"status": host.step(), "message": LOG[-1]}


@both
def test_an_unknown_scheme_is_refused(fmus: Path, model: str) -> None:
    done = in_fresh_process(_bad_scheme, str(fmus / f"{model}.fmu"))
    assert done["status"] == 2
    assert (
        "solver.scheme = 'euler' is not allowed: one of energy_momentum, newmark" in done["message"]
    )


def _bad_steps(fmu: str) -> list[list[Any]]:
    from slave_host import LOG, OK, Host

    host = Host(fmu)
    host.run(10)
    before, seen = host.outputs(), []

    def refused(status: int) -> None:
        seen.append([status, LOG[-1], host.outputs() == before])

    for h in (0.0, -0.01, float("nan"), float("inf"), 1e300):
        refused(host.step(h))
    for at in (0.05, 0.2, float("nan")):
        refused(host.step(0.01, at=at))
    for name in ("trolley.v_cmd", "trolley.a_cmd", "payload.fx"):
        for value in (float("nan"), float("inf")):
            host.set(name, value)
            refused(host.step())
            host.set(name, 0.0)
    host.set("payload.mass", 2.0)
    refused(host.step())
    host.set("trolley.x", 1.0)
    refused(host.step())
    host.slave.setReal([4711], [1.0])
    refused(host.step())
    assert host.step() == OK  # and it goes on as if nothing had been
    fresh = Host(fmu)
    assert fresh.run(11)[-1] == host.outputs()
    return seen


@both
def test_bad_steps_and_inputs_leave_the_state(fmus: Path, model: str) -> None:
    seen = in_fresh_process(_bad_steps, str(fmus / f"{model}.fmu"))
    expected = ["step size = 0.0", "step size = -0.01", "step size = nan", "step size = inf"]
    expected += ["step size = 1e+300"]
    expected += ["current communication point = 0.05", "current communication point = 0.2"]
    expected += ["current communication point = nan"]
    for name in ("trolley.v_cmd", "trolley.a_cmd", "payload.fx"):
        expected += [f"{name} = nan", f"{name} = inf"]
    expected += ["payload.mass is a parameter", "trolley.x is an output", "value reference 4711"]
    assert len(seen) == len(expected)
    for (status, message, unchanged), part in zip(seen, expected, strict=True):
        assert (status, unchanged) == (2, True), message
        assert message.startswith("logStatusError: ")
        assert part in message


def _unconverged(fmu: str) -> list[Any]:
    from slave_host import LOG, OK, Host

    host = Host(fmu)
    host.run(10)
    before = host.outputs()
    host.set("trolley.v_cmd", 1e9)
    status, message = host.step(), LOG[-1]
    unchanged = host.outputs() == before
    host.set("trolley.v_cmd", 0.0)
    return [status, message, unchanged, host.step() == OK]


def test_a_solver_that_does_not_converge_says_when_and_why(fmus: Path) -> None:
    status, message, unchanged, usable = in_fresh_process(_unconverged, str(fmus / "crane_nl.fmu"))
    assert (status, unchanged, usable) == (2, True, True)
    assert message.startswith("logStatusError: at t = 0.1 s: ")


def _fails_late(fmu: str) -> str:
    from slave_host import LOG, Host

    host = Host(fmu, initialise=False)
    host.slave.setupExperiment(startTime=100.0)
    host.slave.enterInitializationMode()
    host.slave.exitInitializationMode()
    host.time = 100.0
    host.run(3)
    host.set("trolley.v_cmd", 1e9)
    host.step()
    return LOG[-1]


def test_messages_speak_of_the_hosts_time(fmus: Path) -> None:
    message = in_fresh_process(_fails_late, str(fmus / "crane_nl.fmu"))
    assert message.startswith("logStatusError: at t = 100.03 s: ")


def _stepped_without_initialisation(fmu: str) -> list[Any]:
    from slave_host import LOG, Host

    host = Host(fmu, initialise=False)
    early = host.step(), LOG[-1]
    host.initialise()
    host.run(1)
    host.slave.terminate()
    return [*early, host.step(), LOG[-1]]


@both
def test_steps_out_of_order_are_refused(fmus: Path, model: str) -> None:
    early, first, late, second = in_fresh_process(
        _stepped_without_initialisation, str(fmus / f"{model}.fmu")
    )
    assert (early, late) == (2, 2)
    assert "this one is instantiated" in first
    assert "this one is terminated" in second


def test_outputs_can_be_read_before_the_first_step(fmus: Path) -> None:
    value = in_fresh_process(_read_in_initialisation, str(fmus / "crane_nl.fmu"))
    assert value == pytest.approx([0.4, 0.2], rel=1e-12)


def _read_in_initialisation(fmu: str) -> list[float]:
    from slave_host import Host

    host = Host(fmu, initialise=False)
    host.slave.setupExperiment(startTime=0.0)
    host.slave.enterInitializationMode()
    seen = []
    for angle in (0.4, 0.2):
        host.set("initial.sway_angle", angle)
        seen.append(host.get("payload.sway_angle"))
    host.slave.exitInitializationMode()
    return seen


def imported_without_site_packages(fmu: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """Import an FMU's slave in a Python that has no packages, as a bare host's may be."""
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder)
    resources = folder / "resources"
    module = (resources / "slavemodule.txt").read_text()
    code = f"import sys; sys.path.insert(0, {str(resources)!r}); import {module} as slave;"
    code += f"print(slave.{module.rsplit('_', 1)[0]}(instance_name='bare').get_real([0]))"
    return subprocess.run([sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True)


def test_missing_packages_are_named_on_stderr(fmus: Path, tmp_path: Path) -> None:
    """A Python without site-packages has no NumPy: one line says what to install."""
    done = imported_without_site_packages(fmus / "crane_lin.fmu", tmp_path)
    assert done.returncode != 0
    assert done.stderr.splitlines()[0].endswith("lacks numpy: python -m pip install numpy")


def test_with_its_kernel_the_nonlinear_crane_needs_no_package(fmus: Path, tmp_path: Path) -> None:
    done = imported_without_site_packages(fmus / "crane_nl.fmu", tmp_path)
    assert (done.returncode, done.stdout.strip()) == (0, "[0.0]"), done.stderr


def _runs_without_a_kernel(fmu: str) -> list[Any]:
    from slave_host import LOG, Host

    host = Host(fmu)
    return [host.run(50)[-1], list(LOG)]


def test_without_a_kernel_numpy_runs_and_the_log_says_so(fmus: Path, tmp_path: Path) -> None:
    """An FMU whose kernels are not for this host: the same numbers, and a warning."""
    bare = tmp_path / "crane_nl.fmu"
    with zipfile.ZipFile(fmus / "crane_nl.fmu") as source, zipfile.ZipFile(bare, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            target.writestr(name, b"not a library" if "/native/" in name else content)
    slow, log = in_fresh_process(_runs_without_a_kernel, str(bare))
    assert any("logStatusWarning: no compiled kernel" in line for line in log)
    fast, log = in_fresh_process(_runs_without_a_kernel, str(fmus / "crane_nl.fmu"))
    assert log == []
    assert slow == pytest.approx(fast, abs=1e-6)


def _fuzz(fmu: str, sequences: int) -> int:
    """Random sequences of FMI calls; the number of sequences that came to their end."""
    from fmpy.fmi1 import FMICallException
    from hypothesis import HealthCheck, given
    from hypothesis import settings as hypothesis_settings
    from hypothesis import strategies as st
    from slave_host import FATAL, Host

    host = Host(fmu, initialise=False)
    number = st.one_of(
        st.floats(),
        st.floats(-1.0, 1.0),
        st.sampled_from([0.0, 1e-3, 1e300, -1e300, float("nan"), float("inf")]),
    )
    count = len(host.variables)
    reference = st.one_of(st.integers(0, count - 1), st.sampled_from([count, 4711, 2**31 - 1]))
    longest = [v.valueReference for n, v in host.variables.items() if n == "solver.max_step"]
    step_size = st.sampled_from([1e-3, 0.005, 0.013, 0.05, 0.0, -1.0, 1e300, float("nan")])
    call = st.one_of(
        st.tuples(st.just("setReal"), st.lists(st.tuples(reference, number), max_size=4)),
        st.tuples(
            st.just("setInteger"),
            st.lists(st.tuples(reference, st.integers(-3, 40) | st.just(2**31 - 1)), max_size=2),
        ),
        st.tuples(
            st.just("setString"),
            st.lists(
                st.tuples(reference, st.sampled_from(["newmark", "energy_momentum", "", "\u00fc"])),
                max_size=2,
            ),
        ),
        st.tuples(
            st.sampled_from(["getReal", "getInteger", "getString", "getBoolean"]),
            st.lists(reference, max_size=5),
        ),
        st.tuples(st.just("setupExperiment"), number),
        st.tuples(
            st.sampled_from(
                ["enterInitializationMode", "exitInitializationMode", "terminate", "reset"]
            ),
            st.none(),
        ),
        st.tuples(st.sampled_from(["start", "save", "restore"]), st.none()),
        st.tuples(st.just("deserialise"), st.binary(max_size=80)),
        st.tuples(st.just("step"), st.tuples(step_size, st.none() | number)),
        st.tuples(st.just("step"), st.tuples(st.just(0.005), st.none())),
    )
    done = 0

    def make(slave: Any, states: list[Any], clock: list[float], name: str, value: Any) -> None:
        if name in ("setReal", "setInteger", "setString"):
            pairs = [  # an internal step of 1e-9 s is allowed, and would take all day
                (vr, v)
                for vr, v in value
                if name != "setReal" or vr not in longest or not 0 < v < 1e-4
            ]
            getattr(slave, name)([vr for vr, _ in pairs], [v for _, v in pairs])
        elif name.startswith("get"):
            getattr(slave, name)(value)
        elif name == "setupExperiment":
            slave.setupExperiment(startTime=value)
        elif name == "start":
            slave.reset()
            slave.setupExperiment(startTime=0.0)
            slave.enterInitializationMode()
            slave.exitInitializationMode()
            clock[0] = 0.0
        elif name == "save":
            states.append(slave.getFMUState())
        elif name == "restore":
            if states:
                slave.setFMUState(states[-1])
                slave.serializeFMUState(states[-1])
        elif name == "deserialise":
            states.append(slave.deserializeFMUState(value))
            slave.setFMUState(states[-1])
        elif name == "step":
            h, at = value
            slave.doStep(
                currentCommunicationPoint=clock[0] if at is None else at, communicationStepSize=h
            )
            clock[0] += h
        else:
            getattr(slave, name)()

    @hypothesis_settings(
        max_examples=sequences,
        database=None,
        derandomize=True,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.lists(call, min_size=3, max_size=25))
    def fuzz(calls: list[Any]) -> None:
        nonlocal done
        states: list[Any] = []
        slave, clock = host.slave, [0.0]
        slave.reset()
        for name, value in calls:
            try:
                make(slave, states, clock, name, value)
            except FMICallException as error:
                assert error.status != FATAL, (name, value)
        for state in states:
            slave.freeFMUState(state)
        done += 1

    fuzz()
    host.close()
    return done


@every
def test_fuzzed_calls_end_with_a_status(all_fmus: dict[str, str], model: str) -> None:
    """200 sequences of FMI calls in random order, with random sizes and values: never a crash,
    never fmi2Fatal, after which an instance would be lost.
    """
    assert in_fresh_process(_fuzz, all_fmus[model], 200) >= 200


# --- builds -----------------------------------------------------------------------------------


def test_the_same_sources_give_the_same_bytes(fmus: Path, tmp_path: Path) -> None:
    """On another path, on another day, in another process, with files dated otherwise."""
    copy = tmp_path / "elsewhere" / "tree"
    shutil.copytree(ROOT / "fmu_src", copy / "fmu_src", ignore=shutil.ignore_patterns("*cache*"))
    for name in ("build_fmu.py", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    for file in copy.rglob("*"):
        os.utime(file, (1e9, 1e9))
    subprocess.run([sys.executable, "build_fmu.py", "--dest", "out"], cwd=copy, check=True)
    for model in MODELS:
        ours = (fmus / f"{model}.fmu").read_bytes()
        assert (copy / "out" / f"{model}.fmu").read_bytes() == ours


def test_source_date_epoch_is_obeyed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    with zipfile.ZipFile(build("crane_lin", tmp_path)) as archive:
        assert {info.date_time[:3] for info in archive.infolist()} == {(2023, 11, 14)}
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    assert root.get("generationDateAndTime") == "2023-11-14T22:13:20Z"


def test_entries_are_sorted_compressed_and_clean(fmus: Path) -> None:
    for model in MODELS:
        with zipfile.ZipFile(fmus / f"{model}.fmu") as archive:
            infos = archive.infolist()
        names = [info.filename for info in infos]
        assert names == sorted(names)
        assert {info.compress_type for info in infos} == {zipfile.ZIP_DEFLATED}
        assert not [name for name in names if "__pycache__" in name or name.endswith(".pyc")]
        assert {"model.png", "documentation/index.html"} <= set(names)
        assert "documentation/licenses/pythonfmu.txt" in names


def test_the_fmu_says_which_sources_it_came_from(fmus: Path, tmp_path: Path) -> None:
    sources = imported("crane_lin")
    changed = build(
        "crane_lin", tmp_path, sources | {"crane_lin.py": sources["crane_lin.py"] + b"#\n"}
    )
    versions = set()
    for fmu in (fmus / "crane_lin.fmu", changed):
        with zipfile.ZipFile(fmu) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
            page = archive.read("documentation/index.html").decode()
        version = root.get("version") or ""
        assert root.get("guid", "").strip("{}").startswith(version.split("+")[1])
        assert version in page
        versions.add(version)
    assert len(versions) == 2


# --- the XML ----------------------------------------------------------------------------------


def xml(fmus: Path, model: str) -> ElementTree.Element:
    with zipfile.ZipFile(fmus / f"{model}.fmu") as archive:
        return ElementTree.fromstring(archive.read("modelDescription.xml"))


@both
def test_the_xml_is_complete(fmus: Path, model: str) -> None:
    root = xml(fmus, model)
    for attribute in ("author", "version", "license", "copyright", "description", "guid"):
        assert root.get(attribute), attribute
    simulation = root.find("CoSimulation")
    assert simulation is not None
    assert simulation.get("needsExecutionTool") == "false"
    assert simulation.get("canGetAndSetFMUstate") == "true"
    assert simulation.get("canSerializeFMUstate") == "true"
    experiment = root.find("DefaultExperiment")
    assert experiment is not None
    assert experiment.attrib == {
        "startTime": "0",
        "stopTime": "4",
        "tolerance": "1e-6",
        "stepSize": "0.005",
    }
    units = {unit.get("name"): unit.find("BaseUnit") for unit in root.iter("Unit")}
    assert all(base is not None and base.attrib for base in units.values())
    assert set(units) == {row.unit for row in VARIABLES} - {None}
    variables = list(root.iter("ScalarVariable"))
    assert [v.get("name") for v in variables] == [v.name for v in VARIABLES]
    for variable, row in zip(variables, VARIABLES, strict=True):
        assert variable.get("description"), row.name
        assert variable.get("variability"), row.name
        assert bool(variable.get("initial")) == (row.causality != "input"), row.name
        real = variable.find("Real")
        if real is not None:
            assert real.get("unit") == row.unit, row.name
            assert real.get("nominal") is not None, row.name
        if row.causality == "parameter" and row.kind != "String" and row.name != "initial.speed":
            assert variable[0].get("min") is not None, row.name


@pytest.mark.parametrize(
    ("model", "crane_class"), [("crane_nl", NonlinearCrane), ("crane_lin", LinearCrane)]
)
def test_initial_unknowns_have_their_true_dependencies(
    fmus: Path, model: str, crane_class: Any
) -> None:
    """Each parameter is changed in turn; the outputs that move are those that say so."""
    root = xml(fmus, model)
    names = [v.name for v in VARIABLES]
    declared = {
        names[int(unknown.get("index", "0")) - 1]: {
            names[int(place) - 1] for place in unknown.get("dependencies", "").split()
        }
        for unknown in root.findall("ModelStructure/InitialUnknowns/Unknown")
    }
    assert set(declared) == {v.name for v in OUTPUTS}
    start: dict[str, Any] = {"initial.sway_angle": 0.3, "chain.EA": 1e3, "chain.elements": 7}
    start["damping.air"] = 0.1
    base = crane_class(*settings(start, 1e-3)).outputs()  # of a tolerance of 1e-3, if asked for
    found: dict[str, set[str]] = {name: set() for name in declared}
    for variable in VARIABLES:
        if variable.causality != "parameter":
            continue
        value = start.get(variable.name, variable.start)
        if variable.kind == "String":
            more = variable.choices[-1]
        else:
            more = value + 2 if variable.kind == "Integer" else value * 1.07 + 1e-3
        moved = crane_class(*settings(start | {variable.name: more}, 1e-3)).outputs()
        for name in declared:
            if abs(moved[name] - base[name]) > 1e-9 * max(1.0, abs(base[name])):
                found[name].add(variable.name)
    assert found == declared


def test_outputs_do_not_depend_on_inputs_at_their_own_instant(fmus: Path) -> None:
    for model in MODELS:
        unknowns = xml(fmus, model).findall("ModelStructure/Outputs/Unknown")
        assert len(unknowns) == len(OUTPUTS)
        assert {unknown.get("dependencies") for unknown in unknowns} == {""}
