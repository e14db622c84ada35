"""Rung 7, the figures, as a journal takes them. Drawn from the references: no FMU runs."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import ROOT

from chaincrane_driver import plots, scenario
from chaincrane_driver.compare import shown
from chaincrane_driver.instances import Instances
from chaincrane_driver.scenario import Run, Scenario
from chaincrane_driver.tables import Table, read_table

SVG = "{http://www.w3.org/2000/svg}"
POINT = 25.4 / 72  # mm
WHITE = 1.05  # relative luminance, and what WCAG adds


def results(one: Scenario) -> dict[str, Table]:
    return {run.name: read_table(one.reference(run)) for run in one.runs}


@pytest.fixture(scope="module")
def panels() -> list[tuple[str, Scenario, dict[str, Table]]]:
    names = ("paper_heavy", "paper_light")
    loaded = [scenario.load(ROOT / "scenarios" / name) for name in names]
    return [(one.title.partition(",")[0], one, results(one)) for one in loaded]


def texts(svg: Path) -> list[tuple[str, float]]:
    """Texts of a picture, with the height of their type, pt."""
    found = []
    for node in ElementTree.parse(svg).iter(f"{SVG}text"):
        (size,) = re.findall(r"font(?:-size)?: ([\d.]+)px", node.get("style") or "")
        found.append(("".join(node.itertext()).strip(), float(size)))
    return found


def width(svg: Path) -> float:
    """Width of a picture, mm."""
    return float((ElementTree.parse(svg).getroot().get("width") or "").removesuffix("pt")) * POINT


def luminance(colour: str) -> float:
    """WCAG's relative luminance of a colour that matplotlib knows."""
    from matplotlib.colors import to_rgb

    parts = np.array(to_rgb(colour))
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast_on_white(colour: str) -> float:
    return WHITE / (luminance(colour) + 0.05)


def test_the_papers_figures(
    panels: list[tuple[str, Scenario, dict[str, Table]]], tmp_path: Path
) -> None:
    png, svg, pdf = plots.motion_figure(panels, "payload.x_rel", tmp_path / "fig6")
    assert [path.suffix for path in (png, svg, pdf)] == [".png", ".svg", ".pdf"]
    assert pdf.read_bytes().startswith(b"%PDF")
    assert width(svg) == pytest.approx(125.0, abs=0.1)
    told = texts(svg)
    assert min(size for _, size in told) >= 8.0
    words = [text for text, _ in told]
    assert {"payload's sway, mm", "difference, mm", "time, s"} <= set(words)
    assert not [text for text in words if "paper" in text]
    again = plots.motion_figure(panels, "payload.x_rel", tmp_path / "again")
    for one, other in zip((svg, pdf), again[1:], strict=True):
        assert one.read_bytes() == other.read_bytes()


def test_a_worker_writes_no_figure_where_it_goes(
    panels: list[tuple[str, Scenario, dict[str, Table]]], tmp_path: Path
) -> None:
    """It is killed by Ctrl-C, and would leave half of one."""
    out = tmp_path / "out"
    shapes, *motions = plots.papers_figures(panels, out)
    assert len(motions) == 3 and not out.exists()
    files = dict(shapes.run(Instances()))
    assert not out.exists()
    assert [path.parent for path in files] == [out] * 3
    assert files[out / "fig4_shapes.pdf"].startswith(b"%PDF")
    assert files[out / "fig4_shapes.png"].startswith(b"\x89PNG")


def test_every_chain_of_figure_4_is_seen_and_dated(
    panels: list[tuple[str, Scenario, dict[str, Table]]], tmp_path: Path
) -> None:
    colours = plots.shape_colours(len(plots.SHAPE_TIMES))
    assert min(map(contrast_on_white, colours)) >= 3.0  # WCAG, of what is no text
    _, svg, _ = plots.shape_figure(panels, plots.SHAPE_TIMES, tmp_path / "fig4")
    words = [text for text, _ in texts(svg)]
    assert min(size for _, size in texts(svg)) >= 8.0
    assert {f"{time:.2f}" for time in plots.SHAPE_TIMES} <= set(words)  # listed
    assert words.count("0.5") == 4  # each panel has numbers at its ticks
    assert width(svg) == pytest.approx(125.0, abs=0.1)


def test_runs_are_told_apart_without_colour() -> None:
    dashes = [repr(style.get("linestyle", "-")) for style in plots.STYLES]
    assert len(dashes) == len(set(dashes)) >= 6
    assert all(contrast_on_white(style["color"]) >= 3.0 for style in plots.STYLES)


def test_six_runs_and_their_legend_fit_the_page(
    panels: list[tuple[str, Scenario, dict[str, Table]]], tmp_path: Path
) -> None:
    """Labels of 34 letters: the legend gets more rows, and no text is cut."""
    import matplotlib.pyplot as plt
    from matplotlib.figure import Figure

    _, one, tables = panels[1]
    labels = [f"run {n}, of a rather long description" for n in range(6)]
    runs = tuple(Run(str(n), label, "crane_nl.fmu") for n, label in enumerate(labels))
    many = replace(one, runs=runs)
    values = {str(n): tables["nonlinear"] for n in range(6)}
    kept: list[Figure] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plt, "close", kept.append)
        plots.comparison(many, values, {s: "m" for s in one.look_at}, tmp_path / "six")
    (figure,) = kept
    figure.canvas.draw()
    box = figure.legends[0].get_window_extent()
    assert box.x0 >= 0 and box.y0 >= 0
    assert box.x1 <= figure.bbox.width and box.y1 <= figure.bbox.height
    plt.close("all")


@pytest.mark.parametrize(
    ("unit", "name"), [("m/s2", "m/s²"), ("rad", "mrad"), ("m", "mm"), ("N.s", "N s"), (None, "")]
)
def test_units_as_they_are_set(unit: str | None, name: str) -> None:
    assert shown(unit)[1] == name
