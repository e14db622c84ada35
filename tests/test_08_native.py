"""Rung 8, native FMUs. References: the Python FMUs and models, and FMI 2.0's text.

The host of the middle part, native_host.c, has no Python in its process.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import PAYLOADS, ROOT, compiler, in_fresh_process, linux_host, paper_motion
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from native_speed import Bench
from test_08_hosts import _resets, linux

from chaincrane.plant.command import Command
from chaincrane.plant.interface import OUTPUTS
from chaincrane.plant.kernel import NativeCrane
from chaincrane.plant.linear import LinearCrane
from chaincrane.plant.parameters import Crane, Damping, Initial, Numerics, Payload
from chaincrane_builder.pack import build
from chaincrane_driver.cli import main
from chaincrane_driver.processes import simulate_all
from chaincrane_driver.scenario import find
from chaincrane_driver.simulate import Job

TWINS = {"crane_nl_native": "crane_nl", "crane_lin_native": "crane_lin"}
NATIVE = tuple(TWINS)
both = pytest.mark.parametrize("model", NATIVE)
WINE = "CHAINCRANE_WINE"  # Debian's /usr/lib/wine/wine64, say


def within(name: str) -> float:
    """What a native output may differ from its twin's: 1e-9 m, and what goes with it.

    As in tolerances.toml: a force turns 1e-14 m into 1e-6 N in a stiff chain.
    """
    if name.startswith(("trolley.fx", "chain.tension")):
        return 2e-6
    return 2e-8 if name.startswith("payload.v") or name.endswith("_angle") else 1e-9


# --- the same crane ---------------------------------------------------------------------------


@both
def test_fmpy_validates(native_fmus: Path, model: str) -> None:
    assert validate_fmu(str(native_fmus / f"{model}.fmu")) == []


@both
def test_it_agrees_with_its_python_twin_on_every_scenario(
    fmus: Path, native_fmus: Path, model: str
) -> None:
    """At every communication point, every output: positions to 1e-9 m."""
    twin = TWINS[model]
    pairs = [
        (one.job(run, fmus / run.fmu), one.job(run, native_fmus / f"{model}.fmu"))
        for one in find(ROOT / "scenarios")
        for run in one.runs
        if run.fmu == f"{twin}.fmu"
    ]
    assert len(pairs) >= 6
    results = simulate_all([job for pair in pairs for job in pair], model)
    for theirs, ours in zip(results[::2], results[1::2], strict=True):
        assert ours.dtype == theirs.dtype and len(ours) == len(theirs) > 800
        for variable in OUTPUTS:
            name = variable.name
            away = np.abs(ours[name].astype(float) - theirs[name]).max()
            assert away <= (0 if name == "solver.steps" else within(name)), name


@both
def test_chaincrane_check_passes(
    native_fmus: Path, model: str, capsys: pytest.CaptureFixture[str]
) -> None:
    fmu = str(native_fmus / f"{model}.fmu")
    assert main(["check", "--scenarios", str(ROOT / "scenarios"), "--fmu", fmu]) == 0
    assert "DIFFERS" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("elements", "mass", "air", "kind"),
    [
        (1, 0.22, 0.0, "consistent"),
        (2, 0.22, 0.1, "averaged"),
        (7, 1e-9, 0.0, "consistent"),
        (10, 0.22, 3.0, "consistent"),  # the payload's swing is nearly critically damped
        (10, 0.22, 30.0, "averaged"),
        (200, 0.22, 0.1, "consistent"),
        (200, 22.0, 0.0, "averaged"),
    ],
)
def test_linear_crane_in_c_is_the_numpy_model(
    native_fmus: Path, elements: int, mass: float, air: float, kind: str
) -> None:
    """Its modes come by another way than LAPACK's; jumps, a ramp and a push, to 1e-9 m, J."""
    names = ["time", "trolley.v_cmd", "trolley.a_cmd", "payload.fx"]
    rows = [(0, 0.8, 0, 0), (0.5, 0.8, 0, 0), (0.5, 0, -0.3, 2), (1.5, 0, -0.3, 2)]
    rows += [(1.5, 0.2, 0, 0), (3, 0.2, 0, 0)]
    inputs = np.array(rows, dtype=[(name, float) for name in names])
    start = {
        "chain.elements": elements,
        "chain.mass": mass,
        "damping.air": air,
        "chain.mass_matrix": kind,
        "initial.sway_angle": 0.2,
        "payload.mass": 0.07,
    }
    job = Job(native_fmus / "crane_lin_native.fmu", start, inputs, 3.0, 0.005)
    (result,) = simulate_all([job], "linear")
    chain = type(Crane().chain)(0.8, mass)
    crane = LinearCrane(
        Crane(chain=chain, payload=Payload(0.07), damping=Damping(air)),
        Initial(0.8, 0.2),
        Numerics(elements, mass_matrix=kind),
    )
    commands = [
        Command(trolley_v_cmd=0.8),
        Command(trolley_a_cmd=-0.3, payload_fx=2.0),
        Command(trolley_v_cmd=0.2),
    ]
    for step, row in enumerate(result):
        for name, value in crane.outputs().items():
            assert abs(row[name] - value) <= within(name), (step, name)
        if step < 600:
            crane.step(0.005, commands[(step >= 100) + (step >= 300)])


