"""Runs in the form of the FMI cross-check rules 4.1, which other tools' CI reads.

A folder has NAME.fmu, NAME_in.csv, NAME_ref.csv, NAME_ref.opt and a README.md. The form has no
start values: a run can be written that starts with the FMU's own.
"""

from __future__ import annotations

import shutil
import zipfile
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.util import read_ref_opt_file

from .compare import Deviation, Tolerance, deviation
from .errors import UserError, one_line
from .grid import all_inputs
from .instances import describe
from .places import whole_file
from .scenario import Run, Scenario
from .simulate import Job
from .start_values import check_start_values
from .tables import Table, column_names, read_table

MOST = 10  # signals in a reference, as the rules recommend
SIGNALS = (
    "trolley.x",
    "trolley.v",
    "payload.x",
    "payload.y",
    "payload.vx",
    "payload.x_rel",
    "chain.mid_x_rel",
    "chain.top_angle",
)
RELATIVE = 1e-6  # of a signal's largest value: what another platform's rounding stays well below
README = """# {name}

{title}: {asks}

{tool} {version} exported it: {description}. Interface, equations and what an importing
tool needs are in the FMU's `documentation/index.html`. Step it by {step} s from 0 to {stop} s. The
inputs in `{name}_in.csv` are linear between rows; a time that stands twice is a jump.
`{name}_ref.csv` is our own frozen result; `RelTol` in `{name}_ref.opt` is of each signal's largest
value.
"""


def default_starts(one: Scenario, run: Run, fmu: Path) -> dict[str, Any]:
    """Start values of a run that are not the FMU's own; empty where the form can take it."""
    description, start = describe(fmu), one.start | run.start
    check_start_values(fmu, description, start)
    own = {v.name: v.start for v in description.modelVariables}
    return {name: value for name, value in start.items() if str(value) != str(_number(own[name]))}


def _number(text: Any) -> Any:
    try:
        return float(text) if any(c in text for c in ".e") else int(text)
    except (TypeError, ValueError):
        return text


def export(one: Scenario, run: Run, fmu: Path, dest: Path) -> list[Path]:
    """Write a run below ``dest``, a folder for each platform that the FMU has; those folders.

    Raises UserError where it starts with values that are not the FMU's own, or has no reference.
    """
    others = default_starts(one, run, fmu)
    if others:
        told = ", ".join(f"{name} = {value}" for name, value in others.items())
        raise UserError(f"{one.name}, {run.name}: the form has no start values, and it has {told}")
    name = f"{one.name}_{run.name}"
    description = describe(fmu)
    reference = read_table(one.reference(run))
    job = one.job(run, fmu)
    signals = [signal for signal in dict.fromkeys([*one.look_at, *SIGNALS])][:MOST]
    options = {
        "StartTime": 0.0,
        "StopTime": one.stop_time,
        "StepSize": one.output_interval,
        "RelTol": RELATIVE,
        "OutputIntervalLength": one.reference_interval,
    }
    version = metadata.version("chaincrane")
    readme = README.format(
        name=name,
        title=one.title,
        asks=" ".join(one.asks.split()),
        tool="chaincrane",
        version=version,
        description=description.description,
        step=one.output_interval,
        stop=one.stop_time,
    )
    with zipfile.ZipFile(fmu) as archive:
        parts = [Path(entry).parts for entry in archive.namelist()]
    platforms = sorted({part[1] for part in parts if part[0] == "binaries" and len(part) > 2})
    inputs = [v.name for v in description.modelVariables if v.causality == "input"]
    folders = []
    for platform in platforms:
        folder = dest.joinpath("fmus", "2.0", "cs", platform, "chaincrane", version, name)
        with whole_file(folder / f"{name}.fmu") as partial:
            shutil.copyfile(fmu, partial)
        files = {
            f"{name}_in.csv": _csv(all_inputs(inputs, job.inputs, dict.fromkeys(inputs, 0.0))),
            f"{name}_ref.csv": _csv(reference[["time", *signals]]),
            f"{name}_ref.opt": "".join(f"{key}, {value!r}\n" for key, value in options.items()),
            "README.md": readme,
        }
        for file, text in files.items():
            with whole_file(folder / file) as partial:
                partial.write_text(text)
        folders.append(folder)
    return folders


def _csv(table: Table) -> str:
    """A table as the rules want it: names in double quotes, numbers without."""
    lines = [",".join(f'"{name}"' for name in column_names(table))]
    lines += [",".join(f"{value:.12g}" for value in row) for row in table.tolist()]
    return "\n".join(lines) + "\n"


def job_of(folder: Path) -> Job:
    """The simulation that a folder of this form asks for. Raises UserError."""
    name = folder.name
    try:
        options = read_ref_opt_file(str(folder / f"{name}_ref.opt"))
    except Exception as error:
        raise UserError(f"{folder / f'{name}_ref.opt'}: {one_line(error)}") from error
    if options["StartTime"] != 0.0 or not options["StepSize"]:
        raise UserError(f"{folder}: must start at 0 s and have a step")
    inputs = folder / f"{name}_in.csv"
    table = read_table(inputs) if inputs.exists() else None
    step, stop = float(options["StepSize"]), float(options["StopTime"])
    return Job(folder / f"{name}.fmu", {}, table, stop, step)


def deviations(folder: Path, result: Table) -> list[Deviation]:
    """A result against the folder's reference, at the reference's times. Raises UserError."""
    name = folder.name
    reference = read_table(folder / f"{name}_ref.csv")
    relative = float(read_ref_opt_file(str(folder / f"{name}_ref.opt"))["RelTol"])
    found = []
    for signal in column_names(reference)[1:]:
        if signal not in column_names(result):
            raise UserError(f"{folder}: the FMU has no output {signal!r}")
        allowed = relative * max(float(np.abs(reference[signal]).max()), 1.0)
        values = np.interp(reference["time"], result["time"], result[signal])
        why = f"RelTol {relative:g} of its largest value, or of 1"
        gap = np.abs(values - reference[signal])
        found.append(deviation(signal, reference["time"], gap, Tolerance(allowed, why)))
    return found
