"""The page of a comparison: every figure of it comes from the rows, and no word in it acts."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from scenetruth.benchmark import BenchmarkResult
from scenetruth.benchmark.benchmark_report import (
    describe_densities,
    describe_margins,
    describe_method,
    describe_ties,
    select_worst_regions,
    write_benchmark_report,
)
from scenetruth.benchmark.cases import ALL, BOUND, COMMON_VALID, METHOD_VALID, BenchmarkRecord, all_cases
from scenetruth.benchmark.design_point import CaseErrorMaps
from scenetruth.benchmark.error_statistics import compute_efficiency_records
from scenetruth.benchmark.ranking_charts import build_charts, compute_rank_leaders, describe_stated_uncertainty
from scenetruth.estimators import MethodSpec, list_methods
from scenetruth.estimators.external import CommandMethod, ResultsFolder
from scenetruth.estimators.method_specs import parse_methods
from tests.helpers.page_words import without_definitions

HOSTILE = "</script><script>alert(1)</script>"


def rows() -> list[BenchmarkRecord]:
    found = []
    for label, factor in (("mine", 1.0), (HOSTILE, 2.0)):
        for value in all_cases()["noise"].core:
            for pixels in (METHOD_VALID, COMMON_VALID):
                number = factor * value
                found.append(
                    BenchmarkRecord(
                        "noise", value, label, "disparity", pixels, "rmse", number, 0.9 * number, 1.1 * number
                    )
                )
            found.append(BenchmarkRecord("noise", value, label, "disparity", METHOD_VALID, "noise_std", factor * value))
            found.append(BenchmarkRecord("noise", value, label, "disparity", METHOD_VALID, "density", 0.9))
            found += [
                BenchmarkRecord("noise", value, label, "disparity", METHOD_VALID, "coverage", at / 4, threshold=at)
                for at in (1.0, 2.0, 3.0)
            ]
        for period, left in ((96.0, 0.99), (48.0, 0.8)):
            found.append(
                BenchmarkRecord("waves_of_depth", period, label, "depth", METHOD_VALID, "amplitude_ratio", left)
            )
    found += [
        BenchmarkRecord("noise", value, BOUND, "disparity", METHOD_VALID, "noise_std", value / 2)
        for value in all_cases()["noise"].core
    ]
    for case in (all_cases()["waves_of_depth"],):
        found += list(case.conclusions(found))
    return found


@pytest.fixture
def comparison() -> BenchmarkResult:
    cases = [all_cases()[kind] for kind in ("noise", "waves_of_depth")]
    return BenchmarkResult(
        ["mine", HOSTILE], cases, [*rows(), *compute_efficiency_records(rows())], ["noise at 0.1: mine: why"]
    )


def test_efficiency_and_products_follow_from_rows(comparison: BenchmarkResult) -> None:
    frame = comparison.efficiency()
    assert set(frame["efficiency_percent"].round(9)) == {25.0, 6.25}
    first = comparison.value("depth", "cutoff_period_first", case="waves_of_depth", method="mine").value
    # The logarithm of the share is a straight line over the period to the power of -2.
    way = (math.log(0.99) - math.log(0.9)) / (math.log(0.99) - math.log(0.8))
    assert first == pytest.approx((96**-2 + way * (48**-2 - 96**-2)) ** -0.5)
    product = comparison.value(
        "disparity", "metrological_efficiency_first", case="waves_of_depth", method=HOSTILE
    ).value
    assert product == pytest.approx(2 * 0.005 * first)
    summary = comparison.ranking()
    assert summary.loc["Noise floor: disparity noise std", "mine"] == np.median(all_cases()["noise"].core)
    assert summary.loc["Noise floor: disparity noise std", BOUND] == np.median(all_cases()["noise"].core) / 2


def test_charts_hold_what_was_measured(comparison: BenchmarkResult) -> None:
    charts = {chart.name: chart for chart in build_charts(comparison, comparison.cases[0])}
    assert set(charts) == {"noise-disparity-noise_std", "noise-disparity-density", "noise-coverage"}
    chart = charts["noise-disparity-noise_std"]
    assert [line["name"] for line in chart.data] == ["mine", HOSTILE, "Cramér-Rao bound"]
    assert chart.data[1]["y"] == [2 * value for value in all_cases()["noise"].core]
    assert "mine: 0.005 at 0.005" in chart.alt
    assert chart.layout["xaxis"]["type"] == "log"


def test_the_page_is_one_file_in_which_no_word_acts(comparison: BenchmarkResult, tmp_path: Path) -> None:
    described = {"mine": f"A window of {HOSTILE}"}
    page = write_benchmark_report(comparison, [["mine"], ["theirs[a: 1]"]], tmp_path, "core", None, described)
    text = page.read_text(encoding="utf-8")
    assert "A window of &lt;/script&gt;" in text
    assert [path.name for path in tmp_path.iterdir()] == ["index.html"]
    assert HOSTILE not in text
    assert "noise at 0.1: mine: why" in text
    assert "Noise floor: Disparity, standard deviation due to noise" in re.sub(r"<[^>]*>", "", text)
    found = re.search(r"^const charts = (.*);$", text, re.MULTILINE)
    assert found is not None
    charts = json.loads(found[1])
    assert charts["noise-disparity-noise_std"]["data"][1]["name"] == HOSTILE
    for name in charts:
        assert f'id="chart-{name}"' in text
    # Nothing is fetched: addresses of plotly's own code are in its script alone.
    outside = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r'(src|href)="(?!#)', outside)
    assert "scenetruth compare mine 'theirs[a: 1]' --case noise --level VALUE -o again" in outside.replace("&#39;", "'")
    assert all(math.isfinite(value) for value in charts["noise-disparity-noise_std"]["data"][0]["y"])


def shifted(recording: xr.Dataset) -> xr.Dataset:
    """Shift of a whole image. Not for
    growth.

    Parameters: none.
    """
    return recording


def test_methods_are_described_by_the_first_sentence_of_their_docstring(tmp_path: Path) -> None:
    for entry in list_methods():
        if entry.origin == "scenetruth":
            text = describe_method(entry.name)
            assert text.endswith(".")
            assert 20 < len(text) < 130
            assert "Settings of" not in text
    assert describe_method(shifted) == "Shift of a whole image."
    assert describe_method(MethodSpec(shifted, label="mine")) == "Shift of a whole image."
    assert describe_method(lambda recording: recording) == ""
    assert describe_method(CommandMethod("true {recording} {output}", "dice")).startswith("An external program")
    (tmp_path / "theirs").mkdir()
    assert describe_method(ResultsFolder(tmp_path / "theirs", "theirs")).startswith("A results folder")


def told_by(*figures: tuple[str, float], own: tuple[str, ...] = ("mine",), kind: str = "noise") -> BenchmarkResult:
    """Return a comparison of one case, by its headline alone."""
    case = all_cases()[kind]
    quantity, statistic = case.headline
    found = [
        BenchmarkRecord(kind, math.nan, label, quantity, METHOD_VALID, statistic, number, unit="px")
        for label, number in figures
    ]
    found += [BenchmarkRecord(kind, value, "mine", quantity, METHOD_VALID, "density", 1.0) for value in case.core]
    return BenchmarkResult([label for label, _ in figures], [case], found, own=own)


def test_methods_of_others_that_are_ahead_are_told_with_numbers(tmp_path: Path) -> None:
    found = told_by(("mine", 0.02), ("slow", 0.03), ("quick", 0.0125), ("ours", 0.05), own=("mine", "ours"))
    (one,) = compute_rank_leaders(found).ahead
    assert one.others == [("quick", "0.0125 px")]
    assert one.own == ["mine", "0.02 px"]
    page = write_benchmark_report(found, [[one] for one in found.methods], tmp_path, "core")
    text = without_definitions(page.read_text(encoding="utf-8"))
    found_at = [
        text.index(words) for words in ("1 of 1</b> case", 'id="who-leads"', "<b>quick</b> 0.0125 px", 'id="methods"')
    ]
    assert found_at == sorted(found_at)
    assert "best built-in method: mine, 0.02 px" in text


def test_nobody_is_ahead_by_nothing(tmp_path: Path) -> None:
    found = told_by(("mine", 0.02), ("theirs", 0.02))
    leads = compute_rank_leaders(found)
    assert leads.cases == 1
    assert not leads.ahead
    assert not leads.best
    page = write_benchmark_report(found, [["mine"], ["theirs"]], tmp_path, "core")
    expected = "at least as accurate as the external methods (theirs) in <b>1 of 1</b> case"
    assert expected in without_definitions(page.read_text("utf-8"))
    # A method alone, or methods of one kind, are not compared with others.
    assert compute_rank_leaders(told_by(("mine", 0.02))).cases == 0
    assert compute_rank_leaders(told_by(("a", 0.02), ("b", 0.03), own=())).best == [("a", ["Noise floor"])]
    assert compute_rank_leaders(told_by(("theirs", 0.02), ("mine", math.nan))).ahead[0].own == []


def test_periods_outside_of_what_was_measured_are_told_so() -> None:
    (one,) = compute_rank_leaders(told_by(("mine", math.inf), ("theirs", 0.0), kind="star")).ahead
    assert (one.others, one.own) == ([("theirs", "under 20 px")], ["mine", "over 96 px"])


def zero(recording: xr.Dataset) -> dict[str, np.ndarray]:
    return {"depth": np.zeros(recording["image"].isel(s=0).shape)}


def test_margins_and_densities_are_those_of_the_rows() -> None:
    found = told_by(("mine", 0.02), ("slow", 0.03), ("quick", 0.0125))
    assert describe_margins(found) == {"quick": [("Noise floor", "1.6")]}
    assert describe_densities(found) == "mine 100\N{NO-BREAK SPACE}%"
    assert describe_margins(told_by(("mine", 0.02), ("theirs", 0.02))) == {}


def with_intervals(*methods: tuple[str, float, list[tuple[float, float]]]) -> BenchmarkResult:
    """Return errors of the noise case for all methods, with a confidence interval at each level."""
    case = all_cases()["noise"]
    quantity, statistic = case.headline
    found = [
        BenchmarkRecord(case.kind, level, label, quantity, METHOD_VALID, statistic, value, low, high)
        for label, value, intervals in methods
        for level, (low, high) in enumerate(intervals)
    ]
    return BenchmarkResult([label for label, *_ in methods], [case], found)


def test_methods_whose_intervals_overlap_are_not_ranked(tmp_path: Path) -> None:
    low = ("low", 0.02, [(0.018, 0.022)] * 2)
    for high, tied in (((0.021, 0.03), True), ((0.023, 0.03), False), ((-0.03, -0.021), True), ((-0.03, 0.01), True)):
        found = with_intervals(low, ("high", 0.025, [high] * 2))
        assert describe_ties(found) == (["Noise floor"] if tied else [])
        assert describe_margins(found) == ({} if tied else {"low": [("Noise floor", "1.2")]})
    # One of three levels does not decide; missing intervals do not either.
    apart, over = (0.03, 0.04), (0.02, 0.03)
    three = ("low", 0.02, [(0.018, 0.022)] * 3)
    assert not describe_ties(with_intervals(three, ("high", 0.025, [over, apart, apart])))
    assert not describe_ties(with_intervals(low, ("high", 0.025, [(math.nan, math.nan)] * 2)))
    page = write_benchmark_report(
        with_intervals(low, ("high", 0.025, [over] * 2)), [["low"], ["high"]], tmp_path, "core"
    )
    text = without_definitions(page.read_text("utf-8"))
    assert "The best two methods cannot be distinguished in 1 of 1 case (Noise floor)" in text
    assert "is the most accurate method" not in text


def stating(shares: dict[float, float], kept: dict[float, float]) -> list[str]:
    """Return what is stated of a method with this coverage and this sparsification curve."""
    case = all_cases()["noise"]
    found = [
        BenchmarkRecord(case.kind, 0.005, "mine", "disparity", METHOD_VALID, statistic, value, threshold=at)
        for statistic, curve in (("coverage", shares), ("sparsification_rmse", kept))
        for at, value in curve.items()
    ]
    return [*describe_stated_uncertainty(BenchmarkResult(["mine"], [case], found), case)]


def test_wrong_stated_uncertainties_are_named() -> None:
    correct = {1.0: 0.683, 2.0: 0.954, 3.0: 0.997}
    falling, rising = {0.2: 0.5, 1.0: 1.0}, {0.2: 1.2, 1.0: 1.0}
    assert stating(correct, falling) == []
    (small,) = stating({1.0: 0.15, 2.0: 0.3, 3.0: 0.4}, falling)
    assert "30\N{NO-BREAK SPACE}% of the errors of disparity are within 2 stated standard deviations" in small
    assert "too small" in small
    (large,) = stating({1.0: 0.95, 2.0: 1.0, 3.0: 1.0}, falling)
    assert "95\N{NO-BREAK SPACE}% of the errors" in large
    assert "too large" in large
    (unranked,) = stating(correct, rising)
    assert "do not rank the pixels" in unranked


def test_pictures_of_errors_have_the_scale_of_their_errors() -> None:
    case = all_cases()["noise"]
    errors = np.random.default_rng(5).normal(scale=0.01, size=(40, 60)).astype(np.float32)
    errors[:, :30] = np.nan
    rows = [
        BenchmarkRecord(case.kind, 0.02, "mine", "disparity", pixels, statistic, 0.5)
        for statistic, pixels in (("inlier_rate", ALL), ("density", METHOD_VALID))
    ]
    maps = {(case.kind, 0.02): CaseErrorMaps(np.ones((40, 60), np.float32), "disparity", {"mine": errors})}
    (one,) = select_worst_regions(BenchmarkResult(["mine"], [case], rows), maps)
    assert float(one.limit) == pytest.approx(float(np.nanpercentile(np.abs(errors), 98)), rel=0.05)
    assert one.title.replace("\N{NO-BREAK SPACE}", " ") == (
        "Noise floor, image noise (standard deviation) 0.02 of full scale: disparity valid at 50 % of the "
        "evaluated pixels, all of them within 0.1 px"
    )


def test_our_own_methods_are_told_from_others() -> None:
    given = ["fine=refined[window_sigma_px: 4]", "structure_tensor", "plane_sweep", "opencv_flow", f"{__name__}:zero"]
    assert [one.is_own for one in parse_methods(given)] == [True, True, True, False, False]


def test_values_with_names_are_drawn_at_their_names() -> None:
    case = all_cases()["gallery"]
    values = [case.parse_level(name) for name in ("leaf", "cube", "star")]
    found = [
        BenchmarkRecord(case.kind, value, "mine", "disparity", METHOD_VALID, "rmse", 0.1 + value) for value in values
    ]
    found += [BenchmarkRecord(case.kind, values[0], "mine", "growth_rate_windowed", METHOD_VALID, "rmse", 3.0)]
    charts = {chart.name: chart for chart in build_charts(BenchmarkResult(["mine"], [case], found), case)}
    assert set(charts) == {"gallery-disparity-rmse", "gallery-growth_rate_windowed-rmse"}
    chart = charts["gallery-disparity-rmse"]
    assert chart.data[0]["x"] == ["cube", "leaf", "star"]
    assert chart.data[0]["mode"] == "markers"
    assert chart.layout["xaxis"]["categoryarray"] == ["cube", "leaf", "star"]
    assert f"mine: 0.1 at cube, {case.parse_level('star'):g} at star" in chart.alt


def test_others_that_are_ahead_in_one_scene_or_one_quantity_are_told_too() -> None:
    case = all_cases()["gallery"]
    leaf, star = case.parse_level("leaf"), case.parse_level("star")
    figures = {(leaf, "mine"): 0.1, (leaf, "theirs"): 0.2, (star, "mine"): 0.1, (star, "theirs"): 0.05}
    found = [
        BenchmarkRecord(case.kind, value, label, "disparity", pixels, "rmse", number, unit="px")
        for (value, label), number in figures.items()
        for pixels in (METHOD_VALID, COMMON_VALID)
    ]
    # Nobody else tells depth; what is told by others alone puts them ahead.
    found += [
        BenchmarkRecord(case.kind, star, "mine", "depth", METHOD_VALID, "rmse", 1.0),
        BenchmarkRecord(case.kind, star, "theirs", "flow_x", METHOD_VALID, "rmse", 2.0),
    ]
    leads = compute_rank_leaders(BenchmarkResult(["mine", "theirs"], [case], found, own=["mine"]))
    # The medians are 0.1 and 0.125.
    assert (leads.cases, leads.ahead, leads.figures) == (1, [], 3)
    assert leads.lines == [
        ["Gallery, star", "Disparity, RMSE", "theirs 0.05 px", "mine 0.1 px"],
        ["Gallery, star", "Optical flow in x, RMSE", "theirs 2", "–"],
    ]


def test_programs_and_results_are_named_by_their_options(tmp_path: Path) -> None:
    program = CommandMethod("python mine.py {recording} {output}", "mine")
    given = parse_methods(["fine=refined[window_sigma_px: 4]", program, ResultsFolder(tmp_path, "theirs")])
    assert [one.words for one in given] == [
        ("fine=refined[window_sigma_px: 4]",),
        ("--command", "mine=python mine.py {recording} {output}"),
        ("--results", f"theirs={tmp_path}"),
    ]
