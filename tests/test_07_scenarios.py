"""Rung 7, the driver and the scenarios. References: our own frozen output, and broken copies."""

import contextlib
import inspect
import io
import json
import os
import re
import shutil
import subprocess
import sys
import time
import zipfile
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT

from chaincrane_driver import cli, places, processes, scenario, stale
from chaincrane_driver.compare import check, difference, reference_rows
from chaincrane_driver.errors import UserError
from chaincrane_driver.processes import simulate_all
from chaincrane_driver.simulate import Job
from chaincrane_driver.tables import read_table, write_table

SCENARIOS = ROOT / "scenarios"
NAMES = [
    "paper_heavy",
    "paper_heavy_from_rest",
    "paper_light",
    "paper_light_from_rest",
    "payload_push",
    "smooth_travel",
]


def chaincrane(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    command = [sys.executable, "-m", "chaincrane_driver.cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=600)


def one_line_error(arguments: list[object], *parts: str) -> None:
    """The command, in this process, ends with 2 and one line on stderr that has these parts."""
    errors = io.StringIO()
    with contextlib.redirect_stderr(errors):
        try:
            code: object = cli.main([str(argument) for argument in arguments])
        except SystemExit as end:
            code = end.code
    assert code == 2, errors.getvalue()
    (line,) = errors.getvalue().strip().splitlines()
    assert line.startswith("chaincrane: ")
    for part in parts:
        assert part in line, line


def test_every_scenario_is_as_its_reference(fmus: Path) -> None:
    done = chaincrane("check", "--fmus", fmus, "--scenarios", SCENARIOS)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "24 runs as their references, 0 not" in done.stdout
    for name in NAMES:
        assert name in done.stdout


def test_check_sees_a_changed_output(fmus: Path, tmp_path: Path) -> None:
    """A payload 1e-4 heavier: found, with how much and when; from another FMU's file."""
    copy = tmp_path / "scenarios" / "payload_push"
    shutil.copytree(SCENARIOS / "payload_push", copy)
    shutil.copy(SCENARIOS / "tolerances.toml", tmp_path / "scenarios")
    text = (copy / "scenario.toml").read_text()
    (copy / "scenario.toml").write_text(text.replace("0.42", "0.420042"))
    done = chaincrane("check", "--fmu", fmus / "crane_nl.fmu", "--scenarios", copy.parent)
    assert done.returncode == 1
    (line,) = [line for line in done.stdout.splitlines() if "nonlinear" in line]
    # one line: the worst signal with its unit and time, and how many more
    assert re.search(
        r"DIFFERS; worst: \S+ off by \S+ (m|rad|m/s|J|N) at t = [\d.]+ s, of \S+ allowed, from",
        line,
    )
    assert re.search(r"; \d\d more signals differ$", line)
    assert "linear, 2 elements" not in done.stdout  # --fmu stands in for its own kind alone


def test_update_makes_references_that_pass(fmus: Path, tmp_path: Path) -> None:
    copy = tmp_path / "scenarios" / "payload_push"
    shutil.copytree(SCENARIOS / "payload_push", copy, ignore=shutil.ignore_patterns("*.csv"))
    shutil.copy(SCENARIOS / "payload_push" / "input.csv", copy)
    shutil.copy(SCENARIOS / "tolerances.toml", copy.parent)
    options = ("check", "--fmus", fmus, "--scenarios", copy.parent)
    assert "has no reference" in chaincrane(*options).stdout
    assert chaincrane(*options, "--update").returncode == 0
    assert chaincrane(*options).returncode == 0


def copied_push(tmp_path: Path, old: str = "", new: str = "") -> Path:
    """A copy of the scenario payload_push with one thing changed; the folder of scenarios."""
    copy = tmp_path / "scenarios" / "payload_push"
    shutil.copytree(SCENARIOS / "payload_push", copy)
    text = (copy / "scenario.toml").read_text()
    assert old in text
    (copy / "scenario.toml").write_text(text.replace(old, new))
    return copy


def test_what_ci_reads(fmus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """JUnit by another reader, JSON by Python's: a run as its reference, one not, one without."""
    junitparser = pytest.importorskip("junitparser")
    copy = copied_push(tmp_path, 'chain.elements" = 2', 'chain.elements" = 3')
    (copy / "reference_massless.csv").unlink()
    files = ["--junit", tmp_path / "out" / "junit.xml", "--json", tmp_path / "out" / "check.json"]
    assert cli.main([str(one) for one in ["check", copy, "--fmus", fmus, *files]]) == 1
    assert "2 runs as their references, 2 not" in capsys.readouterr().out
    (suite,) = junitparser.JUnitXml.fromfile(str(tmp_path / "out" / "junit.xml"))
    assert (suite.name, suite.tests, suite.failures, suite.errors) == ("payload_push", 4, 1, 1)
    kinds = {case.name: [type(one).__name__ for one in case.result] for case in suite}
    assert kinds == {
        "nonlinear, 10 elements": [],
        "linear, 10 elements": [],
        "linear, 2 elements": ["Failure"],
        "massless rope": ["Error"],
    }
    (failure,) = next(case for case in suite if case.name == "linear, 2 elements").result
    assert "payload.x_rel off by" in failure.text
    told = json.loads((tmp_path / "out" / "check.json").read_text())
    assert [one["passed"] for one in told] == [True, True, False, False]
    signals = {one["name"]: one for one in told[2]["signals"]}
    assert signals["payload.x_rel"]["unit"] == "m"
    assert signals["payload.x_rel"]["largest"] > signals["payload.x_rel"]["allowed"] == 1e-9


def test_a_run_that_fails_is_its_own_in_junit(fmus: Path, tmp_path: Path) -> None:
    """Of four runs one crashes its worker, one has an FMU that is none, one refuses its mass."""
    junitparser = pytest.importorskip("junitparser")
    copy = copied_push(tmp_path, "= 2 }", "= 0 }")
    text = (copy / "scenario.toml").read_text()
    text = text.replace("crane_lin.fmu", "cut.fmu", 1)
    (copy / "scenario.toml").write_text("none.fmu".join(text.rsplit("crane_lin.fmu", 1)))
    for name in ("crane_nl.fmu", "crane_lin.fmu"):
        shutil.copy(fmus / name, tmp_path)
    cut_short(fmus / "crane_lin.fmu", tmp_path / "cut.fmu")
    (tmp_path / "none.fmu").write_text("no zip file")
    junit = tmp_path / "junit.xml"
    options = ["check", copy, "--fmus", tmp_path, "--junit", junit]
    assert cli.main([str(one) for one in options]) == 1
    (suite,) = junitparser.JUnitXml.fromfile(str(junit))
    told = {case.name: [one.message for one in case.result] for case in suite}
    assert told.pop("nonlinear, 10 elements") == []
    parts = {
        "linear, 10 elements": "cut.fmu",
        "linear, 2 elements": "chain.elements = 0 is not allowed",
        "massless rope": "none.fmu: not a valid FMU",
    }
    assert told.keys() == parts.keys()
    for name, part in parts.items():
        assert part in told[name][0]


def test_results_of_any_tool_can_be_checked(
    fmus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """CSV files: the references themselves, one of them spoilt, one missing."""
    results = tmp_path / "payload_push"
    results.mkdir()
    one = scenario.load(SCENARIOS / "payload_push")
    for run in one.runs[:3]:
        shutil.copy(one.reference(run), results / f"{run.name}.csv")
    spoilt = read_table(results / "linear_2.csv")
    spoilt["payload.x"][5] += 1e-6
    write_table(results / "linear_2.csv", spoilt)
    options = ["check", one.folder, "--results", tmp_path, "--fmus", tmp_path]
    assert cli.main([str(option) for option in options]) == 1
    nonlinear, linear, spoilt_line, missing, end = capsys.readouterr().out.splitlines()
    assert "ok" in nonlinear and "ok" in linear
    assert "DIFFERS; worst: payload.x off by 1e-06" in spoilt_line
    assert "massless.csv: cannot be read: No such file" in missing
    assert end == "2 runs as their references, 2 not"


def test_an_fmu_of_another_name(fmus: Path, tmp_path: Path) -> None:
    """Its model's name says nothing: --model does."""
    mine = tmp_path / "mine.fmu"
    with zipfile.ZipFile(fmus / "crane_lin.fmu") as source, zipfile.ZipFile(mine, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "modelDescription.xml":
                content = content.replace(b'modelName="crane_lin"', b'modelName="mine"')
            target.writestr(name, content)
    options: list[object] = ["check", SCENARIOS / "payload_push", "--fmu", mine]
    one_line_error(options, "its model is 'mine'", "--model crane_nl or --model crane_lin")
    junit = tmp_path / "junit.xml"
    options += ["--junit", junit]
    one_line_error([*options, "--model", "crane_lim"], "nearest is 'crane_lin'")
    assert 'errors="1"' in junit.read_text()
    assert cli.main([*map(str, options), "--model", "crane_lin"]) == 0


def test_cross_check_form(fmus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Another reader, FMPy's validator of the FMI cross-check, finds no problem; nor does check."""
    from fmpy.cross_check.validate_vendor_repo import validate_test_fmu

    folder = SCENARIOS / "paper_heavy"
    options = ["export", folder, "--fmus", fmus, "--out", tmp_path]
    assert cli.main([str(option) for option in options]) == 0
    text = capsys.readouterr().out
    assert "left out: paper_heavy, linear_2" in text
    written = sorted(path.parent for path in tmp_path.rglob("*_ref.opt"))
    assert {path.name for path in written} == {"paper_heavy_nonlinear", "paper_heavy_linear_10"}
    for path in written:
        assert validate_test_fmu(str(path)) == []
        assert (path / "README.md").exists()
    assert cli.main(["check", "--crosscheck", str(tmp_path)]) == 0
    reference = next(tmp_path.rglob("linux64/**/*nonlinear_ref.csv"))
    lines = reference.read_text().splitlines()
    lines[100] = lines[100].replace("0", "1", 1)
    reference.write_text("\n".join(lines))
    assert cli.main(["check", "--crosscheck", str(tmp_path)]) == 1
    one_line_error([*options, "--run", "linear_2"], "no start values", "chain.elements = 2")


def test_a_nan_is_a_difference() -> None:
    one = scenario.load(SCENARIOS / "payload_push")
    reference = read_table(one.reference(one.runs[0]))
    broken = np.zeros(len(reference), dtype=reference.dtype)
    for name in reference.dtype.names or ():
        broken[name] = reference[name]
    broken["payload.x"][7] = np.nan
    (finding,) = check(one, one.runs[0], broken, reference)
    assert finding.signal == "payload.x"
    assert finding.first == pytest.approx(reference["time"][7])


def test_a_reference_that_lacks_a_signal_is_no_reference() -> None:
    one = scenario.load(SCENARIOS / "payload_push")
    reference = read_table(one.reference(one.runs[0]))
    with pytest.raises(UserError, match=r"no column 'trolley.x'"):
        check(one, one.runs[0], reference, reference[["time"]])


def test_run_writes_results_table_and_pictures(fmus: Path, tmp_path: Path) -> None:
    folder = SCENARIOS / "payload_push"
    done = chaincrane("run", folder, "--fmus", fmus, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "| payload.x_rel   | linear, 2 elements" in done.stdout
    written = {path.name for path in (tmp_path / "payload_push").iterdir()}
    assert written >= {"nonlinear.csv", "linear_2.csv", "comparison.png", "comparison.svg"}
    rows = read_table(tmp_path / "payload_push" / "nonlinear.csv")
    assert len(rows) == 801  # the jump at 0.2 s falls on a regular point


def test_figures(fmus: Path, tmp_path: Path) -> None:
    done = chaincrane("figures", "--fmus", fmus, "--scenarios", SCENARIOS, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    for stem in ("fig4_shapes", "fig5_payload_absolute", "fig6_payload_relative"):
        for suffix in (".png", ".svg"):
            assert (tmp_path / (stem + suffix)).stat().st_size > 10_000
    assert "Light payload" in done.stdout


def test_difference_of_two_runs() -> None:
    kind = [("time", float), ("x", float)]
    truth = np.array([(0, 1.0), (1, -2.0)], dtype=kind)
    other = np.array([(0, 1.3), (1, -2.4)], dtype=kind)
    gap = difference(truth, other, "x")
    assert gap.rms == pytest.approx(np.sqrt(0.5 * (0.09 + 0.16)))
    assert gap.largest_percent == pytest.approx(20.0)


def edited(tmp_path: Path, file: str, old: str, new: str) -> Path:
    """A copy of a scenario with one thing wrong."""
    copy = tmp_path / "paper_heavy"
    shutil.copytree(SCENARIOS / "paper_heavy", copy)
    text = (copy / file).read_text()
    assert old in text
    (copy / file).write_text(text.replace(old, new, 1))
    return copy


@pytest.mark.parametrize(
    ("file", "old", "new", "parts"),
    [
        ("input.csv", "trolley.v_cmd", "trolley.v_cmdd", ["'trolley.v_cmdd' is not an input"]),
        ("input.csv", "1,0.8", "1,abc", ["row 3", "trolley.v_cmd", "'abc'"]),
        ("input.csv", "1,0.8", "1,nan", ["row 3", "'nan'"]),
        ("input.csv", "1,0.8", "1", ["row 3", "1 values for 2 columns"]),
        ("input.csv", "4,0", "0.5,0", ["time goes backwards"]),
        ("input.csv", "time,", "t,", ["'time' first"]),
        ("scenario.toml", "stop_time", "stop_tim", ["no key 'stop_tim'", "nearest is 'stop_time'"]),
        ("scenario.toml", "stop_time = 4.0", "", ["'stop_time' is missing"]),
        ("scenario.toml", "stop_time = 4.0", 'stop_time = "4"', ["'4' is not a finite number"]),
        ("scenario.toml", "[start]", "[starts]", ["no key 'starts'", "nearest is 'start'"]),
        ("scenario.toml", 'label = "massless', 'lable = "', ["run 4", "nearest is 'label'"]),
        ("scenario.toml", '"massless"', '"../massless"', ["must do as a file's name"]),
        ("scenario.toml", '{ "chain.elements" = 2 }', "2", ["run 3: start = 2 is not a table"]),
        ("scenario.toml", '"chain.elements" = 2', '"chain.elements" = 20.5', ["a whole number"]),
        ("scenario.toml", '"chain.elements" = 2', '"chain.elements" = true', ["a whole number"]),
        ("scenario.toml", '"payload.mass" = 0.42', '"payload.mass" = "4"', ["a finite number"]),
        ("scenario.toml", '"payload.mass" = 0.42', '"payload.mass" = nan', ["a finite number"]),
        (
            "scenario.toml",
            '"payload.mass" = 0.42',
            '"payload.x" = 0.42',
            ["payload.x is an output"],
        ),
        ("scenario.toml", '"payload.x_rel"', '"payload.mass"', ["look_at", "'payload.mass'"]),
        ("scenario.toml", "0.005", "-0.005", ["output_interval"]),
        ("scenario.toml", "[experiment]", "[experiment", ["not valid TOML"]),
        (
            "scenario.toml",
            '"payload.mass" = 0.42',
            '"payload.mas" = 0.42',
            ["nearest is 'payload.mass'"],
        ),
        ("scenario.toml", "0.42", "-0.42", ["payload.mass = -0.42 is not allowed", "above 0"]),
        ("scenario.toml", "crane_nl.fmu", "crane_no.fmu", ["crane_no.fmu", "chaincrane build"]),
        ("scenario.toml", '["payload.x_rel"', '["payload.x_re"', ["look_at", "'payload.x_re'"]),
        ("scenario.toml", '["payload.x_rel", "chain.mid_x_rel"]', '"payload.x_rel"', ["look_at"]),
        ("scenario.toml", '"crane_nl.fmu"', "5", ["fmu = 5 is not a text"]),
        ("scenario.toml", "reference_interval = 0.02", "reference_interval = 0", ["multiple"]),
        ("scenario.toml", '"linear_2"', '"linear_10"', ["no name twice"]),
        ("scenario.toml", '"input.csv"', '"inputs.csv"', ["inputs.csv", "No such file"]),
    ],
)
def test_errors_are_one_clear_line(
    fmus: Path, tmp_path: Path, file: str, old: str, new: str, parts: list[str]
) -> None:
    folder = edited(tmp_path, file, old, new)
    one_line_error(["run", folder, "--fmus", fmus, "--out", tmp_path], *parts)


@pytest.mark.parametrize(
    ("rule", "parts"),
    [
        ("absolute = -1e-9\nreason = 'x'", ["absolute = -1e-09 is below 0"]),
        ("absolut = 1e-9\nreason = 'x'", ["no key 'absolut'", "nearest is 'absolute'"]),
        ("absolute = 1e-9", ["'reason' is missing"]),
        ("absolute = '1'\nreason = 'x'", ["absolute = '1' is not a finite number"]),
    ],
)
def test_a_tolerance_is_checked(tmp_path: Path, rule: str, parts: list[str]) -> None:
    folder = edited(
        tmp_path, "scenario.toml", "[start]", f"[tolerance.'payload.*']\n{rule}\n[start]"
    )
    with pytest.raises(UserError) as error:
        scenario.load(folder)
    for part in parts:
        assert part in str(error.value)


def test_a_tolerance_of_no_signal_is_refused(tmp_path: Path) -> None:
    rule = "[tolerance.'payload.xrel']\nabsolute = 1\nreason = 'x'\n"
    one = scenario.load(edited(tmp_path, "scenario.toml", "[start]", f"{rule}[start]"))
    reference = read_table(one.reference(one.runs[0]))
    with pytest.raises(
        UserError, match=r"'payload.xrel' fits no signal; the nearest is 'payload.x"
    ):
        check(one, one.runs[0], reference, reference)


def test_a_scenario_of_ones_own_needs_little(fmus: Path, tmp_path: Path) -> None:
    """Without input, labels or tolerances; checked within those that come with chaincrane."""
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "scenario.toml").write_text(
        "title = 'Mine'\n[experiment]\nstop_time = 0.1\noutput_interval = 0.01\n"
        "[[run]]\nname = 'heavy'\nfmu = 'crane_nl.fmu'\n"
    )
    assert chaincrane("check", folder, "--fmus", fmus, "--update").returncode == 0
    done = chaincrane("check", folder, "--fmus", fmus)
    assert "1 runs as their references" in done.stdout, done.stderr
    done = chaincrane("run", folder, "--fmus", fmus, "--out", tmp_path)
    assert re.search(r"\| payload.x_rel +\| [\d.]+ mm \| [\d.]+ mm \|", done.stdout)
    one = scenario.load(folder)
    assert (one.look_at, one.runs[0].label, one.start) == (("payload.x_rel",), "heavy", {})


@pytest.mark.parametrize(
    "text",
    ["\ufefftime,x\n0,0.8\n1,-1.5\n", "time;x\r\n0;0,8\r\n1;-1,5\r\n", "time; x\n0;0.8\n1;-1.5\n"],
)
def test_a_spreadsheets_file_is_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "t.csv").write_bytes(text.encode())
    table = read_table(tmp_path / "t.csv")
    assert (table["time"].tolist(), table["x"].tolist()) == ([0.0, 1.0], [0.8, -1.5])


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["antisway", "--elements", "-3"], ["elements = -3 is not allowed"]),
        (["antisway", "--elements", "2.5"], ["--elements", "'2.5'", "antisway --help"]),
        (["antisway", "--set", "observer::observer.elements=2.5"], ["a whole number"]),
        (["antisway", "--set", "crane::payload.mas=2.5"], ["nearest is 'payload.mass'"]),
        (["runs"], ["'runs'"]),
    ],
)
def test_options_are_checked(
    fmus: Path, tmp_path: Path, arguments: list[str], parts: list[str]
) -> None:
    more: list[object] = ["--fmus", fmus, "--out", tmp_path] if arguments[0] == "antisway" else []
    one_line_error([*arguments, *more], *parts)


@pytest.mark.parametrize(
    "command",
    [
        ["export"],
        ["report"],
        ["converge"],
        ["sweep", "--vary", "gravity=9.7,9.9"],
        ["fit", "no.csv", "--fit", "gravity"],
    ],
)
def test_an_unknown_run_is_refused(command: list[str]) -> None:
    first, *more = command
    options = [first, SCENARIOS / "paper_heavy", *more, "--run", "lineer_2"]
    one_line_error(options, "there is no run 'lineer_2'; the nearest is 'linear_2'")


@pytest.mark.parametrize(
    "command",
    [
        "run paper_heavy --out",
        "converge paper_heavy --out",
        "report paper_heavy --out",
        "export paper_heavy --out",
        "figures --out",
        "antisway --out",
        "sweep paper_heavy --vary gravity=9.7,9.9 --out",
        "fit paper_heavy no.csv --fit gravity --out",
        "study observer --out",
        "check --junit",
        "check --json",
    ],
)
def test_where_it_cannot_write_is_said_before_the_work(tmp_path: Path, command: str) -> None:
    file = tmp_path / "file"
    file.touch()
    name = command.rpartition(" ")[2]
    one_line_error([*command.split(), file / "more"], f"{name} {file}", f"{file} is not a folder")


def test_a_full_disk_leaves_nothing_half_written(fmus: Path, tmp_path: Path) -> None:
    """No file may be larger than 450 kB: an FMU can be unpacked, a result is larger."""
    resource = pytest.importorskip("resource", reason="needs a limit of Unix")
    code = f"""
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (450 * 1024, {resource.RLIM_INFINITY}))
from chaincrane_driver.cli import main
sys.exit(main({["run", "payload_push", "--fmus", str(fmus), "--out", str(tmp_path)]!r}))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.splitlines()
    assert line.endswith("payload_push/nonlinear.csv: File too large")
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_what_stops_a_writing_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("before")
    for error in (KeyboardInterrupt(), OSError(28, "No space left on device")):
        with pytest.raises(type(error)), places.whole_file(file) as partial:
            partial.write_text("half of wh")
            raise error
        assert [path.read_text() for path in tmp_path.iterdir()] == ["before"]
    with pytest.raises(OSError, match=r"No space .*/file'"), places.whole_file(file):
        raise OSError(28, "No space left on device")


def test_every_file_is_written_whole() -> None:
    """What the driver writes it writes to the partial file of whole_file, or is named here."""
    kept_otherwise = {
        "processes.py": 1,  # what a worker says, in the temporary folder
        "stepper.py": 1,  # a temporary file of its own, renamed, as others may make it too
    }
    writing = r"(\w+)\.(?:write_text|write_bytes|open\(\"w|write\(made\))"
    found: dict[str, int] = {}
    for module in (ROOT / "chaincrane_driver").glob("*.py"):
        for line in module.read_text().splitlines():
            if re.search(writing, line) and not re.search(r"\bpartial\.", line):
                found[module.name] = found.get(module.name, 0) + 1
    assert found == kept_otherwise


def test_a_sweep_that_gives_nothing_fails(fmus: Path, tmp_path: Path) -> None:
    options = ["sweep", SCENARIOS / "payload_push", "--fmus", fmus, "--out", tmp_path / "sweep"]
    masses = [*map(str, options), "--run", "linear_2", "--vary", "payload.mass=-1"]
    assert cli.main(masses) == 1
    copy = copied_push(tmp_path, '"payload.mass" = 0.42', '"payload.mass" = "heavy"')
    options = ["sweep", copy, "--fmus", fmus, "--vary", "gravity=9.7,9.9", "--out", tmp_path]
    one_line_error(options, "payload.mass = 'heavy' is not allowed: a finite number")


def test_a_fit_that_no_run_serves_says_why(fmus: Path, tmp_path: Path) -> None:
    copy = copied_push(tmp_path, '"payload.mass" = 0.42', '"payload.mass" = -1')
    (tmp_path / "measured.csv").write_text("time,payload.x_rel\n0,0\n0.1,1\n0.2,1\n")
    options = ["fit", copy, tmp_path / "measured.csv", "--fmus", fmus, "--run", "linear_2"]
    one_line_error([*options, "--fit", "gravity"], "payload.mass = -1.0 is not allowed")


def test_a_stale_fmu_is_not_checked(
    fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Gravity changes in a copy of the sources, the FMU does not."""
    shutil.copytree(ROOT / "fmu_src", tmp_path / "fmu_src")
    monkeypatch.setattr(stale.changed_sources, "__defaults__", (tmp_path,))
    every = sorted(fmus.glob("*.fmu"))
    assert not stale.say_if_stale(every)
    (tmp_path / "fmu_src" / "documentation" / "EQUATIONS.md").write_text("other words")
    assert not stale.say_if_stale(every)
    parameters = tmp_path / "fmu_src" / "chaincrane" / "plant" / "parameters.py"
    text = parameters.read_text()
    assert "9.81" in text
    parameters.write_text(text.replace("9.81", "9.82"))
    changed = {fmu.stem for fmu in every if stale.changed_sources(fmu)}
    assert changed == {"crane_nl", "crane_lin", "crane_observer", "crane_antisway"}
    options = ["check", SCENARIOS / "payload_push", "--fmu", fmus / "crane_nl.fmu"]
    assert cli.main([str(option) for option in options]) == 2
    errors = capsys.readouterr().err
    assert "crane_nl.fmu is stale: fmu_src/chaincrane/plant/parameters.py changed" in errors
    assert "nothing was checked" in errors
    assert cli.main([*map(str, options), "--accept-stale"]) == 0
    assert "1 runs as their references" in capsys.readouterr().out


def test_an_fmu_away_from_its_sources_is_not_stale(fmus: Path, tmp_path: Path) -> None:
    assert not stale.changed_sources(fmus / "crane_nl.fmu", tmp_path)


def test_the_list_of_sources_is_sha256sums(fmus: Path, native_fmus: Path) -> None:
    """Whole, for each FMU: another program finds every file of the checkout as listed."""
    for fmu in [*fmus.glob("*.fmu"), *native_fmus.glob("*.fmu")]:
        with zipfile.ZipFile(fmu) as archive:
            listed = archive.read(stale.LIST).decode()
        names = {line.partition("  ")[2] for line in listed.splitlines()}
        assert "fmu_src/chaincrane_builder/compile_c.py" in names
        if "crane_nl" in fmu.name or "native" in fmu.name:
            assert {"fmu_src/native/chain.c", "fmu_src/chaincrane/plant/kernel.py"} <= names
        for line in listed.splitlines():
            digest, _, name = line.partition("  ")
            assert sha256((ROOT / name).read_bytes()).hexdigest() == digest


def test_a_file_that_is_no_fmu(tmp_path: Path) -> None:
    bad = tmp_path / "bad.fmu"
    bad.write_text("no zip file")
    one_line_error(["check", "--fmu", bad, "--scenarios", SCENARIOS], "not a valid FMU")


def cut_short(fmu: Path, copy: Path) -> None:
    """A copy of an FMU whose binary is cut short."""
    with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(copy, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            target.writestr(name, content[:5000] if name.startswith("binaries") else content)


def test_a_description_that_is_none(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bad.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", "<html/>")
    options = ["check", "--fmu", tmp_path / "bad.fmu", "--scenarios", SCENARIOS]
    one_line_error(options, "not a valid FMU: its XML is no model description")


def test_an_fmu_that_crashes_is_one_line(fmus: Path, tmp_path: Path) -> None:
    """Its binary is cut short: the worker dies or fails, the driver says so."""
    broken = tmp_path / "crane_nl.fmu"
    cut_short(fmus / "crane_nl.fmu", broken)
    with pytest.raises(UserError, match=r"crane_nl\.fmu"):
        simulate_all([Job(broken, {}, None, 0.1, 0.01)], "broken")


def test_help_has_examples() -> None:
    for command in ([], ["run"], ["figures"], ["check"]):
        done = chaincrane(*command, "--help")
        assert done.returncode == 0
        assert "example" in done.stdout


def test_tables_survive_a_file(tmp_path: Path) -> None:
    table = np.array([(0.0, 1 / 3), (0.1, -1e-300)], dtype=[("time", float), ("x[1]", float)])
    write_table(tmp_path / "t.csv", table, digits=17)
    np.testing.assert_array_equal(read_table(tmp_path / "t.csv"), table)


def test_reference_rows_leave_the_cost_out() -> None:
    one = scenario.load(SCENARIOS / "payload_push")
    kind = [("time", float), ("payload.x", float), ("solver.steps", np.int32)]
    rows = np.array([(0.005 * i, i, 5) for i in range(9)], dtype=kind)
    kept = reference_rows(one, rows)
    assert kept.dtype.names == ("time", "payload.x")
    np.testing.assert_allclose(kept["time"], [0.0, 0.02, 0.04])


@pytest.mark.parametrize("name", [name for name in cli.COMMANDS if name != "build"])
def test_the_list_of_commands_says_what_each_says_of_itself(name: str) -> None:
    told = inspect.getdoc(cli.command_module(name).command) or ""
    assert told.splitlines()[0] == cli.COMMANDS[name][0]


def test_what_is_not_understood_leaves_nothing(tmp_path: Path) -> None:
    """Workers are started before the options are read."""
    done = subprocess.run(
        [sys.executable, "-m", "chaincrane_driver", "check", "--fnu", "a.fmu"],
        env={**os.environ, "TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("chaincrane: unrecognized arguments: --fnu")
    assert not list(tmp_path.iterdir())


def test_all_scenarios_are_there() -> None:
    assert [one.name for one in scenario.find(SCENARIOS)] == NAMES


def test_off_a_terminal_progress_is_a_line_a_minute(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a minute of 10 ms."""
    monkeypatch.setattr(processes, "MINUTE", 0.01)
    with processes.progress_bar(total=4, desc="check") as bar:
        for _ in range(4):
            time.sleep(0.02)
            bar.update()
    lines = [line for line in re.split(r"[\r\n]+", capsys.readouterr().err) if line.strip()]
    assert 3 <= len(lines) <= 5
    assert lines[0] == "check: 25 % after 00:00"
    monkeypatch.setattr(processes, "MINUTE", 60.0)
    with processes.progress_bar(total=1, desc="check") as bar:
        bar.update()
    assert capsys.readouterr().err == ""
