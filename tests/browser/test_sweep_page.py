"""The page of a sweep in a headless browser: no errors, choices redraw, tables sort, a phone shows all of it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from scenetruth.design.sweeps import write_sweep_report
from tests.helpers.browser_pages import opened, reads_well
from tests.helpers.sample_sweep import over_two


@pytest.fixture
def page(browser: Any, tmp_path: Path) -> Iterator[Any]:
    write_sweep_report(over_two(), tmp_path, "scenetruth design sweep cube.yaml")
    with opened(browser, tmp_path / "index.html", ".chart .main-svg") as page:
        yield page


def test_choices_redraw(page: Any) -> None:
    assert page.locator(".chart.js-plotly-plot").count() == 2
    before = page.locator(".chart").nth(1).get_attribute("aria-label")
    page.select_option("#statistic", "bias")
    after = page.locator(".chart").nth(1).get_attribute("aria-label")
    assert before.startswith("Depth: RMSE, mm, over baseline, mm.")
    assert after.startswith("Depth: bias, mm, over baseline, mm.")
    assert page.locator(".chart.js-plotly-plot").count() == 2
    # Charts keep to their places.
    for number in range(2):
        chart = page.locator(".chart").nth(number)
        assert chart.evaluate("one => one.querySelector('.main-svg').clientWidth <= one.clientWidth + 1")


def test_tables_sort(page: Any) -> None:
    page.locator("section[aria-labelledby=numbers] > details > summary").click()
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
    reads_well(page, width_px, scheme)
