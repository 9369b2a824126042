"""Tools of pages in a headless browser: definitions, copies and files of figures and data."""

from __future__ import annotations

import csv
import io
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenetruth.design.optimisation import write_design_page
from scenetruth.glossary import read_glossary
from scenetruth.scoring import score, write_report
from tests.helpers.browser_pages import opened
from tests.helpers.sample_design import design
from tests.helpers.synthetic_case import Case, make_case, with_error_bars


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_design_page(design(), tmp_path_factory.mktemp("design"))


@pytest.fixture
def page(browser: Any, file: Path) -> Iterator[Any]:
    with opened(browser, file, ".tools", accept_downloads=True) as page:
        yield page


@pytest.fixture(scope="module")
def case() -> Case:
    return with_error_bars(make_case(80, 60, frames=(-1, 0, 1)))


@pytest.fixture(scope="module")
def report_file(case: Case, tmp_path_factory: pytest.TempPathFactory) -> Path:
    result = score(case.estimate, case.truth, case.recording, settings={"interior_margin_px": 6})
    return write_report(
        case.estimate,
        case.truth,
        case.recording,
        score=result,
        output=tmp_path_factory.mktemp("report"),
        figures=("image",),
    )


@pytest.fixture
def report(browser: Any, report_file: Path) -> Iterator[Any]:
    with opened(browser, report_file, "html[data-ready]", accept_downloads=True) as page:
        yield page


def saved(page: Any, tools: Any, kind: str) -> bytes:
    tools.evaluate("one => { one.open = true; }")
    with page.expect_download() as found:
        tools.locator(f"button[data-tool=Save-{kind}]").click()
    assert found.value.suggested_filename.endswith(f".{kind}")
    return Path(found.value.path()).read_bytes()


def rows_of(content: bytes) -> list[list[str]]:
    return list(csv.reader(io.StringIO(content.decode("utf-8"))))


def test_every_figure_and_table_has_its_buttons(page: Any, report: Any) -> None:
    for opened_page in (page, report):
        tables = opened_page.locator("main table").count()
        charts = opened_page.locator(".chart, .drawings svg, main figure > img, .panel").count()
        assert tables + charts > 5
        # Profile and surface have theirs too.
        more = opened_page.locator("#profile-charts, #surface-plot").count()
        assert opened_page.locator("details.tools").count() == tables + charts + more


def test_the_data_of_a_chart_are_saved_as_they_are(page: Any) -> None:
    figure = page.locator("figure", has=page.locator("#chart-front-0-1"))
    head, *rows = rows_of(saved(page, figure.locator(".tools"), "csv"))
    assert head[0] == "series"
    data = page.evaluate("document.getElementById('chart-front-0-1').data")
    expected = [(trace.get("name", ""), x, y) for trace in data for x, y in zip(trace["x"], trace["y"], strict=True)]
    assert len(rows) == len(expected) > 100
    for row, (_, x, y) in zip(rows, expected, strict=True):
        for cell, value in zip(row[1:3], (x, y), strict=True):
            assert cell == "" if value is None else float(cell) == value
    # Simulations have the ends of their intervals.
    bars = next(trace for trace in data if trace.get("error_y"))
    at = next(row for row in rows if row[0] == bars["name"])
    assert float(at[5]) == pytest.approx(bars["y"][0] - bars["error_y"]["arrayminus"][0])
    assert float(at[6]) == pytest.approx(bars["y"][0] + bars["error_y"]["array"][0])


def test_a_table_is_saved_with_its_words_and_numbers(page: Any) -> None:
    tools = page.locator(".wide:has(#front) + .tools")
    head, *rows = rows_of(saved(page, tools, "csv"))
    assert head[:2] == ["rig", "on the front"]
    shown = page.eval_on_selector_all(
        "#front tbody tr", "rows => rows.map(row => Array.from(row.cells, cell => cell.textContent.trim()))"
    )
    assert len(rows) == len(shown) == 5
    for row, line in zip(rows, shown, strict=True):
        for cell, text in zip(row, line, strict=True):
            if text == "–":
                assert cell == ""
            elif text.replace(".", "").isdecimal():
                assert float(cell) == pytest.approx(float(text), rel=5e-3)
            else:
                assert cell == " ".join(text.split())


def test_a_chart_is_saved_as_svg_and_png_with_its_title(page: Any) -> None:
    figure = page.locator("figure", has=page.locator("#chart-front-0-1"))
    title = figure.locator("figcaption b").text_content()
    content = saved(page, figure.locator(".tools"), "svg").decode("utf-8")
    assert ET.fromstring(content).tag.endswith("svg")
    assert title in "".join(ET.fromstring(content).itertext())
    assert saved(page, figure.locator(".tools"), "png").startswith(b"\x89PNG")


def test_a_drawing_keeps_its_colours_in_its_file(page: Any) -> None:
    figure = page.locator(".drawings figure").first
    root = ET.fromstring(saved(page, figure.locator(".tools"), "svg"))
    styles = [one.get("style", "") for one in root.iter() if one.get("class") == "camera"]
    assert styles
    # The styles are no longer those of the page's sheet.
    assert all("fill: rgb" in style for style in styles)
    assert saved(page, figure.locator(".tools"), "png").startswith(b"\x89PNG")


