"""The page of an error budget in a headless browser: charts are drawn, a phone shows all of it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from scenetruth.design.uncertainty import write_page
from tests.helpers.browser_pages import opened, reads_well
from tests.helpers.sample_budget import budget_of_a_cube


@pytest.fixture
def page(browser: Any, tmp_path: Path) -> Iterator[Any]:
    with opened(browser, write_page(budget_of_a_cube(), tmp_path), ".chart .main-svg") as page:
        yield page


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width_px", [1280, 375])
def test_it_reads_on_a_phone_and_by_those_who_do_not_see_it(page: Any, width_px: int, scheme: str) -> None:
    reads_well(page, width_px, scheme)
    assert page.locator(".chart .bars path").count() == 6
    # Words leave room for bars.
    assert page.locator(".chart .nsewdrag").first.bounding_box()["width"] > 100


def test_no_figure_loses_its_last_digits(browser: Any, tmp_path: Path) -> None:
    # Nine characters, as many as a figure has: 0.00014 mm, 5.0 × 10⁻⁶ mm.
    phone = {"width": 375, "height": 800}
    with opened(
        browser, write_page(budget_of_a_cube(scale=1e-4), tmp_path), ".chart .main-svg", viewport=phone
    ) as page:
        beyond = page.evaluate(
            """[...document.querySelectorAll('.chart .bartext')].map((one) => one.getBoundingClientRect().right
               - one.closest('.chart').getBoundingClientRect().right)"""
        )
    assert len(beyond) >= 5
    assert max(beyond) <= 0
