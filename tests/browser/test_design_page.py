"""The page of a design in a headless browser: no errors, tables sort, plots answer, files are saved, phones show it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from scenetruth.design.optimisation import write_design_page
from tests.helpers.browser_pages import opened, reads_well
from tests.helpers.sample_design import design


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_design_page(design(), tmp_path_factory.mktemp("design"))


@pytest.fixture
def page(browser: Any, file: Path) -> Iterator[Any]:
    with opened(browser, file, ".chart .main-svg", accept_downloads=True) as page:
        yield page


def column(page: Any, table: str, number: int) -> list[str]:
    found: list[str] = page.eval_on_selector_all(
        f"#{table} tbody tr td:nth-child({number})", "cells => cells.map(cell => cell.textContent)"
    )
    return found


def test_alternatives_sort_by_numbers_and_by_words(page: Any) -> None:
    simulated = page.locator("#front th:nth-child(4) button")
    simulated.click()
    assert page.locator("#front th:nth-child(4)").get_attribute("aria-sort") == "ascending"
    assert column(page, "front", 4) == ["0.0265", "0.0530", "0.106", "–", "–"]
    simulated.click()
    # What was not simulated stays at the end.
    assert column(page, "front", 4) == ["0.106", "0.0530", "0.0265", "–", "–"]
    # By the keyboard too, and by what intervals begin with.
    page.locator("#front th:nth-child(5) button").press("Enter")
    assert column(page, "front", 5)[0].startswith("0.0238 to")
    page.locator("#constraints th:nth-child(1) button").click()
    assert column(page, "constraints", 1) == sorted(column(page, "constraints", 1))


def test_the_answer_is_read_without_scrolling(page: Any) -> None:
    card = page.locator(".card").nth(1)
    assert "0.309 %/h" in card.text_content()
    assert "Undecided" in card.text_content()
    assert page.locator("#limits").bounding_box()["y"] < 800


def test_every_chart_is_drawn_and_tells_which_rig_a_point_is(page: Any) -> None:
    assert page.locator(".chart").count() == 5
    assert page.locator(".chart:not(.js-plotly-plot)").count() == 0
    # The first trace is the cloud of all predictions, which says nothing.
    point = page.locator("#chart-front-0-1 .scatterlayer .trace").nth(1).locator(".points path").first
    point.scroll_into_view_if_needed()
    box = point.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.wait_for_selector(".hoverlayer .hovertext")
    text = page.locator(".hoverlayer .hovertext").text_content()
    assert "Rig 642" in text
    assert "baseline 16 mm" in text


def test_simulations_have_bars_both_ways(page: Any) -> None:
    assert page.locator("#chart-front-0-1 .errorbar path.xerror").count() == 3
    assert page.locator("#chart-front-0-1 .errorbar path.yerror").count() == 3


def test_scene_files_are_saved_as_they_are_shown(page: Any, tmp_path: Path) -> None:
    with page.expect_download() as found:
        page.locator("#download").click()
    assert found.value.suggested_filename == "recommended.yaml"
    found.value.save_as(tmp_path / "recommended.yaml")
    text = (tmp_path / "recommended.yaml").read_text(encoding="utf-8")
    assert yaml.safe_load(text) == design().recommended.scene
    assert page.locator("section[aria-labelledby=scene] pre").text_content() == text


def test_a_wide_screen_has_the_lying_drawing_a_phone_the_upright_one(page: Any) -> None:
    lying, upright = page.locator("#drawing-whole"), page.locator("#drawing-upright")
    assert (lying.is_visible(), upright.is_visible()) == (True, False)
    page.set_viewport_size({"width": 375, "height": 800})
    assert (lying.is_visible(), upright.is_visible()) == (False, True)


@pytest.mark.parametrize("width_px", [1280, 375])
def test_no_word_of_a_drawing_is_cut_off_or_written_over(page: Any, width_px: int) -> None:
    page.set_viewport_size({"width": width_px, "height": 800})
    # Boxes of all words within each drawing that is shown, and of the drawing.
    boxes = page.evaluate(
        """() => Array.from(document.querySelectorAll(".drawings svg")).filter((svg) => svg.clientWidth).map((svg) => ({
             size: [svg.viewBox.baseVal.width, svg.viewBox.baseVal.height],
             words: Array.from(svg.querySelectorAll("text")).map((one) => [one.textContent, one.getBBox()])
                      .map(([text, box]) => [text, box.x, box.y, box.width, box.height])}))""",
    )
    assert len(boxes) == 3
    for drawing in boxes:
        width, height = drawing["size"]
        words = drawing["words"]
        assert words
        for text, x, y, w, h in words:
            assert x >= 0, text
            assert y >= 0, text
            assert x + w <= width, text
            assert y + h <= height, text
        for number, (text, x, y, w, h) in enumerate(words):
            for other, x2, y2, w2, h2 in words[number + 1 :]:
                apart = x + w <= x2 or x2 + w2 <= x or y + h <= y2 + 2 or y2 + h2 <= y + 2
                assert apart, f"{text} on {other}"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width_px", [1280, 375])
def test_it_reads_on_a_phone_and_by_those_who_do_not_see_it(page: Any, width_px: int, scheme: str) -> None:
    reads_well(page, width_px, scheme)
