"""What comes with chaincrane: its scenarios and, in a wheel, its FMUs and stepper."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

HERE = Path(__file__).resolve().parent
CHECKOUT = HERE.parent  # the folder of the sources, unless this runs from a wheel
_IN_WHEEL = HERE / "shipped"

SCENARIOS = _IN_WHEEL / "scenarios" if _IN_WHEEL.exists() else CHECKOUT / "scenarios"
TOLERANCES = SCENARIOS / "tolerances.toml"  # where a scenario's own folder gives none
STEPPER = _IN_WHEEL / "stepper"  # a library for each platform; a checkout compiles its own
FMUS = _IN_WHEEL / "fmus"  # a checkout has none: its FMUs are built where they are asked for
WORKING_FOLDER = Path()  # where FMUs are looked for if nothing is said


def fmu(folder: Path, name: str) -> Path:
    """An FMU's file in a folder; where that is the working folder and has none, ours.

    Where FMUs of both places are used, it is said once, on stderr.
    """
    ours = FMUS / name
    if folder != WORKING_FOLDER or (folder / name).exists() or not ours.exists():
        return folder / name
    if any(folder.glob("crane_*.fmu")):
        _say_ours(name)
    return ours


@cache
def _say_ours(name: str) -> None:
    print(f"chaincrane: {name} is not here: taking the one that came with it", file=sys.stderr)


def scenarios() -> Path:
    """Where scenarios are looked for if nothing is said: in the folder here, or ours."""
    here = Path("scenarios")
    return here if here.exists() else SCENARIOS


def scenario(folder: Path) -> Path:
    """A scenario's folder: that one, or ours of that name."""
    ours = SCENARIOS / folder
    return ours if not folder.exists() and len(folder.parts) == 1 and ours.exists() else folder
