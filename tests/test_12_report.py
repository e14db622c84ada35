"""Rung 12, the report: in a real browser, Chromium, with no network. References: the results."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT

from chaincrane_driver import cli

sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
WIDE, PHONE = (1280, 900), (360, 740)  # pixels


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("no chromium here")
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def reports(fmus: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The report of the paper's light payload, and that of the closed loop."""
    out = tmp_path_factory.mktemp("reports")
    common = ["--fmus", str(fmus), "--out", str(out)]
    assert cli.main(["report", str(ROOT / "scenarios" / "paper_light"), *common]) == 0
    assert cli.main(["antisway", "--stop", "6", *common]) == 0
    return {"paper_light": out / "paper_light.html", "antisway": out / "antisway.html"}


@pytest.fixture
def page(browser: Any, request: pytest.FixtureRequest) -> Iterator[Any]:
    """A page that fails the test where the console shows an error or the network is asked."""
    width, height = getattr(request, "param", WIDE)
    context = browser.new_context(viewport={"width": width, "height": height}, offline=True)
    page, troubles = context.new_page(), []
    page.on("console", lambda message: troubles.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: troubles.append(str(error)))
    page.on("requestfailed", lambda one: troubles.append(f"failed: {one.url}"))
    page.on("request", lambda one: None if one.url[:4] == "file" else troubles.append(one.url))
    yield page
    assert not troubles
    context.close()


PAYLOAD = "[data-run='0'] circle"


def place(page: Any) -> tuple[float, float]:
    """Where the first run's payload is drawn, pixels."""
    at = page.locator(PAYLOAD)
    return float(at.get_attribute("cx")), float(at.get_attribute("cy"))


def cursors(page: Any) -> list[float]:
    """The time at which each curve's cursor stands, s: from pixels, by the axis' own labels."""
    return list(
        page.evaluate(
            """() => [...document.querySelectorAll('.plot svg')].map(svg => {
                const marks = [...svg.querySelectorAll('text[text-anchor=middle]')]
                    .map(text => [+text.getAttribute('x'), parseFloat(text.textContent)]);
                const [a, b] = [marks[0], marks.at(-1)];
                const x = +svg.querySelector('.cursor').getAttribute('x1');
                return a[1] + (x - a[0]) / (b[0] - a[0]) * (b[1] - a[1]);
            })"""
        )
    )


def clock(page: Any) -> float:
    return float(page.locator("#clock").text_content().split()[0])


@pytest.mark.parametrize("page", [WIDE, PHONE], indirect=True, ids=["wide", "phone"])
@pytest.mark.parametrize("name", ["paper_light", "antisway"])
def test_it_plays_and_stops(page: Any, reports: dict[str, Path], name: str) -> None:
    page.goto(reports[name].as_uri())
    start = place(page)
    page.locator("#play").click()
    sync_api.expect(page.locator("#clock")).to_contain_text(re.compile(r"[1-9]\.\d"), timeout=30e3)
    assert page.locator("#play").text_content() == "Pause"
    page.locator("#play").click()
    assert place(page) != start
    stopped = clock(page)
    page.wait_for_timeout(200)
    assert clock(page) == stopped
    assert cursors(page) == pytest.approx([stopped] * len(cursors(page)), abs=0.012)
    # nothing is wider than the screen
    wide = page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    assert wide[0] <= wide[1]


def test_the_cursor_is_where_the_slider_is(page: Any, reports: dict[str, Path]) -> None:
    page.goto(reports["paper_light"].as_uri())
    slider = page.locator("#time")
    for row, time in ((0, 0.0), (200, 1.0), (437, 2.185), (800, 4.0)):
        slider.fill(str(row))
        assert clock(page) == pytest.approx(time, abs=0.006)
        assert cursors(page) == pytest.approx([time] * len(cursors(page)), abs=0.006)


def test_the_crane_is_to_scale_and_where_the_result_is(
    page: Any, reports: dict[str, Path], fmus: Path
) -> None:
    """The payload's places in pixels are those of the result, by one factor for x and y."""
    page.goto(reports["paper_light"].as_uri())
    told = page.evaluate("[0, 300, 700].map(k => [runs[0].x[k].at(-1), runs[0].y[k].at(-1)])")
    drawn = []
    for row in (0, 300, 700):
        page.locator("#time").fill(str(row))
        drawn.append(place(page))
    factor = (drawn[1][0] - drawn[0][0]) / (told[1][0] - told[0][0])
    for (x, y), (told_x, told_y) in zip(drawn, told, strict=True):
        assert x - drawn[0][0] == pytest.approx(factor * (told_x - told[0][0]), abs=0.01)
        assert y - drawn[0][1] == pytest.approx(-factor * (told_y - told[0][1]), abs=0.01)


