"""What comes with chaincrane: its scenarios and, in a wheel, its FMUs."""

from __future__ import annotations

from pathlib import Path

HERE = Path(__file__).resolve().parent
CHECKOUT = HERE.parent  # the folder of the sources, unless this runs from a wheel
_IN_WHEEL = HERE / "shipped"

SCENARIOS = _IN_WHEEL / "scenarios" if _IN_WHEEL.exists() else CHECKOUT / "scenarios"
TOLERANCES = SCENARIOS / "tolerances.toml"  # where a scenario's own folder gives none
FMUS = _IN_WHEEL / "fmus"  # a checkout has none: its FMUs are built where they are asked for
