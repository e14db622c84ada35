"""What comes with chaincrane: its scenarios and, in a wheel, its FMUs and stepper."""

from __future__ import annotations

from pathlib import Path

HERE = Path(__file__).resolve().parent
CHECKOUT = HERE.parent  # the folder of the sources, unless this runs from a wheel
_IN_WHEEL = HERE / "shipped"

SCENARIOS = _IN_WHEEL / "scenarios" if _IN_WHEEL.exists() else CHECKOUT / "scenarios"
TOLERANCES = SCENARIOS / "tolerances.toml"  # where a scenario's own folder gives none
STEPPER = _IN_WHEEL / "stepper"  # a library for each platform; a checkout compiles its own
FMUS = _IN_WHEEL / "fmus"  # a checkout has none: its FMUs are built where they are asked for


def fmus() -> Path:
    """Where FMUs are looked for if nothing is said: here, or what came with chaincrane."""
    here = Path()
    return FMUS if FMUS.exists() and not any(here.glob("crane_*.fmu")) else here


def scenarios() -> Path:
    """Where scenarios are looked for if nothing is said: in the folder here, or ours."""
    here = Path("scenarios")
    return here if here.exists() else SCENARIOS


def scenario(folder: Path) -> Path:
    """A scenario's folder: that one, or ours of that name."""
    ours = SCENARIOS / folder
    return ours if not folder.exists() and len(folder.parts) == 1 and ours.exists() else folder
