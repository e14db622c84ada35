"""Pictures: a scenario's comparison, and the paper's Figs. 4 to 7 with our numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from math import ceil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.recfunctions import repack_fields

from .compare import shown
from .places import house_matplotlib, whole_file
from .progress import Progress
from .scenario import Run, Scenario
from .tables import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .converge import Estimate, Finding, Signal
    from .instances import Instances

# Colours that stay apart for colour-blind eyes (after Okabe & Ito), each dashed in its own way, so
# that they do in grey too; the truth is black.
STYLES: tuple[dict[str, Any], ...] = (
    {"color": "black", "linewidth": 1.4},
    {"color": "#0072B2", "linewidth": 1.1, "linestyle": (0, (6, 1.5))},
    {"color": "#D55E00", "linewidth": 1.1, "linestyle": (0, (3, 1.5))},
    {"color": "#00795A", "linewidth": 1.1, "linestyle": (0, (1, 1.2))},
    {"color": "#A34F84", "linewidth": 1.1, "linestyle": (0, (6, 1.5, 1, 1.5))},
    {"color": "#7A6A00", "linewidth": 1.1, "linestyle": (0, (3, 1.2, 1, 1.2, 1, 1.2))},
)
RUN_STYLES = (*STYLES[:3], {"color": "0.6", "linewidth": 1.0})  # the last: for comparison
# What a signal is called on an axis; others by their name.
QUANTITIES = {
    "payload.x": "payload's position x",
    "payload.x_rel": "payload's sway",
    "chain.mid_x_rel": "chain's middle, rel.",
}
WIDTH = 125 / 25.4  # in, of a figure as a journal sets it; type is 8 pt then
TYPE = 8  # pt
PNG_DPI = 300
PNG_EFFORT = 3  # of 9: 6 takes half as long again, for a tenth less
# Name, colour of lines, colour of bands.
ERROR_STYLES = (("time error", "#D55E00", "#E69A66"), ("mesh error", "#0072B2", "#BFDCEC"))
BELOW, ABOVE = 100.0, 4.0  # an axis of errors reaches so far below the least and above the largest
SHAPE_TIMES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.08, 1.16, 1.24, 1.44, 2.0, 2.1, 2.2, 2.3)
SHAPE_X, SHAPE_Y = ([f"chain.{axis}[{i}]" for i in range(1, 11)] for axis in "xy")
MOTIONS = {  # file -> signal
    "fig5_payload_absolute": "payload.x",
    "fig6_payload_relative": "payload.x_rel",
    "fig7_middle_relative": "chain.mid_x_rel",
}

Results = dict[str, Table]
Panels = Sequence[tuple[str, Scenario, Results]]  # with their labels


@dataclass(frozen=True)
class Drawing:
    """A figure as a worker's work: to draw the paper's takes longer than to run them."""

    draw: Callable[..., list[Path]]  # a function of this module, its last argument the stem
    panels: Panels
    what: Any  # its second argument
    stem: Path

    @property
    def name(self) -> str:
        """What messages call it."""
        return str(self.stem)

    def run(
        self, _instances: Instances, _progress: Progress | None = None
    ) -> list[tuple[Path, bytes]]:
        """Draw it: each file's path, and what is to be written there.

        A worker may be stopped at any time, and would leave half a file.
        """
        with TemporaryDirectory() as folder:
            drawn = self.draw(self.panels, self.what, Path(folder, self.stem.name))
            return [(self.stem.with_name(file.name), file.read_bytes()) for file in drawn]


def papers_figures(panels: Panels, out: Path) -> list[Drawing]:
    """The paper's Figs. 4 to 7, the one that takes longest first; each with what it shows alone."""
    at_times = [
        (label, one, {run: _at(table, SHAPE_TIMES) for run, table in results.items()})
        for label, one, results in panels
    ]
    shapes = _only(at_times, ("trolley.x", *SHAPE_X, *SHAPE_Y))
    return [
        Drawing(shape_figure, shapes, SHAPE_TIMES, out / "fig4_shapes"),
        *(
            Drawing(motion_figure, _only(panels, (signal,)), signal, out / stem)
            for stem, signal in MOTIONS.items()
        ),
    ]


def _only(panels: Panels, signals: Sequence[str]) -> Panels:
    """Panels with some signals, packed: a pipe takes them at once."""

    def packed(table: Table) -> Table:
        some: Table = repack_fields(table[["time", *signals]])
        return some

    return [
        (label, one, {run: packed(table) for run, table in results.items()})
        for label, one, results in panels
    ]


