"""Rung 12, the installation: wheel, source distribution, and the command that builds."""

import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from conftest import ROOT

from chaincrane_builder import command, compile_c
from chaincrane_driver import __main__ as program


def load_backend() -> ModuleType:
    spec = importlib.util.spec_from_file_location("backend", ROOT / "packaging" / "backend.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def wheel(fmus: Path, native_fmus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel's content; the FMUs in it are those that the other tests have built already."""
    backend = load_backend()
    folder = tmp_path_factory.mktemp("wheel")

    run = subprocess.run

    def built_already(arguments: list[str], **more: Any) -> None:
        scratch = Path(more["env"]["TMPDIR"])  # what the compiler leaves there is gone with it
        assert scratch.parent == Path(tempfile.gettempdir())
        if arguments[1:3] != ["build_fmu.py", "--dest"]:
            run(arguments, **more)
            return
        source = native_fmus if "--native" in arguments else fmus
        shutil.copytree(source, arguments[3], dirs_exist_ok=True)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(backend.subprocess, "run", built_already)
        name = backend.build_wheel(str(folder))
    assert name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(folder / name) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


def run_in(wheel: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """chaincrane as the wheel has it, in a folder, with no home that could be written."""
    no_home = wheel.parent / "no_home"
    no_home.touch()  # a file
    return subprocess.run(
        [sys.executable, "-m", "chaincrane_driver", *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(wheel), "HOME": str(no_home)},
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_a_wheel_works_anywhere(wheel: Path, fmus: Path, tmp_path: Path) -> None:
    done = run_in(wheel, tmp_path, "check", "payload_push")  # its scenarios, its FMUs
    assert "4 runs as their references, 0 not" in done.stdout, done.stderr
    assert not list(tmp_path.iterdir())
    (tmp_path / "empty").mkdir()
    done = run_in(wheel, tmp_path, "check", "payload_push", "--fmus", "empty")
    assert "empty/crane_nl.fmu: no such FMU" in done.stdout  # that folder was asked for
    done = run_in(wheel, tmp_path, "build")
    assert done.returncode == 0, done.stderr
    assert str(wheel) in done.stderr  # copied, not compiled
    assert "crane_lin.fmu: valid" in done.stdout and "runs on linux64, win64" in done.stdout
    for fmu in fmus.glob("*.fmu"):
        assert (tmp_path / fmu.name).read_bytes() == fmu.read_bytes()
    (tmp_path / "crane_nl.fmu").unlink()
    done = run_in(wheel, tmp_path, "run", "payload_push")
    assert done.stderr == "chaincrane: crane_nl.fmu is not here: taking the one that came with it\n"
    assert (tmp_path / "results" / "payload_push" / "comparison.pdf").exists()


def test_a_wheel_can_build_anew(wheel: Path, fmus: Path, tmp_path: Path) -> None:
    """From the sources in it, to the same bytes: crane_lin has no C, so it is quick."""
    done = run_in(wheel, tmp_path, "build", "--compile", "crane_lin")
    assert "packing" in done.stderr, done.stderr
    assert (tmp_path / "crane_lin.fmu").read_bytes() == (fmus / "crane_lin.fmu").read_bytes()


def test_the_licence_is_named_as_spdx_does(wheel: Path) -> None:
    (metadata,) = wheel.glob("*.dist-info/METADATA")
    assert "\nLicense-Expression: MIT\n" in metadata.read_text()
    assert list(wheel.glob("*.dist-info/licenses/LICENSE"))
    assert "ziglang" not in metadata.read_text().partition("Provides-Extra")[0]


def test_a_source_distribution_has_every_file(tmp_path: Path) -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("not a git checkout")
    before = sorted(path.name for path in ROOT.iterdir())
    with tarfile.open(tmp_path / load_backend().build_sdist(str(tmp_path))) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    tracked = {name for name in listed.stdout.splitlines() if not name.startswith(".")}
    assert tracked - names == set()
    assert sorted(path.name for path in ROOT.iterdir()) == before  # it may be read-only


def test_version() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "chaincrane_driver", "--version"], capture_output=True, text=True
    )
    assert done.stdout.startswith("chaincrane 0.1.0 (FMPy 0.3.32, Python 3.")


# --- building -----------------------------------------------------------------------------------


def test_without_a_home_the_compilers_cache_is_temporary(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.delenv("ZIG_GLOBAL_CACHE_DIR", raising=False)
    for variable, value in (("XDG_CACHE_HOME", tmp_path), ("XDG_CACHE_HOME", tmp_path / "file")):
        monkeypatch.setenv(variable, str(value))
        compile_c._zig_cache.cache_clear()
        assert ("ZIG_GLOBAL_CACHE_DIR" in compile_c._zig_cache()) == (value != tmp_path)
    compile_c._zig_cache.cache_clear()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["crane_nll"], "no such model: crane_nll"),
        (["--dest", "FILE/more"], "is not a folder"),
        (["--dest", "FILE"], "is not a folder"),
    ],
)
def test_what_cannot_be_built_is_one_line_at_once(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], says: str
) -> None:
    (tmp_path / "file").touch()
    given = [one.replace("FILE", str(tmp_path / "file")) for one in arguments]
    try:
        code: object = command.main(given)
    except SystemExit as end:
        code = end.code
    errors = capsys.readouterr().err
    assert code == 2 and says in errors and errors.count("\n") == 1


