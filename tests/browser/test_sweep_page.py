"""The page of a sweep in a headless browser: no errors, choices redraw, tables sort, a phone shows all of it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from scenetruth.design.sweep.page.write import write_page
from tests.design.sweep.test_page import over_two

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright: make browser")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs the system package chromium: make browser")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as started:
        # In a container there is no sandbox for root.
        opened = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture
def page(browser: Any, tmp_path: Path) -> Iterator[Any]:
    write_page(over_two(), tmp_path, "scenetruth design sweep cube.yaml")
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.errors = []
    page.on("console", lambda line: page.errors.append(line.text) if line.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    page.on("request", lambda one: None if one.url.startswith(("file:", "data:")) else page.errors.append(one.url))
    page.goto((tmp_path / "index.html").as_uri())
    page.wait_for_selector(".chart .main-svg")
    yield page
    assert page.errors == []
    page.close()


def test_choices_redraw(page: Any) -> None:
    assert page.locator(".chart.js-plotly-plot").count() == 2
    before = page.locator(".chart").nth(1).get_attribute("aria-label")
    page.select_option("#statistic", "bias")
    after = page.locator(".chart").nth(1).get_attribute("aria-label")
    assert before.startswith("Depth: rms error, mm, over stage.baseline_mm.")
    assert after.startswith("Depth: bias, mm, over stage.baseline_mm.")
    assert page.locator(".chart.js-plotly-plot").count() == 2
    # Charts keep to their places.
    for number in range(2):
        chart = page.locator(".chart").nth(number)
        assert chart.evaluate("one => one.querySelector('.main-svg').clientWidth <= one.clientWidth + 1")


def test_tables_sort(page: Any) -> None:
    page.locator("summary").click()
    button = page.locator("#points th:nth-child(6) button")
    button.click()
    cells = page.eval_on_selector_all(
        "#points tbody tr td:nth-child(6)", "cells => cells.map(cell => cell.textContent)"
    )
    assert cells == sorted(cells, key=float)
    button.press("Enter")
    assert page.locator("#points th:nth-child(6)").get_attribute("aria-sort") == "descending"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width_px", [1280, 375])
def test_it_reads_on_a_phone_and_by_those_who_do_not_see_it(page: Any, width_px: int, scheme: str) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs axe: make browser")
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": width_px, "height": 800})
    for closed in page.locator("details").all():
        closed.locator("summary").click()
    page.wait_for_timeout(300)
    assert page.evaluate("document.documentElement.scrollWidth") <= width_px
    found = axe.Axe().run(page)
    assert found.violations_count == 0, found.generate_report()
