"""The README and the pages of docs: their commands, their tables, their numbers."""

import importlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT

from chaincrane.plant.interface import VARIABLES
from chaincrane_driver import cli, scenario
from chaincrane_driver.compare import difference
from chaincrane_driver.run_command import run_all

README = (ROOT / "README.md").read_text()
DOCS = {page.stem: page.read_text() for page in (ROOT / "docs").glob("*.md")}
EQUATIONS = (ROOT / "fmu_src" / "documentation" / "EQUATIONS.md").read_text()


def rows(text: str, columns: int) -> list[list[str]]:
    """The rows of all tables with so many columns, headers and rules left out."""
    cells = [[c.strip() for c in line.strip("|").split("|")] for line in text.splitlines()]
    tables = [row for row in cells if len(row) == columns]
    return [row for row in tables if not set("".join(row)) <= set("- ")]


def commands() -> list[str]:
    return [block.strip() for block in re.findall(r"```sh\n(.*?)```", README, flags=re.DOTALL)]


def test_the_readme_is_short() -> None:
    """About 900 words, tables and code included, their rules not."""
    assert len(re.sub(r"\||-{3,}", "", README).split()) <= 950


def test_every_command_is_in_the_readme() -> None:
    """In the table of commands, or in the two commands, which build."""
    (names,) = re.findall(r"(?s)COMMAND\n(.*?)\n\n", cli.parser().format_help())
    known = re.findall(r"(?m)^    (\w+) ", names)
    assert len(known) == 11
    table = README[README.index("## Commands") : README.index("## How good")]
    told = re.findall(r"`chaincrane (\w+)[^`]*`(?:, `(\w+)`)?", table)
    assert {one for pair in told for one in pair if one} == set(known) - {"build"}


def test_there_are_two_commands_and_ci_runs_the_second() -> None:
    first, second = commands()
    assert first.endswith("build_fmu.py && .venv/bin/chaincrane figures")
    assert second.endswith("-m pytest")
    chosen = subprocess.run(
        ["grep", "-m1", "pytest$", str(ROOT / "README.md")], capture_output=True, text=True
    )
    assert chosen.stdout.strip() == second
    assert "grep -m1 'pytest$' README.md" in (ROOT / ".ci" / "run").read_text()


@pytest.mark.skipif(sys.platform == "darwin", reason="pythonfmu has no wrapper for macOS")
def test_the_main_job_runs_from_anywhere(tmp_path: Path) -> None:
    """What the first command does once it has installed: build here, draw here."""
    build = [sys.executable, str(ROOT / "build_fmu.py")]
    draw = [sys.executable, "-m", "chaincrane_driver.cli", "figures"]
    draw += ["--scenarios", str(ROOT / "scenarios")]
    for command in (build, draw):
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "figures").glob("fig*"))) == 12


def run_python(page: str, fmus: Path, folder: Path) -> str:
    """Run the one Python example of a page beside the FMUs; what it prints."""
    (code,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    for fmu in fmus.glob("*.fmu"):
        shutil.copy(fmu, folder)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=folder,
        env={**os.environ, "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return done.stdout


def test_the_readmes_python_draws(fmus: Path, tmp_path: Path) -> None:
    assert run_python(README, fmus, tmp_path) == ""  # nor a warning of FMPy's
    assert (tmp_path / "sway.svg").stat().st_size > 10_000


def test_the_hosts_python_runs(fmus: Path, tmp_path: Path) -> None:
    (line,) = run_python(DOCS["hosts"], fmus, tmp_path).splitlines()  # nor a warning of FMPy's
    assert -0.3 < float(line) < 0.3


def test_the_scenario_on_its_page_runs(fmus: Path, tmp_path: Path) -> None:
    for kind, name in (("toml", "scenario.toml"), ("csv", "motion.csv")):
        (text,) = re.findall(rf"```{kind}\n(.*?)```", DOCS["scenarios"], flags=re.DOTALL)
        (tmp_path / name).write_text(text)
    for more in (["--update"], []):
        assert cli.main(["check", str(tmp_path), "--fmus", str(fmus), *more]) == 0


def test_the_scenario_page_has_every_key() -> None:
    told = {row[0].strip("`[]").split('."')[0] for row in rows(DOCS["scenarios"], 2)}
    for table, keys in scenario.KEYS.items():
        for key in keys:
            one = f"{table}.{key}" if table else key
            assert table == "tolerance" or one in told | {"experiment", "run"}, one


def test_the_interface_table_is_the_interface() -> None:
    listed = {row[0]: row for row in rows(DOCS["interface"], 5)}
    for variable in VARIABLES:
        name = re.sub(r"\[\d+\]", "[i]", variable.name)
        row = listed[name]
        assert row[1].split()[0] == variable.causality
        assert row[2] == (variable.unit or "-")
        assert row[3] == ("" if variable.start is None else str(variable.start))
    assert len(listed) == 1 + len(VARIABLES) - 18  # its header; nine of ten points left out twice


def test_the_comparison_table_has_our_numbers(fmus: Path) -> None:
    results = {}
    for name in ("paper_heavy", "paper_light"):
        one = scenario.load(ROOT / "scenarios" / name)
        results[name] = one, run_all(one, fmus)
    table = {(row[0], row[1]): row[2:] for row in rows(README, 6)}
    checked = 0
    for place, (one, tables) in enumerate(results.values()):
        truth, *others = one.runs
        for signal in one.look_at:
            for run in others:
                gap = difference(tables[truth.name], tables[run.name], signal)
                cells = table[signal, run.label][2 * place : 2 * place + 2]
                assert cells == [
                    f"{1e3 * gap.rms:.2f} mm, {gap.rms_percent:.2f} %",
                    f"{1e3 * gap.largest:.2f} mm, {gap.largest_percent:.2f} %",
                ]
                checked += 1
    assert checked == 12


def test_scenarios_are_listed() -> None:
    for one in scenario.find(ROOT / "scenarios"):
        assert f"`{one.name}`" in DOCS["scenarios"]


def test_every_equation_has_its_function_and_test() -> None:
    tests = "".join(path.read_text() for path in (ROOT / "tests").glob("test_*.py"))
    found = 0
    for _, _, functions, test in rows(EQUATIONS, 4):
        if functions == "function":
            continue
        assert f"def {test.strip('`')}(" in tests, test
        for function in functions.replace("`", "").split(", "):
            room, module, *path = function.split(".")
            place = importlib.import_module(f"chaincrane.{room}.{module}")
            for part in path:
                place = getattr(place, part)
            found += 1
    assert found >= 17


def test_no_binary_is_committed() -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("not a git checkout")
    for name in listed.stdout.splitlines():
        assert not name.endswith((".fmu", ".so", ".dll", ".dylib", ".pyc", ".ssp")), name


def links() -> list[tuple[Path, Path, str]]:
    """Links within our Markdown: the page that has it, the file it names, and the heading."""
    found = []
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")):
        for link in re.findall(r"\]\(([^)]+)\)", page.read_text()):
            file, _, heading = link.partition("#")
            if "://" not in link:
                found.append((page, (page.parent / file).resolve() if file else page, heading))
    return found


def test_links_lead_somewhere() -> None:
    for page, target, heading in links():
        assert target.exists(), f"{page}: {target}"
        if heading:
            titles = re.findall(r"(?m)^#+ (.*)$", target.read_text().lower())
            assert heading in [re.sub(r"[^\w -]", "", t).replace(" ", "-") for t in titles], page


def test_every_page_is_linked_to() -> None:
    linked = {target for page, target, _ in links() if page != target}
    assert linked >= {page.resolve() for page in (ROOT / "docs").glob("*.md")}