def _many_elements(fmu: str, elements: int) -> list[float]:
    from time import perf_counter

    from slave_host import Host

    started = perf_counter()
    host = Host(fmu, chain__elements=elements, initial__speed=0.0, initial__sway_angle=0.1)
    took = perf_counter() - started
    host.run(100)
    return [took, host.get("payload.x_rel"), host.get("energy.error"), host.get("energy.total")]


def test_linear_crane_copes_with_many_elements(native_fmus: Path) -> None:
    """What was released is released, and its energy stays; O(n^2), 35 s for 10 000 by hand."""
    fmu = str(native_fmus / "crane_lin_native.fmu")
    took, x, error, energy = in_fresh_process(_many_elements, fmu, 500)
    crane = LinearCrane(None, Initial(0.0, 0.1), Numerics(500))
    for _ in range(100):
        crane.step(0.01)
    assert x == pytest.approx(crane.outputs()["payload.x_rel"], abs=1e-9)
    assert abs(error) < 1e-9 * energy
    assert took < 10.0  # 0.1 s on an idle machine


def _words(fmu: str, bad: list[list[Any]]) -> list[str]:
    from slave_host import LOG, Host

    said = []
    for name, value in bad:
        host = Host(fmu, initialise=False)
        host.slave.setupExperiment(startTime=0.0)
        value = float(value) if isinstance(value, str) and name != "solver.scheme" else value
        host.set(name, value)
        try:
            host.slave.enterInitializationMode()
            host.slave.exitInitializationMode()
            host.step()
        except Exception:
            pass
        said.append(LOG[-1].split(": ", 1)[1])
        host.close()
    return said


def _noticed(fmu: str) -> list[str]:
    from slave_host import LOG, Host

    start: dict[str, Any] = {"payload.mass": 0.01, "chain.EA": 1e8, "chain.elements": 5}
    start |= {"initial.speed": 0.0, "solver.max_step": 2e-3}
    start |= {"solver.error_estimate": "companion"}
    host = Host(fmu, initialise=False)
    host.initialise(**{name.replace(".", "__"): value for name, value in start.items()})
    host.set("trolley.v_cmd", 2.0)
    host.run(100)
    host.set("trolley.v_cmd", 0.0)
    host.run(100)
    return LOG


def test_a_motion_that_is_not_predictable_is_said_once(fmus: Path, native_fmus: Path) -> None:
    files = fmus / "crane_nl.fmu", native_fmus / "crane_nl_native.fmu"
    theirs, ours = (in_fresh_process(_noticed, str(fmu)) for fmu in files)
    assert len(ours) == 1 and ours == theirs
    assert re.fullmatch(r"logStatusWarning: at t = .* s: .* the motion is not predictable.*", *ours)