def _at(table: Table, times: Sequence[float]) -> Table:
    """The rows of a table that are nearest to some times, s."""
    rows: Table = table[[int(np.argmin(np.abs(table["time"] - time))) for time in times]]
    return rows


def new_figure(
    rows: int, columns: int, width: float, height: float, **more: Any
) -> tuple[Figure, np.ndarray]:
    house_matplotlib()
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update(
        {
            "font.size": TYPE,
            "axes.titlesize": TYPE,
            "axes.titley": 1.0,
            "axes.labelsize": TYPE,
            "xtick.labelsize": TYPE,
            "ytick.labelsize": TYPE,
            "legend.fontsize": TYPE,
            "figure.titlesize": TYPE,
            "pdf.fonttype": 42,  # letters stay letters
            "ps.fonttype": 42,  # Matplotlib 3.11 asks this of PDFs, and else embeds a minus apart
            "lines.solid_capstyle": "butt",
            "axes.grid": True,
            "grid.alpha": 0.25,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "figure.autolayout": False,  # save_figure lays out, whatever a user's own settings say
            "figure.constrained_layout.use": False,
            "svg.hashsalt": "chaincrane",  # the same picture is the same file
            "svg.fonttype": "none",
        }
    )
    figure, axes = plt.subplots(
        rows, columns, figsize=(width, height), squeeze=False, layout="constrained", **more
    )
    return figure, axes


def save_figure(figure: Figure, stem: Path) -> list[Path]:
    """Write a figure as PNG, SVG and PDF, the last two the same bytes each time; the paths."""
    import matplotlib.pyplot as plt
    from matplotlib.text import Text

    kinds: dict[str, dict[str, Any]] = {
        "png": {"dpi": PNG_DPI, "pil_kwargs": {"compress_level": PNG_EFFORT}},
        "svg": {"metadata": {"Date": None}},
        "pdf": {"metadata": {"CreationDate": None}},
    }
    for text in figure.findobj(Text):
        if hasattr(text, "set_fontfeatures"):  # from Matplotlib 3.11 on there are ligatures,
            text.set_fontfeatures(("-liga",))  # and a PDF has a second font for that of "ff"
    # Laid out here, once, as in the PNG: a figure with a layout engine is drawn twice in each file,
    # first to lay it out.
    figure.set_dpi(PNG_DPI)
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.execute(figure)
    figure.set_layout_engine(None)
    for kind, more in kinds.items():
        with whole_file(stem.with_suffix(f".{kind}")) as partial:
            figure.savefig(partial, format=kind, **more)
    plt.close(figure)
    return [stem.with_suffix(f".{kind}") for kind in kinds]


def quantity(signal: str, unit: str) -> str:
    """An axis' name: the quantity and its unit."""
    name = QUANTITIES.get(signal, signal)
    return f"{name}, {unit}" if unit else name


def _curves(axes: Axes, runs: Sequence[Run], results: Results, signal: str, factor: float) -> None:
    for run, style in zip(runs, cycle(STYLES), strict=False):
        table = results[run.name]
        axes.plot(table["time"], factor * table[signal], label=run.label, **style)
    axes.margins(x=0)


def _differences(
    axes: Axes, runs: Sequence[Run], results: Results, signal: str, factor: float
) -> None:
    """Each run's signal less the first run's, in the runs' styles."""
    truth = results[runs[0].name]
    for run, style in list(zip(runs, cycle(STYLES), strict=False))[1:]:
        axes.plot(truth["time"], factor * (results[run.name][signal] - truth[signal]), **style)
    axes.margins(x=0)


def comparison(
    scenario: Scenario, results: Results, units: Mapping[str, str | None], stem: Path
) -> list[Path]:
    """Each signal looked at, of all runs, and below it their differences to the first run."""
    count = len(scenario.look_at)
    width = WIDTH * max(1.0, count / 2)
    figure, axes = new_figure(2, count, width, 3.6, sharex=True, height_ratios=(2, 1.2))
    for column, signal in enumerate(scenario.look_at):
        top, bottom = axes[0, column], axes[1, column]
        factor, unit = shown(units[signal])
        _curves(top, scenario.runs, results, signal, factor)
        top.set_ylabel(quantity(signal, unit))
        _differences(bottom, scenario.runs, results, signal, factor)
        bottom.set_ylabel(f"difference, {unit}")
        bottom.set_xlabel("time, s")
    figure.suptitle(f"{scenario.title}; below: less {scenario.runs[0].label}")
    _legend(figure, axes[0, 0])
    return save_figure(figure, stem)