def test_keyboard_speed_and_drag(page: Any, reports: dict[str, Path]) -> None:
    page.goto(reports["paper_light"].as_uri())
    press = page.keyboard.press
    press("End")
    assert clock(page) == 4.0
    press("Home")
    press("ArrowRight")
    press("Shift+ArrowRight")
    assert clock(page) == pytest.approx(0.055, abs=0.006)
    press("-")
    assert page.locator("#speed").input_value() == "0.5"
    press(" ")
    page.wait_for_timeout(300)
    press(" ")
    assert 0.055 < clock(page) < 1.0
    box = page.locator(".plot svg").first.bounding_box()
    page.locator(".plot svg").first.click(position={"x": box["width"] / 2, "y": 80})
    assert clock(page) == pytest.approx(2.0, abs=0.1)


def test_runs_can_be_hidden(page: Any, reports: dict[str, Path]) -> None:
    page.goto(reports["paper_light"].as_uri())
    ghosts, curves = page.locator(".ghost:visible"), page.locator(".plot .curve")
    assert ghosts.count() == 3
    before = curves.count()
    page.get_by_label("massless rope").uncheck()
    assert ghosts.count() == 2 and curves.count() < before


@pytest.mark.parametrize("page", [PHONE], indirect=True)
def test_settings_fit_a_phone(page: Any, reports: dict[str, Path]) -> None:
    page.goto(reports["antisway"].as_uri())
    beyond = "(e => e.scrollWidth - e.clientWidth)(document.querySelector('.settings'))"
    assert page.evaluate(beyond) == 0


def test_nothing_is_minus_zero(page: Any, reports: dict[str, Path]) -> None:
    """When it has settled the trolley stands, within rounding of either sign."""
    page.goto(reports["antisway"].as_uri())
    told = page.evaluate(
        """() => {
            const slider = document.querySelector("input[type=range]"), told = [];
            for (let row = 0; row <= +slider.max; row += 10) {
                slider.value = row;
                slider.dispatchEvent(new Event("input"));
                told.push(...[...document.querySelectorAll(".now")].map(one => one.textContent));
            }
            return told.join(" ");
        }"""
    )
    assert " 0.0000 m/s" in told
    assert not re.search(r"-0\.0* ", told)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_can_be_read_in_the_dark(page: Any, reports: dict[str, Path], scheme: str) -> None:
    page.emulate_media(color_scheme=scheme)
    page.goto(reports["antisway"].as_uri())
    style = "getComputedStyle(document.body)"
    colours = page.evaluate(f"[{style}.color, {style}.backgroundColor]")
    assert contrast(*colours) > 7.0  # WCAG AAA
    for n in range(3):
        curve = f"getComputedStyle(document.querySelector('.plot .curve.r{n}')).stroke"
        assert contrast(page.evaluate(curve), colours[1]) > 3.0  # WCAG, of what is no text


def contrast(one: str, other: str) -> float:
    """WCAG's contrast ratio of two colours as CSS writes them, rgb(0, 114, 178)."""

    def luminance(colour: str) -> float:
        parts = [int(part) / 255 for part in colour[colour.index("(") + 1 : -1].split(",")[:3]]
        linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    light, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def test_it_is_one_file_with_differences_and_settings(reports: dict[str, Path]) -> None:
    text = reports["paper_light"].read_text()
    assert len(text) < 1_000_000
    assert (
        "http://www.w3.org/2000/svg" in text and "https:" not in text and text.count("http:") == 1
    )  # a name, no address
    for part in ("39.96 mm", "payload.mass = 0.07", "crane_nl.fmu", "fmpy 0.3.32"):
        assert part in text


def test_one_run_alone(fmus: Path, tmp_path: Path) -> None:
    folder = str(ROOT / "scenarios" / "payload_push")
    options = ["--run", "linear_2", "--fmus", str(fmus), "--out", str(tmp_path)]
    assert cli.main(["report", folder, *options]) == 0
    text = (tmp_path / "payload_push.html").read_text()
    assert "How large" in text and "Differences to" not in text