def test_it_refuses_in_the_same_words(fmus: Path, native_fmus: Path) -> None:
    bad = [
        ["chain.mass", -1.0],
        ["chain.length", "nan"],
        ["chain.EA", "inf"],
        ["damping.air", -1.2345678901234567e-5],
        ["initial.sway_angle", -3.2],
        ["initial.speed", "-inf"],
        ["chain.elements", 0],
        ["chain.elements", 10_001],
        ["solver.max_step", -1e22],
        ["solver.scheme", "euler"],
        ["trolley.v_cmd", "nan"],
        ["trolley.v_cmd", 1.7e308],
        ["trolley.v_cmd", 123456789.0],
        ["payload.fx", "inf"],
    ]
    for model, twin in TWINS.items():
        ours = in_fresh_process(_words, str(native_fmus / f"{model}.fmu"), bad)
        assert ours == in_fresh_process(_words, str(fmus / f"{twin}.fmu"), bad)


# --- a host in C ------------------------------------------------------------------------------


class CHost:
    """native_host.c, compiled against an FMU's sources, and how to call it."""

    def __init__(self, fmus: Path, folder: Path) -> None:
        self.folder = folder
        self.libraries: list[str] = []
        self.guids: list[str] = []
        for model in NATIVE:
            with zipfile.ZipFile(fmus / f"{model}.fmu") as archive:
                archive.extractall(folder / model)
            self.guids.append(read_model_description(str(fmus / f"{model}.fmu")).guid)
            self.libraries.append(f"{model}/binaries/linux64/{model}.so")
        self.host = self.compile("host")

    def compile(self, name: str, *flags: str) -> str:
        """Compile the host; its path."""
        source = str(Path(__file__).parent / "native_host.c")
        warnings = ["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-D_POSIX_C_SOURCE=200809L"]
        command = ["-std=c99", "-O1", "-g", *warnings, *flags, "-I", f"{NATIVE[0]}/sources"]
        self.run([str(compiler), *command, source, "-o", name, "-ldl", "-lpthread", "-lm"])
        return str(self.folder / name)

    def run(self, command: list[str], **environment: str) -> str:
        """Run a command in the folder; its output."""
        env = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")} | environment
        done = subprocess.run(
            command, cwd=self.folder, capture_output=True, text=True, timeout=600, env=env
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def task(self, *task: str, before: tuple[str, ...] = ()) -> str:
        """Run one of the host's tasks."""
        name, *more = task
        fmus = [word for pair in zip(self.libraries, self.guids, strict=True) for word in pair]
        return self.run([*before, self.host, name, *fmus, *more])


@pytest.fixture(scope="module")
def c_host(native_fmus: Path, tmp_path_factory: pytest.TempPathFactory) -> CHost:
    """In a folder with a space, an umlaut and percent signs."""
    return CHost(native_fmus, tmp_path_factory.mktemp("ein Krän 100%20"))


TASKS = [("threads",), ("cycles", "1000"), ("calls",)]
tasks = pytest.mark.parametrize("task", TASKS, ids=lambda task: task[0])


@linux_host
def test_c_host_runs_the_papers_scenario(c_host: CHost, fmus: Path) -> None:
    c_host.task("run", "out.csv")
    rows = np.loadtxt(c_host.folder / "out.csv", delimiter=",")
    jobs = [
        Job(fmus / f"{twin}.fmu", {"payload.mass": PAYLOADS["heavy"]}, paper_motion(), 4.0, 0.005)
        for twin in TWINS.values()
    ]
    names = ("payload.x_rel", "payload.x", "chain.mid_x_rel")
    for block, result in enumerate(simulate_all(jobs, "paper")):
        for column, name in enumerate(names):
            ours = rows[:, 1 + 3 * block + column]
            assert np.abs(ours - result[name][1:]).max() < 1e-9, name


@linux_host
@tasks
def test_c_host(c_host: CHost, task: tuple[str, ...]) -> None:
    """8 instances in 8 threads; 1000 load and unload cycles; every other call."""
    assert c_host.task(*task) == f"{task[0]}: done\n"


@linux_host
def test_c_host_restores_bytes_in_another_process(c_host: CHost) -> None:
    c_host.task("save", "bytes")
    c_host.task("load", "bytes")


@linux_host
@pytest.mark.parametrize("task", [("threads",), ("cycles", "30"), ("calls",)], ids=lambda t: t[0])
def test_c_host_is_clean_under_valgrind(c_host: CHost, task: tuple[str, ...]) -> None:
    """No invalid access, nothing left. 30 cycles: 1000 take three minutes, and are as clean."""
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        pytest.skip("valgrind is not installed (Debian: valgrind)")
    leaks = ("--leak-check=full", "--show-leak-kinds=all", "--errors-for-leak-kinds=all")
    c_host.task(*task, before=(valgrind, "-q", "--error-exitcode=9", *leaks))


@pytest.fixture(scope="module")
def sanitised(native_fmus: Path, tmp_path_factory: pytest.TempPathFactory) -> CHost:
    """Host and FMUs compiled from their sources with AddressSanitizer and UBSan."""
    host = CHost(native_fmus, tmp_path_factory.mktemp("sanitised"))
    flags = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    try:
        host.host = host.compile("host_sanitised", *flags)
    except AssertionError as error:
        pytest.skip(f"this compiler has no sanitisers: {error}")
    for place, model in enumerate(NATIVE):
        sources = [str(p) for p in sorted((host.folder / model / "sources").glob("*.c"))]
        library = f"./{model}_sanitised.so"
        command = [str(compiler), "-std=c99", "-O1", "-g", "-fPIC", "-shared", *flags, *sources]
        host.run([*command, "-o", library, "-lm"])
        host.libraries[place] = library
    return host


@linux_host
@pytest.mark.parametrize("task", [("run", "out.csv"), *TASKS], ids=lambda task: task[0])
def test_c_host_is_clean_under_sanitisers(sanitised: CHost, task: tuple[str, ...]) -> None:
    sanitised.task(*task)


@linux_host
def test_a_step_costs_little_more_than_the_bare_kernel(tmp_path: Path) -> None:
    """1 ms doStep, 3 inputs set, 7 outputs read, from C: at most 1.3 times the kernel's step."""
    bench = Bench("crane_nl_native", tmp_path)
    one = next(one for one in find(ROOT / "scenarios") if one.name == "paper_heavy")
    run = next(run for run in one.runs if run.fmu == "crane_nl.fmu")
    times = bench.times(one.job(run, Path()), rounds=5)
    assert times.ratio <= 1.3, times
    assert times.steps == 1 and times.iterations <= 12
    assert times.worst < 200.0  # us of the 1000 there are; about 4 on an idle machine


# --- binaries and sources ---------------------------------------------------------------------


def entries(fmu: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(fmu) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def exports_of_dll(content: bytes) -> tuple[set[str], set[str]]:
    """Names that a 64-bit Windows library exports, and the libraries that it imports."""

    def word(at: int, size: int) -> int:
        return int.from_bytes(content[at : at + size], "little")

    pe = word(0x3C, 4)
    assert content[pe : pe + 6] == b"PE\0\0\x64\x86"
    sections, optional = word(pe + 6, 2), pe + 24
    table = optional + word(pe + 20, 2)

    def place(address: int) -> int:
        for at in range(table, table + 40 * sections, 40):
            if 0 <= address - word(at + 12, 4) < max(word(at + 8, 4), word(at + 16, 4)):
                return address - word(at + 12, 4) + word(at + 20, 4)
        raise AssertionError(f"no section has {address:#x}")

    def text(address: int) -> str:
        at = place(address)
        return content[at : content.index(b"\0", at)].decode()

    export, imported = place(word(optional + 112, 4)), place(word(optional + 120, 4))
    names = place(word(export + 32, 4))
    found = {text(word(names + 4 * i, 4)) for i in range(word(export + 24, 4))}
    libraries = set()
    while word(imported + 12, 4):
        libraries.add(text(word(imported + 12, 4)))
        imported += 20
    return found, libraries


def fmi_functions(headers: bytes) -> set[str]:
    """Names of the functions that FMI 2.0 asks of a co-simulation FMU."""
    names = set(re.findall(rb"\bfmi2(?!.*TYPE)\w+(?=TYPE fmi2\w+;)", headers)) or set(
        re.findall(rb"FMI2_Export fmi2\w+TYPE\s+(fmi2\w+);", headers)
    )
    model_exchange = (
        "EnterEventMode NewDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep SetTime"
        " SetContinuousStates GetDerivatives GetEventIndicators GetContinuousStates"
        " GetNominalsOfContinuousStates"
    )
    return {name.decode() for name in names} - {f"fmi2{name}" for name in model_exchange.split()}


@both
def test_the_windows_library_exports_all_of_fmi(native_fmus: Path, model: str) -> None:
    """Linked and looked at, not run on Windows. It asks for ucrtbase.dll, part of Windows 10."""
    files = entries(native_fmus / f"{model}.fmu")
    found, libraries = exports_of_dll(files[f"binaries/win64/{model}.dll"])
    expected = fmi_functions(files["sources/fmi2Functions.h"])
    assert len(expected) == 34
    assert found == expected
    assert libraries == {"ucrtbase.dll"}


@both
def test_the_linux_library_needs_an_old_c_library_alone(native_fmus: Path, model: str) -> None:
    """glibc 2.17 is RHEL 7's; RHEL 8 has 2.28."""
    library = entries(native_fmus / f"{model}.fmu")[f"binaries/linux64/{model}.so"]
    versions = {tuple(map(int, v.split(b"."))) for v in re.findall(rb"GLIBC_([\d.]+)", library)}
    assert versions and max(versions) <= (2, 17)
    assert set(re.findall(rb"lib[\w+-]+\.so[\w.]*", library)) <= {b"libc.so.6", b"libm.so.6"}


@both
def test_the_mac_library_has_all_of_fmi(native_fmus: Path, model: str) -> None:
    files = entries(native_fmus / f"{model}.fmu")
    library = files[f"binaries/darwin64/{model}.dylib"]
    assert library[:4] == b"\xcf\xfa\xed\xfe"  # Mach-O, 64 bits
    for name in fmi_functions(files["sources/fmi2Functions.h"]):
        assert f"_{name[:4]}".encode() in library


@both
def test_the_xml_says_what_the_native_fmu_can(native_fmus: Path, fmus: Path, model: str) -> None:
    """The same interface as the Python FMU's, and more capabilities."""
    ours, theirs = (
        ElementTree.fromstring(entries(fmu)["modelDescription.xml"])
        for fmu in (native_fmus / f"{model}.fmu", fmus / f"{TWINS[model]}.fmu")
    )
    for part in ("ModelVariables", "ModelStructure", "UnitDefinitions", "LogCategories"):
        one, other = ours.find(part), theirs.find(part)
        assert one is not None and other is not None
        assert ElementTree.tostring(one) == ElementTree.tostring(other)
    simulation = ours.find("CoSimulation")
    assert simulation is not None
    assert simulation.get("canInterpolateInputs") == "true"
    assert simulation.get("needsExecutionTool") == "false"
    assert simulation.get("modelIdentifier") == model
    files = entries(native_fmus / f"{model}.fmu")
    for file in simulation.findall("SourceFiles/File"):
        assert f"sources/{file.get('name')}" in files
    assert not [name for name in files if name.endswith(".py") or "resources" in name]


def test_the_same_sources_give_the_same_bytes(native_fmus: Path, tmp_path: Path) -> None:
    again = build("crane_lin_native", tmp_path)
    assert again.read_bytes() == (native_fmus / again.name).read_bytes()


@both
def test_fmpy_compiles_the_sources(native_fmus: Path, tmp_path: Path, model: str) -> None:
    """`fmpy compile`, for platforms that have no binary: the same run, to 1e-9 m."""
    if shutil.which("cmake") is None or compiler is None:
        pytest.skip("fmpy compile needs cmake and a C compiler")
    source, fmu = native_fmus / f"{model}.fmu", tmp_path / f"{model}.fmu"
    with zipfile.ZipFile(fmu, "w") as archive:
        for name, content in entries(source).items():
            if not name.startswith("binaries/"):
                archive.writestr(name, content)
    # FMPy does not link the mathematical library, which a host that is no Python may lack
    linked = {"LDFLAGS": "-Wl,--no-as-needed -lm"} if sys.platform.startswith("linux") else {}
    command = [sys.executable, "-m", "fmpy", "compile", str(fmu)]
    subprocess.run(command, check=True, env=os.environ | linked)
    if linked:
        (library,) = (c for n, c in entries(fmu).items() if n.endswith(f"linux64/{model}.so"))
        assert b"libm.so.6" in library
    jobs = [Job(file, {}, paper_motion(), 4.0, 0.005) for file in (source, fmu)]
    shipped, compiled = simulate_all(jobs, "compiled")
    assert np.abs(shipped["payload.x"] - compiled["payload.x"]).max() < 1e-9


@linux_host
def test_two_fmus_fit_into_one_program(c_host: CHost, native_fmus: Path) -> None:
    """Compiled by another than us, with FMI2_FUNCTION_PREFIX and all warnings as errors.

    Without the prefix a library exports FMI's functions alone, though nothing hides the others.
    """
    warnings = ["-std=c99", "-O2", "-fPIC", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    objects: list[str] = []
    for model in NATIVE:
        sources = [str(p) for p in sorted((c_host.folder / model / "sources").glob("*.c"))]
        for source in sources:
            objects.append(f"{model}_{Path(source).stem}.o")
            prefix = f"-DFMI2_FUNCTION_PREFIX={model}_"
            c_host.run([str(compiler), *warnings, prefix, "-c", source, "-o", objects[-1]])
        command = [str(compiler), *warnings, "-shared", *sources, "-o", f"{model}_bare.so", "-lm"]
        c_host.run(command)
        listed = c_host.run(["nm", "-D", "--defined-only", f"{model}_bare.so"])
        exported = {line.split()[-1] for line in listed.splitlines()}
        files = entries(native_fmus / f"{model}.fmu")
        assert exported == fmi_functions(files["sources/fmi2Functions.h"])
    main_c = str(Path(__file__).parent / "two_fmus.c")
    guids = zip(("NL", "LIN"), c_host.guids, strict=True)
    defined = [f'-D{name}_GUID="{guid}"' for name, guid in guids]
    sources_of_both = f"{NATIVE[0]}/sources"  # their interface is the same
    command = [str(compiler), *warnings, *defined, "-I", sources_of_both, main_c, *objects]
    c_host.run([*command, "-o", "two_fmus", "-lm"])
    together = list(map(float, c_host.run(["./two_fmus"]).split()))
    alone = [in_fresh_process(_half_a_second, str(native_fmus / f"{m}.fmu")) for m in NATIVE]
    assert together == pytest.approx(alone, abs=1e-12)
    assert abs(alone[0] - alone[1]) > 1e-4


def _half_a_second(fmu: str) -> float:
    from slave_host import Host

    host = Host(fmu)
    assert host.step(0.5) == 0
    return float(host.get("payload.x_rel"))


# --- strange hosts ----------------------------------------------------------------------------


def _strange_folder(fmu: str, folder: str) -> float:
    import zipfile
    from pathlib import Path

    from fmpy import read_model_description
    from fmpy.fmi2 import FMU2Slave

    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder)
    description = read_model_description(fmu)
    slave = FMU2Slave(
        guid=description.guid,
        unzipDirectory=folder,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName=Path(folder).name,
    )
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    slave.doStep(currentCommunicationPoint=0.0, communicationStepSize=0.5)
    names = {v.name: v.valueReference for v in description.modelVariables}
    (x,) = slave.getReal([names["payload.x"]])
    slave.freeInstance()
    return float(x)


@both
@pytest.mark.parametrize("name", ["two words", "Krän", "100%", "a%20b%zz%s%n"])
def test_paths_do_not_matter(native_fmus: Path, tmp_path: Path, model: str, name: str) -> None:
    folder = tmp_path / name
    folder.mkdir()
    fmu = folder / f"{model} {name}.fmu"
    shutil.copy(native_fmus / f"{model}.fmu", fmu)
    plain = in_fresh_process(
        _strange_folder, str(native_fmus / f"{model}.fmu"), str(tmp_path / "plain")
    )
    assert in_fresh_process(_strange_folder, str(fmu), str(folder / "in")) == plain


def _loaded_with_python_twin(native: str, python: str) -> list[float]:
    from slave_host import Host

    hosts = [Host(fmu) for fmu in (native, python)]
    for host in hosts:
        host.run(30)
    return [host.get("payload.x_rel") for host in hosts]


@both
def test_it_lives_beside_its_python_twin(fmus: Path, native_fmus: Path, model: str) -> None:
    files = native_fmus / f"{model}.fmu", fmus / f"{TWINS[model]}.fmu"
    ours, theirs = in_fresh_process(_loaded_with_python_twin, *map(str, files))
    assert ours == pytest.approx(theirs, abs=1e-12)


def _push_and_brake(fmu: str) -> list[float]:
    from slave_host import Host

    host = Host(fmu, payload__mass=0.07)
    host.set("trolley.v_cmd", 0.8)
    host.run(100)
    host.set("trolley.a_cmd", -0.5)
    host.set("payload.fx", 0.2)
    return host.run(100)[-1]


def test_the_fmu_is_the_kernel_bit_for_bit(native_fmus: Path, library: Any) -> None:
    crane = NativeCrane(Crane(payload=Payload(0.07)), library=library)
    for step in range(200):
        pushed = {} if step < 100 else {"trolley_a_cmd": -0.5, "payload_fx": 0.2}
        crane.step(0.01, Command(trolley_v_cmd=0.8, **pushed))
    ours = in_fresh_process(_push_and_brake, str(native_fmus / "crane_nl_native.fmu"))
    assert ours == crane.output_values()[: len(ours)]


@linux
@both
def test_ten_thousand_resets(native_fmus: Path, model: str) -> None:
    """The same bits, and no memory grown: 100 kB are FMPy's own."""
    done = in_fresh_process(_resets, str(native_fmus / f"{model}.fmu"), 10_000)
    assert done["same"]
    assert done["grown"] < 100_000


@linux_host
def test_the_windows_library_runs_in_wine(c_host: CHost) -> None:
    """All of the C host's tasks; states saved here go on there, and back.

    zig needs two minutes for the host's start-up code, once.
    """
    wine = os.environ.get(WINE)
    if not wine:
        pytest.skip(f"set {WINE} to wine's path (Debian: /usr/lib/wine/wine64, package wine64)")
    source = str(Path(__file__).parent / "native_host.c")
    zig = [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-windows-gnu", "-O1"]
    c_host.run([*zig, "-I", f"{NATIVE[0]}/sources", source, "-o", "host.exe"])
    fmus = []
    for model, guid in zip(NATIVE, c_host.guids, strict=True):
        shutil.copy(c_host.folder / f"{model}/binaries/win64/{model}.dll", c_host.folder)
        fmus += [f"{model}.dll", guid]
    prefix = {"WINEPREFIX": str(c_host.folder / "prefix"), "WINEDEBUG": "-all"}
    c_host.task("run", "linux.csv")
    c_host.task("save", "linux")
    for name, *more in (("run", "wine.csv"), ("load", "linux"), ("save", "wine"), *TASKS):
        c_host.run([wine, "host.exe", name, *fmus, *more], **prefix)
    c_host.task("load", "wine")
    ours, theirs = (
        np.loadtxt(c_host.folder / name, delimiter=",") for name in ("linux.csv", "wine.csv")
    )
    assert np.abs(ours - theirs).max() < 1e-9
