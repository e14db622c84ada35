"""The communication points of a run and the inputs at each, exactly as FMPy's loop has them.

They are worked out before the run, and once for all runs that have them in common.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import inf, isclose

import numpy as np
from fmpy.model_description import ModelDescription
from fmpy.simulation import Input
from numpy.typing import NDArray

from .tables import Table, column_names

HELD = ("discrete", "tunable")  # variabilities of inputs that FMPy does not interpolate

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Grid:
    """Step i goes from ``times[i]`` to ``times[i + 1]`` over ``sizes[i]``, in s.

    ``inputs`` has a row for each step and a column for each input; ``initial`` is what they are
    while the FMU initialises: the values before a jump at the start.
    """

    times: Values
    sizes: Values
    inputs: Values
    initial: Values


def grid(
    description: ModelDescription, inputs: Table, stop_time: float, output_interval: float
) -> Grid:
    """The grid of a run from 0 to ``stop_time`` s under ``inputs``, a table of time and inputs.

    The inputs are linear between rows; a repeated time row is a jump, and is stepped to.
    """
    variability = {v.name: v.variability for v in description.modelVariables}
    _, *names = column_names(inputs)
    return _grid(
        inputs.tobytes(),
        tuple(variability[name] in HELD for name in names),
        tuple(Input.findEvents(inputs, description)),
        description.coSimulation.canHandleVariableCommunicationStepSize,
        stop_time,
        output_interval,
    )


@lru_cache(maxsize=16)
def _grid(
    rows: bytes,
    held: tuple[bool, ...],
    events: tuple[float, ...],
    variable_step: bool,
    stop_time: float,
    output_interval: float,
) -> Grid:
    table = np.frombuffer(rows).reshape(-1, 1 + len(held))
    times, sizes = _points(events, variable_step, stop_time, output_interval)
    values = np.zeros((len(sizes), len(held)))
    initial = np.zeros(len(held))
    for discrete in set(held):
        columns = np.flatnonzero(np.array(held) == discrete)
        signals = np.ascontiguousarray(table[:, 1 + columns].T)
        initial[columns] = _at(0.0, table[:, 0], signals, discrete, after_event=False)
        for step, time in enumerate(times[:-1]):
            values[step, columns] = _at(time, table[:, 0], signals, discrete, after_event=True)
    for array in (times, sizes, values, initial):
        array.flags.writeable = False  # runs share them
    return Grid(times, sizes, values, initial)


def _at(time: float, times: Values, signals: Values, held: bool, after_event: bool) -> Values:
    """The inputs at a time; ``signals`` has a row for each."""
    values, _ = Input.interpolate(time, times, signals, held, after_event=after_event)
    return np.asarray(values, float).reshape(-1)


def _points(
    events: Sequence[float], variable_step: bool, stop_time: float, output_interval: float
) -> tuple[Values, Values]:
    """Communication points and the steps between them: regular, at each jump, and at the end."""
    times, sizes, regular = [0.0], [], 0
    while not (times[-1] > stop_time or isclose(times[-1], stop_time)):
        time = times[-1]
        next_regular = (regular + 1) * output_interval
        point = next_regular
        event = next((t for t in events if t > time and not isclose(t, time)), inf)
        if variable_step and point > event and not isclose(point, event):
            point = event
        if point > stop_time and not isclose(point, stop_time):
            if not variable_step:
                break
            point = stop_time
        times.append(point)
        sizes.append(point - time)
        regular += isclose(point, next_regular)
    return np.array(times), np.array(sizes)


def all_inputs(names: Sequence[str], given: Table | None, start: Mapping[str, float]) -> Table:
    """An input table with a column for each of ``names``: as given, else held at its start."""
    time = np.zeros(1) if given is None else given[column_names(given)[0]]
    table = np.zeros(len(time), dtype=[(name, float) for name in ["time", *names]])
    table["time"] = time
    for name in names:
        known = given is not None and name in column_names(given)
        table[name] = given[name] if known and given is not None else start[name]
    return table