def _legend(figure: Figure, axes: Axes) -> None:
    """A legend below the panels, in as many columns as the figure is wide enough for."""
    handles, labels = axes.get_legend_handles_labels()
    longest = max(map(len, labels))
    columns = int(figure.get_figwidth() * 72 / (TYPE * (0.55 * longest + 5)))
    columns = min(len(labels), max(1, columns))
    rows = ceil(len(labels) / columns)
    columns = ceil(len(labels) / rows)  # four in two rows of two, not of three and one
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)


def motion_figure(panels: Panels, signal: str, stem: Path) -> list[Path]:
    """One signal, a column for each payload (Figs. 5 to 7): linear cranes on the nonlinear.

    Below it the differences to the nonlinear one, as the curves themselves nearly coincide.
    """
    size = WIDTH, 3.4
    figure, axes = new_figure(
        2, len(panels), *size, sharex=True, sharey="row", height_ratios=(2, 1.1)
    )
    for place, (name, scenario, results) in enumerate(panels):
        runs = tuple(run for run in scenario.runs if run.name != "massless")
        top, bottom = axes[0, place], axes[1, place]
        _curves(top, runs, results, signal, 1e3)
        _differences(bottom, runs, results, signal, 1e3)
        top.set_title(f"{'ab'[place]}) {name}", loc="left")
        bottom.set_xlabel("time, s")
    axes[0, 0].set_ylabel(quantity(signal, "mm"))
    axes[1, 0].set_ylabel("difference, mm")
    _legend(figure, axes[0, 0])
    return save_figure(figure, stem)


def shape_colours(count: int) -> list[Any]:
    """So many colours from early to late; the last, too, stands out from white by 3:1."""
    import matplotlib

    colours = matplotlib.colormaps["plasma"]
    return [colours(0.6 * place / max(1, count - 1)) for place in range(count)]


def shape_figure(panels: Panels, times: tuple[float, ...], stem: Path) -> list[Path]:
    """Position and shape of the chain at some times (Fig. 4), nonlinear and linear side by side."""
    figure, axes = new_figure(len(panels), 2, WIDTH, 1.75 * len(panels), sharex=True, sharey=True)
    colours = shape_colours(len(times))
    for row, (name, scenario, results) in enumerate(panels):
        for column, run in enumerate(scenario.runs[:2]):
            panel, at = axes[row, column], _at(results[run.name], times)
            x = np.array([at[name] for name in ("trolley.x", *SHAPE_X)])
            y = np.array([np.zeros(len(at)), *(at[name] for name in SHAPE_Y)])
            chains = panel.plot(x, y, linewidth=0.9)
            for chain, time, colour in zip(chains, times, colours, strict=True):
                chain.set(color=colour, label=f"{time:.2f}")
            for place, marker, size in ((-1, "o", 2.5), (0, "s", 2.0)):  # payload, trolley
                look = {"c": colours, "marker": marker, "s": size**2, "linewidths": 1.0}
                panel.scatter(x[place], y[place], zorder=2, **look)
            panel.set_aspect("equal")
            kind = run.label.partition(",")[0]
            panel.set_title(f"{'abcd'[2 * row + column]}) {name}, {kind}", loc="left")
            panel.tick_params(labelbottom=True, labelleft=True)
            panel.set_xlabel("x, m")
        axes[row, 0].set_ylabel("y, m")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside right center", title="time, s", frameon=False, handlelength=1
    )
    return save_figure(figure, stem)


