"""Words, picture and page say what the figures say."""

from __future__ import annotations

import inspect
import json
import math
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import scenetruth as st
from scenetruth.design.uncertainty import Budget, compute_bars, make_waterfalls, write_page, write_waterfall
from scenetruth.number_format import format_two_digits
from tests.helpers.page_words import without_definitions
from tests.helpers.sample_budget import budget_of_a_cube

HOSTILE = "</script><script>alert(1)</script>"


@pytest.fixture
def found() -> Budget:
    return budget_of_a_cube(noise=HOSTILE)


def test_words_name_the_largest_part_its_remedy_and_what_limits_then(found: Budget) -> None:
    (line,) = found.summary().splitlines()
    assert line.startswith("Depth: combined uncertainty 1.5 mm RMS.")
    assert (
        "Largest contribution: stage yaw (100 µrad), 1.4 mm for these seeds, with an expected value of 4.2 over all "
        "seeds" in line
    )
    # What is left: the root of 0.035² + 0.16² + 0.05², times 1.5 over the parts' sum.
    left = math.sqrt(0.035**2 + 0.16**2 + 0.05**2 + 5e-6) * 1.5 / found.totals[0].root_sum_square
    assert f"An air bearing reduces it to {format_two_digits(left)} mm; then slanted surfaces dominate (0.16)." in line
    assert "With stage yaw, 50 % of the pixels remain valid." in line


@pytest.mark.parametrize(
    ("signal", "words"),
    [
        (0.5, "combined uncertainty 1.5 mm/frame RMS, true value 3 mm/frame."),
        (
            5.0,
            "not measurable: the combined uncertainty, 1.5 mm/frame RMS, is 5 times the true value of 0.3 mm/frame",
        ),
        (2000.0, "combined uncertainty 1.5 mm/frame RMS. "),
    ],
)
def test_an_uncertainty_above_the_true_value_is_named(found: Budget, signal: float, words: str) -> None:
    parts = [replace(one, quantity="velocity_z", unit="mm/frame") for one in found.parts]
    total = replace(found.totals[0], quantity="velocity_z", unit="mm/frame", signal=found.totals[0].value / signal)
    line = replace(found, parts=parts, totals=[total]).summary()
    assert line.startswith(f"Velocity in Z: {words}")


def test_words_say_how_a_predicted_part_is_simulated(found: Budget) -> None:
    parts = [replace(one, simulated=math.nan) for one in found.parts]
    totals = [replace(found.totals[0], simulated=10.0)]
    (line,) = replace(found, parts=parts, totals=totals).summary().splitlines()
    assert "simulated_share=1 (--simulated-share 1) simulates it too" in line
    assert "simulated_share" in inspect.signature(st.budget).parameters


def test_bars_add_up_by_their_squares(found: Budget) -> None:
    steps = compute_bars(found, "depth")
    assert [step.title for step in steps][:3] == ["stage yaw", "slanted surfaces", HOSTILE]
    assert steps[-1].title == "2 smaller contributions"
    assert steps[0].start == 0
    assert steps[-1].end == pytest.approx(found.totals[0].root_sum_square)
    for one, other in pairwise(steps):
        assert other.start == pytest.approx(one.end)
    for step in steps:
        assert step.end**2 - step.start**2 == pytest.approx(step.value**2)


def test_the_picture_is_drawn(found: Budget, tmp_path: Path) -> None:
    from matplotlib.image import imread

    write_waterfall(found, tmp_path / "w.png")
    image = imread(tmp_path / "w.png")
    # The colour of the stage's bar is there.
    orange = np.abs(image[..., :3] - np.array([0xD5, 0x5E, 0x00]) / 255).max(axis=-1) < 0.02
    assert orange.sum() > 1000


def test_the_page_is_one_file_in_which_no_word_acts(found: Budget, tmp_path: Path) -> None:
    (waterfall,) = make_waterfalls(found)
    assert waterfall.data[0]["text"][0] == "1.4"
    assert waterfall.alt.startswith("Depth, mm: stage yaw 1.4; slanted surfaces 0.16")
    page = write_page(found, tmp_path)
    text = without_definitions(page.read_text(encoding="utf-8"))
    chart = re.search(r"const charts = (\{.*\});", text)
    assert chart is not None
    assert json.loads(chart[1]) == {waterfall.name: {"data": waterfall.data, "layout": waterfall.layout}}
    assert [path.name for path in tmp_path.iterdir()] == ["index.html"]
    assert HOSTILE not in text
    assert "stage yaw" in text
    outside = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r'(src|href)="(?!#)', outside)


def test_rounding_errors_are_shown_as_zero(found: Budget, tmp_path: Path) -> None:
    parts = [replace(one, predicted=1e-9) if one.cause == "slope" else one for one in found.parts]
    text = write_page(replace(found, parts=parts), tmp_path).read_text(encoding="utf-8")
    row = re.sub(r"<[^>]*>", " ", text.partition("slanted surfaces</td>")[2].partition("</tr>")[0])
    assert "e-0" not in row
    assert "0.16" in row


def test_tables_of_the_page_sort_and_their_sums_stay_below(found: Budget, tmp_path: Path) -> None:
    text = without_definitions(write_page(found, tmp_path).read_text(encoding="utf-8"))
    head, body, foot = (
        re.search(rf'<table class="sortable[^"]*" id="parts-depth">.*?<{part}>(.*?)</{part}>', text, re.DOTALL)
        for part in ("thead", "tbody", "tfoot")
    )
    assert head is not None and body is not None and foot is not None  # noqa: PT018
    assert head[1].count('<button type="button">') == 7
    # The part, what was drawn, and what was simulated.
    assert re.findall(r'<td data-key="([^"]*)"[^>]*>1\.4</td>', body[1]) == ["1.4", "1.39", "1.4"]
    # Sizes are of several units, and sort as words.
    assert "data-key" not in re.findall(r"<td[^>]*>100 µrad", body[1])[0]
    assert "sum of squares" not in body[1]
    assert [row.count("<td") for row in foot[1].split("</tr>")] == [7, 7, 7, 0]
    assert "all sources" in foot[1]


def test_the_page_is_of_one_region_and_says_which(found: Budget, tmp_path: Path) -> None:
    parts = [replace(one, region="object_leaf", value=7 * one.value) for one in found.parts]
    total = replace(found.totals[0], region="object_leaf", simulated=9.5)
    both = replace(found, parts=[*found.parts, *parts], totals=[*found.totals, total])
    inside, leaf = (
        without_definitions(write_page(both, tmp_path, region).read_text(encoding="utf-8")).split("<main>")[1]
        for region in ("interior", "object_leaf")
    )
    assert "RMS over the interior." in inside
    assert "Depth: combined uncertainty 1.5 mm RMS." in inside
    assert "RMS over the interior of leaf." in leaf
    assert "Depth: combined uncertainty 9.5 mm RMS." in leaf


def test_numbers_are_spelled_with_two_digits() -> None:
    assert [format_two_digits(value) for value in (1.44, 0.00123, 123.4, 3e-6, 0.0, math.nan)] == [
        "1.4",
        "0.0012",
        "123",
        "3.0 × 10⁻⁶",
        "0",
        "–",
    ]
