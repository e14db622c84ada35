"""Pictures: a scenario's comparison, and the paper's Figs. 4 to 7 with our numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .compare import shown
from .converge import Estimate, Finding, Signal
from .scenario import Run, Scenario
from .tables import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Colours that stay apart for colour-blind eyes (Okabe & Ito); the truth is black.
STYLES: tuple[dict[str, Any], ...] = (
    {"color": "black", "linewidth": 1.6},
    {"color": "#0072B2", "linewidth": 1.2},
    {"color": "#D55E00", "linewidth": 1.2, "linestyle": (0, (5, 2))},
    {"color": "#009E73", "linewidth": 1.0, "linestyle": (0, (1, 1.5))},
)
RUN_STYLES = (*STYLES[:3], {"color": "0.6", "linewidth": 1.0})  # the last: for comparison
SIGNAL_TITLES = {
    "payload.x": "payload, absolute: payload.x",
    "payload.x_rel": "payload, relative to the trolley: payload.x_rel",
    "chain.mid_x_rel": "middle of the chain, relative: chain.mid_x_rel",
}
# Name, colour of lines, colour of bands.
ERROR_STYLES = (("time error", "#D55E00", "#E69A66"), ("mesh error", "#0072B2", "#BFDCEC"))
BELOW, ABOVE = 100.0, 4.0  # an axis of errors reaches so far below the least and above the largest
SHAPE_POINTS = 10
SHAPE_TIMES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.08, 1.16, 1.24, 1.44, 2.0, 2.1, 2.2, 2.3)

Results = dict[str, Table]


def new_figure(
    rows: int, columns: int, width: float, height: float, **more: Any
) -> tuple[Figure, np.ndarray]:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update(
        {
            "font.size": 9,
            "axes.grid": True,
            "grid.alpha": 0.25,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "svg.hashsalt": "chaincrane",  # the same picture is the same file
            "svg.fonttype": "none",
        }
    )
    figure, axes = plt.subplots(
        rows, columns, figsize=(width, height), squeeze=False, layout="constrained", **more
    )
    return figure, axes


def save_figure(figure: Figure, stem: Path) -> list[Path]:
    import matplotlib.pyplot as plt

    stem.parent.mkdir(parents=True, exist_ok=True)
    paths = [stem.with_suffix(".png"), stem.with_suffix(".svg")]
    figure.savefig(paths[0], dpi=200)
    figure.savefig(paths[1], metadata={"Date": None})
    plt.close(figure)
    return paths


def _curves(
    axes: Axes, runs: tuple[Run, ...], results: Results, signal: str, unit: str | None = "m"
) -> None:
    factor, name = shown(unit)
    for run, style in zip(runs, cycle(STYLES), strict=False):
        table = results[run.name]
        axes.plot(table["time"], factor * table[signal], label=run.label, **style)
    axes.set_title(SIGNAL_TITLES.get(signal, signal), loc="left", fontsize=9)
    axes.set_ylabel(name)
    axes.margins(x=0)


def comparison(
    scenario: Scenario, results: Results, units: Mapping[str, str | None], stem: Path
) -> list[Path]:
    """Each signal looked at, of all runs, and below it their differences to the first run."""
    count = len(scenario.look_at)
    figure, axes = new_figure(2, count, 5.2 * count, 5.0, sharex=True, height_ratios=(2, 1))
    truth = results[scenario.runs[0].name]
    for column, signal in enumerate(scenario.look_at):
        top, bottom = axes[0, column], axes[1, column]
        factor, unit = shown(units[signal])
        _curves(top, scenario.runs, results, signal, units[signal])
        for run, style in list(zip(scenario.runs, cycle(STYLES), strict=False))[1:]:
            gap = results[run.name][signal] - truth[signal]
            bottom.plot(truth["time"], factor * gap, **style)
        bottom.set_title(f"difference to: {scenario.runs[0].label}", loc="left", fontsize=9)
        bottom.set_ylabel(unit)
        bottom.set_xlabel("time, s")
    figure.suptitle(scenario.title)
    _legend(figure, axes[0, 0])
    return save_figure(figure, stem)


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)


def motion_figure(
    panels: list[tuple[str, Scenario, Results]], signal: str, title: str, stem: Path
) -> list[Path]:
    """One signal, a panel for each payload (Figs. 5 to 7): the linear cranes on the nonlinear."""
    figure, axes = new_figure(1, len(panels), 4.8 * len(panels), 3.1)
    for place, (name, scenario, results) in enumerate(panels):
        runs = tuple(run for run in scenario.runs if run.name != "massless")
        panel = axes[0, place]
        _curves(panel, runs, results, signal)
        panel.set_title(f"{'ab'[place]}) {name}", loc="left", fontsize=9)
        panel.set_xlabel("time, s")
    figure.suptitle(title)
    _legend(figure, axes[0, 0])
    return save_figure(figure, stem)


def shape_figure(
    panels: list[tuple[str, Scenario, Results]], times: tuple[float, ...], title: str, stem: Path
) -> list[Path]:
    """Position and shape of the chain at some times (Fig. 4), nonlinear and linear side by side."""
    import matplotlib

    figure, axes = new_figure(len(panels), 2, 9.0, 3.6 * len(panels), sharex=True, sharey=True)
    colours = matplotlib.colormaps["viridis"]
    norm = matplotlib.colors.Normalize(min(times), max(times))
    for row, (name, scenario, results) in enumerate(panels):
        for column, run in enumerate(scenario.runs[:2]):
            panel, table = axes[row, column], results[run.name]
            for time in times:
                at = table[int(np.argmin(np.abs(table["time"] - time)))]
                x = [at["trolley.x"]] + [at[f"chain.x[{i}]"] for i in range(1, SHAPE_POINTS + 1)]
                y = [0.0] + [at[f"chain.y[{i}]"] for i in range(1, SHAPE_POINTS + 1)]
                colour = colours(norm(time))
                panel.plot(x, y, color=colour, linewidth=1.1)
                panel.plot(x[-1], y[-1], "o", color=colour, markersize=4)
                panel.plot(x[0], y[0], "s", color=colour, markersize=3)
            panel.set_aspect("equal")
            panel.set_title(f"{'abcd'[2 * row + column]}) {name}, {run.label}", loc="left", size=9)
            panel.set_xlabel("x, m")
        axes[row, 0].set_ylabel("y, m")
    bar = figure.colorbar(
        matplotlib.cm.ScalarMappable(norm, colours), ax=axes, shrink=0.6, pad=0.02
    )
    bar.set_label("time, s")
    figure.suptitle(title)
    return save_figure(figure, stem)


def antisway_figure(runs: list[tuple[str, Table]], title: str, stem: Path) -> list[Path]:
    """Position, sway, estimate against truth, and command; the first run is the one estimated."""
    figure, axes = new_figure(2, 2, 9.6, 5.6, sharex=True)
    panels = (
        ("crane::payload.x", 1.0, "position of the payload: payload.x", "m"),
        ("crane::payload.x_rel", 1e3, "sway: payload.x_rel", "mm"),
        ("antisway::trolley.a_cmd", 1.0, "command: trolley.a_cmd", "m/s2"),
    )
    for place, (name, scale, text, unit) in zip((0, 1, 3), panels, strict=True):
        panel = axes.flat[place]
        for (label, table), style in zip(runs, RUN_STYLES, strict=False):
            panel.plot(table["time"], scale * table[name], label=label, **style)
        panel.set_title(text, loc="left", fontsize=9)
        panel.set_ylabel(unit)
        panel.margins(x=0)
    time, first = runs[0][1]["time"], runs[0][1]
    gap = 1e3 * (first["observer::payload.x_rel"] - first["crane::payload.x_rel"])
    band = 2e3 * first["observer::std.payload.x_rel"]
    panel = axes[1, 0]
    panel.fill_between(time, -band, band, color="0.88", linewidth=0, label="twice its deviation")
    panel.plot(time, gap, color="black", linewidth=1.0, label="estimate less truth")
    panel.legend(frameon=False, fontsize=8, loc="upper right")
    panel.set_title(f"error of the estimated sway: {runs[0][0]}", loc="left", fontsize=9)
    panel.set_ylabel("mm")
    for panel in axes[1]:
        panel.set_xlabel("time, s")
    figure.suptitle(title)
    _legend(figure, axes[0, 0])
    return save_figure(figure, stem)


def study_figure(panels: list[tuple[str, list[tuple[str, Table]]]], stem: Path) -> list[Path]:
    """Sway and its estimates' errors, a column for each payload."""
    figure, axes = new_figure(2, len(panels), 4.8 * len(panels), 5.0, sharex=True, sharey="row")
    for column, (label, runs) in enumerate(panels):
        for (name, whole), style in zip(runs, RUN_STYLES, strict=False):
            table = whole[::2]
            time, sway = table["time"], 1e3 * table["crane::payload.x_rel"]
            axes[0, column].plot(time, sway, label=name, **style)
            if name.startswith("LQR"):
                gap = 1e3 * table["observer::payload.x_rel"] - sway
                axes[1, column].plot(time, gap, **style)
        axes[0, column].set_title(f"{label} payload: sway, payload.x_rel", loc="left", fontsize=9)
        axes[1, column].set_title("estimate less truth", loc="left", fontsize=9)
        axes[1, column].set_xlabel("time, s")
        axes[0, column].margins(x=0)
    for row in range(2):
        axes[row, 0].set_ylabel("mm")
    figure.suptitle("1 m within 0.5 m/s and 1 m/s2; rope-angle sensor, 0.5 degree noise")
    _legend(figure, axes[0, 0])
    return save_figure(figure, stem)