def antisway_figure(
    runs: list[tuple[str, Table]],
    bars: list[tuple[str, float, float]],
    push: tuple[float, float] | None,
    title: str,
    stem: Path,
) -> list[Path]:
    """Position, sway, estimate against truth, command; below, bars of settling and residual.

    The first run is the one estimated. ``bars``: label, s (nan: it does not settle), mm. ``push``:
    when one begins and ends, s.
    """
    figure, axes = new_figure(3, 2, 1.3 * WIDTH, 6.0)
    panels = (
        ("crane::payload.x", 1.0, "payload's position x", "m"),
        ("crane::payload.x_rel", 1e3, "payload's sway", "mm"),
        ("antisway::trolley.a_cmd", 1.0, "command", "m/s²"),
    )
    for place, (name, scale, text, unit) in zip((0, 1, 3), panels, strict=True):
        panel = axes.flat[place]
        for (label, table), style in zip(runs, RUN_STYLES, strict=False):
            panel.plot(table["time"], scale * table[name], label=label, **style)
        panel.set_ylabel(f"{text}, {unit}")
        panel.margins(x=0)
    time, first = runs[0][1]["time"], runs[0][1]
    gap = 1e3 * (first["observer::payload.x_rel"] - first["crane::payload.x_rel"])
    band = 2e3 * first["observer::std.payload.x_rel"]
    panel = axes[1, 0]
    panel.fill_between(time, -band, band, color="0.88", linewidth=0, label="twice its deviation")
    panel.plot(time, gap, color="black", linewidth=1.0, label="estimate less truth")
    panel.legend(frameon=False, loc="upper right")
    panel.set_ylabel("error of estimate, mm")
    panel.margins(x=0)
    low, high = panel.get_ylim()
    panel.set_ylim(low, high + 0.4 * (high - low))  # room for the legend
    for panel in axes[:2].flat:
        panel.set_xlim(time[0], time[-1])
        if push is not None:
            panel.axvspan(*push, color="0.8", linewidth=0)
    for panel in axes[1]:
        panel.set_xlabel("time, s")
    _bars(axes[2, 0], [(label, settling) for label, settling, _ in bars], "settles, s")
    _bars(axes[2, 1], [(label, residual) for label, _, residual in bars], "residual sway, mm")
    axes[2, 1].set_yticklabels([])
    figure.suptitle(title)
    _legend(figure, axes[0, 0])
    return save_figure(figure, stem)


def _bars(axes: Axes, bars: list[tuple[str, float]], text: str) -> None:
    """A bar for each run, its number at its end; "-" where there is none."""
    labels, lengths = zip(*bars, strict=True)
    there = [0.0 if np.isnan(length) else length for length in lengths]
    places = np.arange(len(bars))[::-1]
    axes.barh(places, there, color="0.6", height=0.6)
    for place, length in zip(places, lengths, strict=True):
        number = " does not settle" if np.isnan(length) else f" {length:.2f}"
        axes.text(0.0 if np.isnan(length) else length, place, number, va="center")
    axes.set_yticks(places, labels)
    axes.set_xlabel(text)
    axes.set_xlim(0.0, 1.25 * max(max(there), 1e-9))


def study_figure(panels: list[tuple[str, list[tuple[str, Table]]]], stem: Path) -> list[Path]:
    """Sway and command of several moves, a column for each payload."""
    figure, axes = new_figure(2, len(panels), WIDTH, 3.6, sharex=True, sharey="row")
    for column, (label, runs) in enumerate(panels):
        for (name, whole), style in zip(runs, RUN_STYLES, strict=False):
            table = whole[whole["time"] <= 8.0][::2]
            axes[0, column].plot(
                table["time"], 1e3 * table["crane::payload.x_rel"], label=name, **style
            )
            axes[1, column].plot(table["time"], table["antisway::trolley.a_cmd"], **style)
        axes[0, column].set_title(f"{'ab'[column]}) {label} payload", loc="left")
        axes[1, column].set_xlabel("time, s")
        axes[0, column].margins(x=0)
    axes[0, 0].set_ylabel("payload's sway, mm")
    axes[1, 0].set_ylabel("command, m/s²")
    figure.suptitle("1 m within 0.5 m/s and 1 m/s²; rope-angle sensor, 0.5 degree noise")
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
    figure.suptitle(f"{title}\n{finding.settings}")
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
    axes.set_ylabel(quantity(signal.name, unit))
    axes.margins(x=0)


def _error_curves(axes: Axes, finding: Finding, signal: Signal) -> None:
    """The errors of a signal on a logarithmic axis."""
    factor, unit = shown(signal.unit)
    time, sizes = finding.time, []
    for place, (name, colour, _, error) in enumerate(_errors(signal)):
        if error.exact:
            text, where = f"{name}: none but round-off", (0.02, 0.9 - 0.13 * place)
            axes.annotate(text, where, xycoords="axes fraction", color=colour)
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
    axes.set_title(text, loc="left")
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
    )