def test_a_map_is_saved_with_its_values(report: Any, case: Case) -> None:
    report.select_option("#panel-count", "2")
    report.select_option("#panel-1", "depth:truth")
    report.wait_for_timeout(200)
    tools = report.locator(".panel").first.locator(".tools")
    head, *rows = rows_of(saved(report, tools, "csv"))
    assert head == ["x [px]", "y [px]", "Depth, truth [mm]"]
    exact = case.truth["depth"].sel(t=0).values
    assert len(rows) == exact.size
    limits = report.evaluate("scenetruthReport.data.groups.find((one) => one.name === 'depth').limits.value")
    for x, y, value in rows[:: len(rows) // 50]:
        expected = exact[int(y), int(x)]
        if value == "":
            assert not np.isfinite(expected)
        else:
            assert float(value) == pytest.approx(float(expected), abs=1e-4 * (limits[1] - limits[0]))
    root = ET.fromstring(saved(report, tools, "svg"))
    assert "Depth, truth [mm], t = 0" in "".join(root.itertext())
    assert saved(report, tools, "png").startswith(b"\x89PNG")


def test_a_profile_is_saved_with_its_lines(report: Any, case: Case) -> None:
    tools = report.locator("#profile-key + div .tools")
    report.locator("#profile-at").fill("20")
    report.wait_for_timeout(300)
    head, *rows = rows_of(saved(report, tools, "csv"))
    assert head[:3] == ["x [px]", "estimate [mm]", "truth [mm]"]
    exact = case.truth["depth"].sel(t=0).values[20]
    assert [float(row[2]) for row in rows if row[2]] == pytest.approx(exact[np.isfinite(exact)], rel=1e-4)
    assert len(ET.fromstring(saved(report, tools, "svg"))) == 2


def test_definitions_come_with_pointer_and_keyboard_and_go(page: Any) -> None:
    shown = page.locator("#definition")
    assert not shown.is_visible()
    term = page.locator("[data-term=rmse][tabindex]").first
    term.focus()
    assert shown.is_visible()
    assert read_glossary()["rmse"].text in shown.text_content()
    page.keyboard.press("Escape")
    assert not shown.is_visible()
    term.hover()
    assert shown.is_visible()
    box = shown.bounding_box()
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= 1280
    # A reader of screens gets the same words.
    described = term.get_attribute("aria-describedby")
    assert read_glossary()["rmse"].text in page.locator(f"#{described}").text_content()


LOOSE = """() => {
  const found = [], within = document.createTreeWalker(document.querySelector("main"), NodeFilter.SHOW_TEXT);
  while (within.nextNode()) {
    const node = within.currentNode;
    if (node.parentElement.closest("script, style, pre, code, select, textarea, svg, .chart, #viewer")) continue;
    if (/\\d (?:mm|px|%)(?![\\p{L}\\d])/u.test(node.data)) found.push(node.data);
  }
  return found;
}"""


def test_numbers_stay_on_a_line_with_their_units(report: Any) -> None:
    assert report.evaluate(LOOSE) == []
    assert report.evaluate("document.querySelector('main').textContent.includes('\\u00a0px')")


def test_small_figures_can_be_enlarged(report: Any) -> None:
    button, picture = report.locator("figure .enlarge").first, report.locator("main figure > img").first
    report.set_viewport_size({"width": 1280, "height": 800})
    report.wait_for_timeout(300)
    assert not button.is_visible()
    report.set_viewport_size({"width": 375, "height": 800})
    report.wait_for_timeout(300)
    before = picture.bounding_box()["width"]
    button.click()
    report.wait_for_timeout(300)
    assert picture.bounding_box()["width"] == float(picture.get_attribute("width")) > before
    # The figure scrolls, not the page.
    assert report.evaluate("document.documentElement.scrollWidth") <= 375
    button.click()
    report.wait_for_timeout(300)
    assert picture.bounding_box()["width"] == before


def test_wide_tables_say_that_there_is_more(page: Any) -> None:
    page.set_viewport_size({"width": 375, "height": 800})
    page.wait_for_timeout(300)
    around = page.locator(".wide:has(#front)")
    assert around.get_attribute("data-more") == "right"
    assert page.locator(".more:has(+ .wide:has(#front))").is_visible()
    around.evaluate("one => { one.scrollLeft = 1e6; }")
    page.wait_for_timeout(200)
    assert around.get_attribute("data-more") == "left"


@pytest.mark.parametrize("width_px", [1280, 375])
def test_titles_of_axes_keep_off_the_ticks(page: Any, width_px: int) -> None:
    page.set_viewport_size({"width": width_px, "height": 800})
    page.wait_for_timeout(800)
    boxes = page.evaluate(
        """() => Array.from(document.querySelectorAll(".chart")).map((chart) => {
             const box = (one) => { const b = one.getBoundingClientRect(); return [b.left, b.top, b.right, b.bottom]; };
             const all = (selector) => Array.from(chart.querySelectorAll(selector)).map(box);
             const others = ".xtick text, .ytick text, .legend .legendtext";
             return {titles: all(".xtitle, .ytitle"), others: all(others), chart: box(chart)};
           })"""
    )
    assert len(boxes) == 5
    for chart in boxes:
        for left, top, right, bottom in chart["titles"]:
            assert left >= chart["chart"][0] - 1
            assert right <= chart["chart"][2] + 1
            assert top >= chart["chart"][1] - 1
            assert bottom <= chart["chart"][3] + 1
            for x0, y0, x1, y1 in chart["others"]:
                assert right <= x0 or x1 <= left or bottom <= y0 + 1 or y1 <= top + 1
