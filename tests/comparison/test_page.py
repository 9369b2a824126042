"""The page of a comparison: every figure of it comes from the rows, and no word in it acts."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest

from scenetruth.comparison import Comparison
from scenetruth.comparison.case import all_cases
from scenetruth.comparison.measures.products import product_rows
from scenetruth.comparison.page.charts import charts_of
from scenetruth.comparison.page.write import write_page
from scenetruth.comparison.rows import BOUND, COMMON, OWN, Row

HOSTILE = "</script><script>alert(1)</script>"


def rows() -> list[Row]:
    found = []
    for label, factor in (("mine", 1.0), (HOSTILE, 2.0)):
        for value in all_cases()["noise"].core:
            for pixels in (OWN, COMMON):
                number = factor * value
                found.append(Row("noise", value, label, "disparity", pixels, "rms", number, 0.9 * number, 1.1 * number))
            found.append(Row("noise", value, label, "disparity", OWN, "noise", factor * value))
            found.append(Row("noise", value, label, "disparity", OWN, "density", 0.9))
            found += [Row("noise", value, label, "disparity", OWN, "within", at / 4, at=at) for at in (1.0, 2.0, 3.0)]
        for period, left in ((96.0, 0.99), (48.0, 0.8)):
            found.append(Row("waves_of_depth", period, label, "depth", OWN, "share_left", left))
    found += [Row("noise", value, BOUND, "disparity", OWN, "noise", value / 2) for value in all_cases()["noise"].core]
    for case in (all_cases()["waves_of_depth"],):
        found += list(case.conclusions(found))
    return found


@pytest.fixture
def comparison() -> Comparison:
    cases = [all_cases()[kind] for kind in ("noise", "waves_of_depth")]
    return Comparison(["mine", HOSTILE], cases, [*rows(), *product_rows(rows())], ["noise at 0.1: mine: why"])


def test_efficiency_and_products_follow_from_rows(comparison: Comparison) -> None:
    frame = comparison.efficiency()
    assert set(frame["efficiency_percent"].round(9)) == {25.0, 6.25}
    first = comparison.figure("waves_of_depth", "mine", "depth", "period_at_10_percent_loss_first").number
    # The logarithm of the share is a straight line over the period to the power of -2.
    way = (math.log(0.99) - math.log(0.9)) / (math.log(0.99) - math.log(0.8))
    assert first == pytest.approx((96**-2 + way * (48**-2 - 96**-2)) ** -0.5)
    product = comparison.figure("waves_of_depth", HOSTILE, "disparity", "noise_times_period_first").number
    assert product == pytest.approx(2 * 0.005 * first)
    summary = comparison.summary()
    assert summary.loc["Noise floor: disparity noise", "mine"] == 0.005
    assert summary.loc["Noise floor: disparity noise", BOUND] == 0.0025


def test_charts_hold_what_was_measured(comparison: Comparison) -> None:
    charts = {chart.name: chart for chart in charts_of(comparison, comparison.cases[0])}
    assert set(charts) == {"noise-disparity-noise", "noise-disparity-density", "noise-within"}
    chart = charts["noise-disparity-noise"]
    assert [line["name"] for line in chart.data] == ["mine", HOSTILE, "bound of noise"]
    assert chart.data[1]["y"] == [2 * value for value in all_cases()["noise"].core]
    assert "mine: 0.002 at 0.002" in chart.alt
    assert chart.layout["xaxis"]["type"] == "log"


def test_the_page_is_one_file_in_which_no_word_acts(comparison: Comparison, tmp_path: Path) -> None:
    page = write_page(comparison, ["mine", "theirs[a: 1]"], tmp_path, "core")
    text = page.read_text(encoding="utf-8")
    assert [path.name for path in tmp_path.iterdir()] == ["index.html"]
    assert HOSTILE not in text
    assert "noise at 0.1: mine: why" in text
    found = re.search(r"^const charts = (.*);$", text, re.MULTILINE)
    assert found is not None
    charts = json.loads(found[1])
    assert charts["noise-disparity-noise"]["data"][1]["name"] == HOSTILE
    for name in charts:
        assert f'id="chart-{name}"' in text
    # Nothing is fetched: addresses of plotly's own code are in its script alone.
    outside = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r'(src|href)="(?!#)', outside)
    assert "scenetruth compare mine 'theirs[a: 1]' --case noise --value VALUE -o again" in outside.replace("&#39;", "'")
    assert all(math.isfinite(value) for value in charts["noise-disparity-noise"]["data"][0]["y"])
