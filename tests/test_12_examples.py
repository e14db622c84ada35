"""Rung 12, the examples: each runs beside the FMUs, warns of nothing, and is short."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT

EXAMPLES = ROOT / "examples"
# What each prints in the end, and a file that it leaves. References: what is asked for, 1 m; the
# paper's heavy payload swings in 1.733 s with two elements (modes' test); our own frozen output.
CASES = {
    "animation": (r"chain\.gif: 51 pictures", "chain.gif"),
    "controller": (r"trolley at 1\.00\d m, sway -?[01]\.\d mm", None),
    "moving_picture": (r"crane\.svg: 101 pictures of 3 cranes", "crane.svg"),
    "own_motion": (r"sway at most 148 mm", "own_motion.png"),
    "python_control": (r"once in 1\.733 s(.|\n)*at the end 1\.000 m", None),
    "ssp": (r"trolley at 1\.000 m, sway -?[01]\.\d mm", "crane.ssp"),
    "sweep": (r"0\.42 +10 +236\.4", None),
}


def test_every_example_is_here_and_linked_to() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(CASES)
    page = (ROOT / "docs" / "examples.md").read_text()
    for name in CASES:
        assert f"(../examples/{name}.py)" in page
    assert "(docs/examples.md)" in (ROOT / "README.md").read_text()


def assert_is_the_readmes(picture: Path) -> None:
    """Same elements as in docs, and places within a millimetre, the last digit."""
    pages = [path.read_text() for path in (picture, ROOT / "docs" / "crane.svg")]
    number = r"(?<![\w.])-?\d+(?![\w.])"
    drawn, shown = ([int(one) for one in re.findall(number, page)] for page in pages)
    assert re.sub(number, "", pages[0]) == re.sub(number, "", pages[1])
    assert len(drawn) > 6000 and max(abs(a - b) for a, b in zip(drawn, shown, strict=True)) <= 1


@pytest.mark.parametrize("name", sorted(CASES))
def test_it_runs(name: str, fmus: Path, tmp_path: Path) -> None:
    needs = {"python_control": "control", "ssp": "libcosimpy"}
    if name in needs:
        pytest.importorskip(needs[name])
    for fmu in fmus.glob("*.fmu"):
        shutil.copy(fmu, tmp_path)
    source = EXAMPLES / f"{name}.py"
    assert len(source.read_text().splitlines()) <= 45
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    done = subprocess.run(
        [sys.executable, "-W", "error", str(source)],
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg", "TMPDIR": str(temporary)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    said, file = CASES[name]
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    assert re.search(said, done.stdout), done.stdout
    assert "arning" not in done.stdout  # FMPy prints its own
    assert not list(temporary.iterdir())  # no litter
    assert file is None or (tmp_path / file).stat().st_size > 5000
    if name == "moving_picture":
        assert_is_the_readmes(tmp_path / "crane.svg")