def convergence_figure(
    finding: Finding, signals: Sequence[Signal], title: str, stem: Path
) -> list[Path]:
    """Signals of a run with bands of their estimated errors, and below each its errors."""
    columns = min(len(signals), 2)
    blocks = ceil(len(signals) / columns)
    size = max(5.2 * columns, 6.4), 0.6 + 4.8 * blocks
    figure, axes = new_figure(
        2 * blocks, columns, *size, sharex=True, height_ratios=(3, 2) * blocks
    )
    for place in range(blocks * columns):
        row, column = 2 * (place // columns), place % columns
        top, bottom = axes[row, column], axes[row + 1, column]
        if place >= len(signals):
            top.set_axis_off()
            bottom.set_axis_off()
            continue
        _error_band(top, finding, signals[place])
        _error_curves(bottom, finding, signals[place])
        if place + columns >= len(signals):
            bottom.tick_params(labelbottom=True)
            bottom.set_xlabel("time, s")
    figure.suptitle(f"{title}\n{finding.settings}", fontsize=10)
    _legend(figure, axes[0, 0])
    return save_figure(figure, stem)


def _errors(signal: Signal) -> list[tuple[str, str, str, Estimate]]:
    """Name, colour of lines, colour of bands and estimate of a signal's two errors."""
    errors = (signal.time, signal.mesh)
    return [(*style, error) for style, error in zip(ERROR_STYLES, errors, strict=True)]


def _error_band(axes: Axes, finding: Finding, signal: Signal) -> None:
    """A signal, around it its time error so far, and around that its mesh error so far."""
    factor, unit = shown(signal.unit)
    time, values = finding.time, factor * signal.values
    reach = np.zeros(len(time))
    axes.plot(time, values, color="black", linewidth=1.0, label=finding.case.run.label)
    for name, _, colour, error in _errors(signal):
        inner, reach = reach, reach + factor * error.running
        label = f"\N{PLUS-MINUS SIGN} {name}"
        axes.fill_between(
            time, values + inner, values + reach, color=colour, linewidth=0, label=label
        )
        axes.fill_between(time, values - reach, values - inner, color=colour, linewidth=0)
    start = _shade_unpredictable(axes, time, signal)
    if start is not None:
        _say_unpredictable(axes, start, time[-1], signal)
    axes.set_title(SIGNAL_TITLES.get(signal.name, signal.name), loc="left", fontsize=9)
    axes.set_ylabel(unit)
    axes.margins(x=0)


def _error_curves(axes: Axes, finding: Finding, signal: Signal) -> None:
    """The errors of a signal on a logarithmic axis."""
    factor, unit = shown(signal.unit)
    time, sizes = finding.time, []
    for place, (name, colour, _, error) in enumerate(_errors(signal)):
        if error.exact:
            text, where = f"{name}: none but round-off", (0.02, 0.9 - 0.13 * place)
            axes.annotate(text, where, xycoords="axes fraction", color=colour, fontsize=8)
            continue
        axes.plot(time, factor * error.local, color=colour, linewidth=0.5, alpha=0.6)
        axes.plot(time, factor * error.running, color=colour, linewidth=1.6)
        sizes.append(factor * error.largest)
    if sizes:
        axes.set_yscale("log")
        axes.set_ylim(min(sizes) / BELOW, max(sizes) * ABOVE)
    else:
        axes.set_yticks([])
    _shade_unpredictable(axes, time, signal)
    text = "estimated errors: at each time (thin), largest so far (bold)"
    axes.set_title(text, loc="left", fontsize=9)
    axes.set_ylabel(unit)
    axes.margins(x=0)


def _shade_unpredictable(axes: Axes, time: np.ndarray, signal: Signal) -> float | None:
    """Grey from when on a signal is not predictable: that time, s; None where it always is."""
    starts = [error.lost_at for *_, error in _errors(signal) if error.lost_at is not None]
    if not starts:
        return None
    axes.axvspan(min(starts), time[-1], color="0.93", linewidth=0, zorder=0)
    return min(starts)


def _say_unpredictable(axes: Axes, start: float, end: float, signal: Signal) -> None:
    """Words in the grey from ``start`` to ``end``, s, that say whose fault it is."""
    lost = [(name, error.lost_at) for name, *_, error in _errors(signal)]
    words = [f"{name}, after {at:.4g} s" for name, at in lost if at is not None]
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.1 * (1 + len(words)) * (high - low), high)  # room for them
    early = start < 0.6 * end
    axes.annotate(
        "\n".join(["not predictable:", *words]),
        (start if early else end, 0.02),
        xytext=(3 if early else -3, 0),
        textcoords="offset points",
        xycoords=("data", "axes fraction"),
        horizontalalignment="left" if early else "right",
        verticalalignment="bottom",
        color="0.25",
        fontsize=8,
    )
