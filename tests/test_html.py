"""What pages have in common: tables that sort by numbers, and one file in which no word acts."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenetruth.html import Chart, HtmlCell, HtmlTable, make_table, render_page, sort_key
from tests.helpers.page_words import without_definitions

HOSTILE = "</script><b onclick='x'>"


@given(st.floats(allow_nan=False, allow_infinity=False), st.sampled_from(["", " px", " to 7", ", more"]))
def test_texts_sort_by_the_number_that_they_begin_with(value: float, rest: str) -> None:
    assert sort_key(f"{value!r}{rest}") == value
    assert sort_key(f"{value!r}{rest}".replace("-", "−")) == value


@pytest.mark.parametrize("text", ["", "–", "leaf", "3d", "5x9", "e5", "none"])
def test_words_are_no_numbers(text: str) -> None:
    assert sort_key(text) is None


@pytest.mark.parametrize(
    ("key", "expected"), [(None, ""), (math.nan, ""), (3, "3.0"), (math.inf, "Infinity"), (-math.inf, "-Infinity")]
)
def test_keys_are_numbers_of_javascript(key: float | None, expected: str) -> None:
    assert HtmlCell("x", key).sorts_by == expected


def test_columns_of_words_are_distinguished_from_numbers() -> None:
    table = make_table("t", "A table", ["name", "number", "mixed"], [["a", 1.5, "–"], ["b", "∞", "2 px"]])
    assert table.numeric == [False, True, True]
    assert [cell.key for cell in table.lines[1]] == [None, math.inf, 2.0]
    assert HtmlTable("t", "", ["a"], []).numeric == [False]
    # Where no number is known, dashes stand in the place of numbers.
    assert make_table("t", "", ["a", "b"], [["–", "–"], ["–", "word"]]).numeric == [True, False]


@pytest.mark.parametrize(
    ("columns", "lines", "expected"), [(3, 4, "stack"), (5, 4, "stack pairs"), (13, 2, ""), (5, 41, "")]
)
def test_tables_are_cards_on_narrow_screens_unless_they_are_long(columns: int, lines: int, expected: str) -> None:
    table = make_table("t", "", [f"c{n}" for n in range(columns)], [["1"] * columns] * lines)
    assert table.stacking == expected


def test_a_page_is_one_file_in_which_no_word_acts() -> None:
    # The sweep's template has tables, charts, and words of its own.
    charts = {HOSTILE: [{"text": HOSTILE}]}
    found = {name: [HOSTILE] for name in ("factors", "methods", "notes", "failures")} | {"scenes": []}
    context = {
        "result": HOSTILE,
        "seeds": 1,
        "values": [],
        "again": "",
        "titles": {"camera.width": HOSTILE},
        "only": HOSTILE,
        "best": [[HOSTILE, "2"]],
        "best_columns": ["a", HOSTILE],
    }
    context |= {"statistics": [], "statistic": "", "regions": [], "region": HOSTILE, "quantities": []}
    context |= {"columns": ["a"], "lines": [["3 px"]], "left_out": 0, "per_frame": False}
    page = render_page("scenetruth.design.sweeps", "sweep.html.j2", charts, found=found, **context)
    text = without_definitions(page)
    assert HOSTILE not in text
    assert text.count("</script>") == 3
    outside = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r'(src|href)="(?!#|data:)', outside)
    assert outside.count("&lt;/script&gt;") >= 8
    assert '<td data-key="3.0">3 px</td>' in outside
    # The style is that of the reports.
    assert "--accent" in outside


def test_titles_of_charts_stand_above_them() -> None:
    chart = Chart("c", "A chart", [], {"title": {"text": "Depth: RMSE, mm<br><sub>at x = <i>2</i></sub>"}})
    assert (chart.title, chart.subtitle) == ("Depth: RMSE, mm", "at x = 2")
    assert (Chart("c", "", [], {}).title, Chart("c", "", [], {}).subtitle) == ("", "")
