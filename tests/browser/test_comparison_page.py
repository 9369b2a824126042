"""The page of a comparison in a headless browser: no errors, tables sort, plots answer, a phone shows all of it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from scenetruth.benchmark import compare
from tests.browser.pages import opened, reads_well


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("comparison") / "c"
    methods = ["structure_tensor", "plane_sweep", "opencv_scene_flow"]
    compare(methods, output=place, cases=["contrast", "occlusion", "star"])
    return place


@pytest.fixture
def page(browser: Any, folder: Path) -> Iterator[Any]:
    with opened(browser, folder / "index.html", ".chart .main-svg") as page:
        yield page


def column(page: Any, number: int) -> list[str]:
    found: list[str] = page.eval_on_selector_all(
        f"#summary tbody tr td:nth-child({number})", "cells => cells.map(cell => cell.textContent)"
    )
    return found


def test_tables_sort(page: Any) -> None:
    button = page.locator("#summary th:nth-child(2) button")
    button.click()
    assert page.locator("#summary th:nth-child(2)").get_attribute("aria-sort") == "ascending"
    rising = [float(cell) for cell in column(page, 2) if cell != "–"]
    assert rising == sorted(rising)
    button.click()
    assert [float(cell) for cell in column(page, 2) if cell != "–"] == rising[::-1]
    # By the keyboard too.
    page.locator("#summary th:nth-child(1) button").press("Enter")
    assert column(page, 1) == sorted(column(page, 1))


def test_who_is_ahead_is_read_without_scrolling(page: Any) -> None:
    assert page.locator("h2").first.text_content() == "Ranking"
    # OpenCV's flow resolves finer motion than the structure tensor with its usual window.
    first = page.locator("#ahead li").filter(has_text="Star")
    assert "opencv_scene_flow" in first.text_content()
    assert first.bounding_box()["y"] < 800
    page.locator("details summary").first.click()
    assert page.locator("#ahead-by-figures tbody tr").first.is_visible()


def test_values_with_names_are_named_on_the_axis(page: Any) -> None:
    names = page.locator("#chart-occlusion-disparity-rmse .xtick").all_text_contents()
    assert names == ["some", "all"]


def test_every_chart_is_drawn_and_answers(page: Any) -> None:
    charts = page.locator(".chart")
    assert charts.count() == page.locator(".chart .main-svg >> nth=0").count() * charts.count()
    assert page.locator(".chart:not(.js-plotly-plot)").count() == 0
    point = page.locator(".chart .points path").first
    point.scroll_into_view_if_needed()
    box = point.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.wait_for_selector(".hoverlayer .hovertext")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width_px", [1280, 375])
def test_it_reads_on_a_phone_and_by_those_who_do_not_see_it(page: Any, width_px: int, scheme: str) -> None:
    reads_well(page, width_px, scheme)