class Stopped(ModuleType):
    """A module at whose import Ctrl-C comes."""

    def __getattr__(self, name: str) -> Any:
        raise KeyboardInterrupt


@pytest.mark.parametrize("module", ["chaincrane_driver.cli", "chaincrane_builder"])
def test_stopped_while_it_is_loaded_is_one_line(
    module: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, Stopped(module))
    monkeypatch.setattr(sys, "argv", ["chaincrane", "build"])
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    assert program.main() == 2
    assert capsys.readouterr().err == "chaincrane: stopped\n"


def build_fails(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> tuple[int, str]:
    def fail(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr(command, "build", fail)
    before = os.environ.get("TMPDIR"), tempfile.gettempdir()
    code = command.main(["crane_lin"])
    assert (os.environ.get("TMPDIR"), tempfile.gettempdir()) == before
    return code, capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (OSError(28, "No space left on device", "crane_lin.part"), "crane_lin.part: No space left"),
        (OSError(28, "No space left on device"), f"into {Path.cwd()}: No space left on device"),
        (KeyboardInterrupt(), "chaincrane: stopped"),
        (
            subprocess.CalledProcessError(1, "zig", stderr="x\nerror: unable: NoSpaceLeft\ny"),
            "no space left on the disk (error: unable: NoSpaceLeft)",
        ),
        (subprocess.CalledProcessError(1, "zig", stderr="AccessDenied"), "cannot be written"),
    ],
)
def test_what_stops_a_build_is_one_line(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    error: BaseException,
    says: str,
) -> None:
    code, text = build_fails(capsys, monkeypatch, error)
    assert code == 2
    (line,) = text.splitlines()
    assert line.startswith("chaincrane: ") and says in line


def test_a_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: zipfile.ZipFile, *_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(zipfile.ZipFile, "writestr", full)
    monkeypatch.setattr(command, "_problems", lambda fmu: [])
    assert command.main(["crane_nl", "--dest", str(tmp_path / "out")]) == 2
    assert not list((tmp_path / "out").iterdir()) if (tmp_path / "out").exists() else True


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is no signal there")
@pytest.mark.parametrize(
    ("job", "sign", "later"),
    [
        ("run", signal.SIGINT, 0.5),
        ("build", signal.SIGINT, 0.5),
        ("run", signal.SIGTERM, 0.5),
        ("check", signal.SIGINT, 0.0),
        ("check", signal.SIGTERM, 0.0),
    ],
)
def test_ctrl_c_is_one_line_and_leaves_nothing(
    fmus: Path, tmp_path: Path, job: str, sign: signal.Signals, later: float
) -> None:
    """A minute-long run, and a build with a cold cache, stopped in the middle.

    And a check, as soon as its workers are started: it is then still being loaded.
    """
    temporary, out = tmp_path / "tmp", tmp_path / "out"
    temporary.mkdir()
    out.mkdir()
    commands = {
        "build": ["build", "crane_nl"],
        "run": ["antisway", "--stop", "600", "--fmus", str(fmus)],
        "check": ["check", "--fmus", str(fmus), "--scenarios", str(ROOT / "scenarios")],
    }
    worker = subprocess.Popen(
        [sys.executable, "-m", "chaincrane_driver", *commands[job]],
        cwd=out,
        env={**os.environ, "TMPDIR": str(temporary), "ZIG_GLOBAL_CACHE_DIR": str(tmp_path / "zig")},
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,  # the signal goes to its workers too, as a terminal's does
    )
    for _ in range(300):
        depth = len(list(temporary.glob("*/*")))
        if depth:
            break
        time.sleep(0.1 if later else 0.01)
    time.sleep(later)
    if sign == signal.SIGINT:
        os.killpg(worker.pid, sign)
    else:
        worker.send_signal(sign)
    _, errors = worker.communicate(timeout=60)
    lines = [line for line in errors.splitlines() if not line.endswith(" ...")]
    assert lines == ["chaincrane: stopped"], errors
    assert not list(temporary.iterdir())
    assert not [path for path in out.rglob("*") if path.suffix in (".part", ".fmu")]


# --- what an FMU says of itself -----------------------------------------------------------------


def test_an_fmus_page_says_what_it_needs(fmus: Path, native_fmus: Path) -> None:
    """The packages that its slave asks for, and the twin that needs none."""
    for fmu in [*fmus.glob("*.fmu"), *native_fmus.glob("*.fmu")]:
        with zipfile.ZipFile(fmu) as archive:
            page = archive.read("documentation/index.html").decode()
        (needs,) = re.findall(r"<h2>What it needs</h2>\n<p>(.*)</p>", page)
        if fmu.stem.endswith("_native"):
            assert needs.startswith("Nothing") and "macOS" in needs
            continue
        assert "Python 3.10" in needs and "on Linux or Windows" in needs
        slave = (ROOT / "fmu_src" / f"{fmu.stem}.py").read_text()
        asked = re.findall(r"require\((.*?)\)", slave)
        packages = re.findall(r'"(\w+)"', asked[0]) if asked else []
        for package in packages:
            assert package in needs.lower()
        assert (f"{fmu.stem}_native.fmu" in needs) == fmu.stem.startswith(("crane_nl", "crane_lin"))
