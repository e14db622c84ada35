"""The picture of a sweep: curves where one thing varies, a map for two, paired scatter for more."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .compare import shown
from .dataset import Results
from .plots import STYLES, new_figure, save_figure
from .subjects import Metric, Subject
from .vary import Design

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FEW = 6  # so many values of the second thing that varies are curves, more are a map
MOST_POINTS = 5000  # in a panel of a scatter; more are thinned out
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe & Ito


def sweep_figure(
    subject: Subject,
    design: Design,
    results: Results,
    metrics: Sequence[Metric],
    title: str,
    stem: Path,
) -> list[Path]:
    """Draw some metrics over what varies; the files written."""
    places = {metric.name: place for place, metric in enumerate(subject.metrics)}
    values = [results.values[:, :, places[metric.name]] for metric in metrics]
    if len(design.names) == 1:
        figure = _curves(subject, design, metrics, values)
    elif len(design.names) == 2 and len(design.axes) == 2:
        second = design.axes[1].values
        few = len(second) <= FEW or not _numeric(second)
        figure = (_families if few else _maps)(subject, design, metrics, values)
    else:
        figure = _pairs(subject, design, metrics[0], values[0])
    figure.suptitle(title)
    return save_figure(figure, stem)


def _numeric(values: Sequence[Any]) -> bool:
    return all(isinstance(value, (int, float)) for value in values)


def _positions(values: Sequence[Any]) -> NDArray[np.float64]:
    """Where values are on an axis: a text at the place of its first appearance."""
    if _numeric(values):
        return np.array(values, float)
    known = list(dict.fromkeys(map(str, values)))
    return np.array([known.index(str(value)) for value in values], float)


def _label(axes: Axes, which: str, name: str, design: Design, subject: Subject) -> None:
    """Name an axis after what varies along it."""
    values, unit = design.values(name), subject.units.get(name, "")
    axis = axes.xaxis if which == "x" else axes.yaxis
    axis.set_label_text(f"{name} [{unit}]" if unit else name)
    if not _numeric(values):
        known = list(dict.fromkeys(map(str, values)))
        axis.set_ticks(range(len(known)), known)
    elif _logarithmic(values):
        (axes.set_xscale if which == "x" else axes.set_yscale)("log")


def _logarithmic(values: Sequence[Any]) -> bool:
    """Are values spaced evenly by their logarithms rather than by themselves?"""
    numbers = np.unique(np.array(values, float))
    if len(numbers) < 4 or numbers[0] <= 0.0:
        return False
    return bool(np.allclose(np.diff(np.log(numbers)), np.log(numbers[1] / numbers[0]), rtol=1e-3))


def _metric_label(metric: Metric) -> tuple[float, str]:
    """Factor and text of a metric's axis."""
    factor, unit = shown(metric.unit)
    return factor, f"{metric.name} [{unit}]" if unit else metric.name


def _curves(
    subject: Subject,
    design: Design,
    metrics: Sequence[Metric],
    values: Sequence[NDArray[np.float64]],
) -> Figure:
    """A panel for each metric, a curve for each run."""
    (name,) = design.names
    x = _positions(design.values(name))
    order = np.argsort(x, kind="stable")
    figure, axes = new_figure(len(metrics), 1, 6.5, 1.0 + 2.3 * len(metrics), sharex=True)
    marker = "." if len(x) <= 30 or name in design.table else ""
    for panel, metric, found in zip(axes[:, 0], metrics, values, strict=True):
        factor, label = _metric_label(metric)
        for run, title in enumerate(subject.runs):
            if np.isfinite(found[:, run]).any():
                style = STYLES[run % len(STYLES)]
                y = factor * found[order, run]
                panel.plot(x[order], y, marker=marker, label=title, **style)
        panel.set_ylabel(label)
    _label(axes[-1, 0], "x", name, design, subject)
    if len(subject.runs) > 1:
        axes[0, 0].legend(fontsize=8)
    return figure


def _families(
    subject: Subject,
    design: Design,
    metrics: Sequence[Metric],
    values: Sequence[NDArray[np.float64]],
) -> Figure:
    """A panel for each metric and run, a curve for each value of the second axis."""
    first, second = design.axes
    x = _positions(first.values)
    figure, axes = _panels(subject, len(metrics))
    for panel, label, grid in _grids(subject, design, axes, metrics, values):
        for place, value in enumerate(second.values):
            text = f"{second.name} = {value}"
            colour = COLOURS[place % len(COLOURS)]
            panel.plot(x, grid[:, place], ".-", color=colour, label=text)
        panel.set_ylabel(label)
        _label(panel, "x", first.name, design, subject)
    axes[0, 0].legend(fontsize=8)
    return figure


def _maps(
    subject: Subject,
    design: Design,
    metrics: Sequence[Metric],
    values: Sequence[NDArray[np.float64]],
) -> Figure:
    """A map for each metric and run; white where a run failed."""
    first, second = design.axes
    x, y = _positions(first.values), _positions(second.values)
    figure, axes = _panels(subject, len(metrics))
    for panel, label, grid in _grids(subject, design, axes, metrics, values):
        picture = panel.pcolormesh(x, y, np.ma.masked_invalid(grid.T), shading="nearest")
        panel.grid(False)
        figure.colorbar(picture, ax=panel, label=label)
        _label(panel, "x", first.name, design, subject)
        _label(panel, "y", second.name, design, subject)
    return figure


def _grids(
    subject: Subject,
    design: Design,
    axes: NDArray[np.object_],
    metrics: Sequence[Metric],
    values: Sequence[NDArray[np.float64]],
) -> Iterator[tuple[Axes, str, NDArray[np.float64]]]:
    """Panel, label, and values by the first and the second axis, of each metric and run."""
    count = len(design.axes[0].values)
    for row, (metric, found) in enumerate(zip(metrics, values, strict=True)):
        factor, label = _metric_label(metric)
        for run, title in enumerate(subject.runs):
            panel = axes[row, run]
            if row == 0 and len(subject.runs) > 1:
                panel.set_title(title, fontsize=9)
            yield panel, label, factor * found[:, run].reshape(count, -1)


def _panels(subject: Subject, rows: int) -> tuple[Figure, NDArray[np.object_]]:
    columns = len(subject.runs)
    return new_figure(rows, columns, 1.0 + 5.0 * columns, 1.0 + 3.0 * rows)


def _pairs(subject: Subject, design: Design, metric: Metric, found: NDArray[np.float64]) -> Figure:
    """Each pair of what varies, coloured by the metric of the first run that has it."""
    names = design.names
    run = next((n for n in range(len(subject.runs)) if np.isfinite(found[:, n]).any()), 0)
    factor, label = _metric_label(metric)
    few = np.arange(0, len(design), max(1, len(design) // MOST_POINTS))
    cases = [design.case(int(number)) for number in few]
    columns = {name: _positions([case[name] for case in cases]) for name in names}
    size = len(names) - 1
    figure, axes = new_figure(size, size, 1.5 + 2.4 * size, 1.0 + 2.2 * size)
    for row in range(size):
        for column in range(size):
            panel = axes[row, column]
            if column > row:
                panel.set_visible(False)
                continue
            x, y = names[column], names[row + 1]
            colour = factor * found[few, run]
            picture = panel.scatter(columns[x], columns[y], c=colour, s=8)
            _label(panel, "x", x, design, subject)
            _label(panel, "y", y, design, subject)
    title = f"{label}; {subject.runs[run]}" if len(subject.runs) > 1 else label
    figure.colorbar(picture, ax=axes, label=title)
    return figure
