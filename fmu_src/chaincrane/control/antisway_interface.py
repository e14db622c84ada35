"""The anti-sway controller's interface, in one table: its inputs and settings, and its output."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..variables import from_values, output, rows
from .antisway import AntiSwayInput, AntiSwaySettings
from .design import design_rows

INPUTS = rows(AntiSwayInput)
PARAMETERS = design_rows(AntiSwaySettings)
OUTPUTS = (
    output("trolley.a_cmd", "m/s2", "commanded acceleration, for the next communication step"),
)

VARIABLES = INPUTS + PARAMETERS + OUTPUTS


def settings(values: Mapping[str, Any]) -> AntiSwaySettings:
    """The settings from the FMU's parameter values, by name; the rest is the default."""
    return from_values(AntiSwaySettings, values)
