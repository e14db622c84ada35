"""What a check of many runs has found: as lines of a log, JSON, and JUnit's XML."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

from .compare import Deviation
from .places import whole_file


@dataclass(frozen=True)
class Verdict:
    """A run against its reference. ``trouble``: why it could not be compared."""

    group: str  # the scenario's name
    run: str
    what: str  # that was checked: an FMU's file, or a CSV file
    deviations: Sequence[Deviation] = ()
    units: Mapping[str, str | None] | None = None
    trouble: str | None = None

    @property
    def outside(self) -> list[Deviation]:
        """Signals that differ by more than they may."""
        return [one for one in self.deviations if not one.within]

    @property
    def passed(self) -> bool:
        """Is the run as its reference?"""
        return self.trouble is None and not self.outside

    @property
    def worst(self) -> Deviation | None:
        """The signal that is nearest to, or farthest beyond, what it may differ by."""
        return max(self.deviations, key=lambda one: one.share, default=None)

    def told(self, one: Deviation) -> str:
        """A deviation in words, with its unit."""
        unit = (self.units or {}).get(one.signal) or ""
        text = f"{one.signal} off by {one.largest:.2g} {unit}".rstrip()
        text += f" at t = {one.when:g} s, of {one.tolerance.absolute:.2g} allowed"
        return text if one.first is None else f"{text}, from t = {one.first:g} s"

    def line(self) -> str:
        """The run in one line: its worst signal, and how many more are outside."""
        if self.trouble is not None:
            return f"{self.group}, {self.run}: {self.trouble}"
        verdict = "ok" if self.passed else "DIFFERS"
        text = f"{self.group}, {self.run}: {verdict}"
        if self.worst is not None:
            text += f"; worst: {self.told(self.worst)}"
        more = len(self.outside) - 1
        return text if more < 1 else f"{text}; {more} more signal{'s' if more > 1 else ''} differ"


def write_json(path: Path, verdicts: Sequence[Verdict]) -> None:
    """Every signal of every run."""
    told = [
        {
            "scenario": verdict.group,
            "run": verdict.run,
            "checked": verdict.what,
            "passed": verdict.passed,
            "trouble": verdict.trouble,
            "signals": [
                {
                    "name": one.signal,
                    "unit": (verdict.units or {}).get(one.signal),
                    "largest": one.largest
                    if one.largest == one.largest
                    else None,  # JSON has no nan
                    "at": one.when,
                    "allowed": one.tolerance.absolute,
                    "why": one.tolerance.reason,
                    "passed": one.within,
                }
                for one in verdict.deviations
            ],
        }
        for verdict in verdicts
    ]
    with whole_file(path) as partial:
        partial.write_text(json.dumps(told, indent=1, allow_nan=False) + "\n")


def write_junit(path: Path, verdicts: Sequence[Verdict]) -> None:
    """A test suite for each scenario, a test case for each run, as CI servers read it."""
    top = Element("testsuites", {"name": "chaincrane check", **_counts(verdicts)})
    for group in dict.fromkeys(verdict.group for verdict in verdicts):
        members = [verdict for verdict in verdicts if verdict.group == group]
        suite = SubElement(top, "testsuite", {"name": group, **_counts(members)})
        for verdict in members:
            case = SubElement(suite, "testcase", {"classname": group, "name": verdict.run})
            if verdict.trouble is not None:
                SubElement(case, "error", {"message": verdict.trouble})
            elif verdict.outside:
                failure = SubElement(case, "failure", {"message": verdict.line()})
                failure.text = "\n".join(map(verdict.told, verdict.outside))
            SubElement(case, "system-out").text = f"{verdict.what}: {verdict.line()}"
    indent(top)
    with whole_file(path) as partial:
        ElementTree(top).write(partial, encoding="utf-8", xml_declaration=True)


def _counts(verdicts: Sequence[Verdict]) -> dict[str, str]:
    errors = sum(verdict.trouble is not None for verdict in verdicts)
    failures = sum(bool(verdict.trouble is None and verdict.outside) for verdict in verdicts)
    counts = {"tests": len(verdicts), "failures": failures, "errors": errors}
    return {name: str(count) for name, count in counts.items()}
