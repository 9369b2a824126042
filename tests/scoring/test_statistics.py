"""Statistics against a reading in plain Python; rates of outliers, and quantiles of values that come in parts."""

from __future__ import annotations

import math
import statistics

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as some
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from scenetruth.benchmark.benchmark_report import _SUMMARY_STATISTICS
from scenetruth.benchmark.cases import all_cases
from scenetruth.design import optimisation, sweeps
from scenetruth.scoring.error_pairs import EstimateTruthPair
from scenetruth.scoring.statistics import (
    RATES,
    STATISTIC_TITLES,
    STATISTICS,
    Statistics,
    StreamingQuantiles,
    endpoint_statistics,
    error_statistics,
    meaningful_rates,
    outlier_rates,
    standardised,
)

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIZE = 12
values = some.one_of(some.floats(-1e6, 1e6, width=32), some.just(math.nan), some.just(math.inf))
maps = arrays.arrays(np.float64, SIZE, elements=values)
vectors = arrays.arrays(np.float64, (3, SIZE), elements=values)
finite_maps = arrays.arrays(np.float64, SIZE, elements=some.floats(-1e3, 1e3, width=32))
deviations = arrays.arrays(
    np.float64,
    SIZE,
    elements=some.one_of(some.floats(2**-10, 1e3, width=32), some.sampled_from([0.0, -1.0, math.nan, math.inf])),
)
masks = arrays.arrays(bool, SIZE)
EVERYWHERE = np.ones(SIZE, dtype=bool)


def percentile(sorted_values: list[float], share: float) -> float:
    """Interpolate linearly between the two order statistics around the place share (n - 1)."""
    place = share * (len(sorted_values) - 1)
    below = math.floor(place)
    above = min(below + 1, len(sorted_values) - 1)
    return sorted_values[below] + (place - below) * (sorted_values[above] - sorted_values[below])


def plain_statistics(
    errors: list[float], magnitudes: list[float], known: int, ratios: list[float] | None = None
) -> Statistics:
    """Compute the statistics from lists, by their definitions."""
    if not errors:
        return {**dict.fromkeys(STATISTICS, None), "density": 0.0 if known else None, "count": 0}
    size = sorted(abs(error) for error in errors)
    rms = math.sqrt(math.fsum(error**2 for error in errors) / len(errors))
    reference = math.sqrt(math.fsum(value**2 for value in magnitudes) / len(errors))
    return {
        "bias": math.fsum(errors) / len(errors),
        "rmse": rms,
        "median_abs_error": statistics.median(size),
        "p95_abs_error": percentile(size, 0.95),
        "relative_rmse": rms / reference if reference else None,
        "rms_z": math.sqrt(math.fsum(ratio**2 for ratio in ratios) / len(ratios)) if ratios else None,
        "coverage_2_std": sum(abs(ratio) <= 2 for ratio in ratios) / len(ratios) if ratios else None,
        "density": len(errors) / known,
        "count": len(errors),
    }


def assert_same(result: Statistics, expected: Statistics, scale: float) -> None:
    assert tuple(result) == STATISTICS
    for name, value in result.items():
        other = expected[name]
        if other is None:
            assert value is None, name
        else:
            assert type(value) in (float, int), name
            assert value == pytest.approx(other, rel=1e-9, abs=1e-12 * scale), name


@given(maps, maps, masks, masks, deviations)
def test_scalar_statistics_are_those_of_their_definitions(
    estimate: Map, truth: Map, region: Mask, full: Mask, std: Map
) -> None:
    known = [i for i in range(SIZE) if region[i] and math.isfinite(truth[i])]
    scored = [i for i in known if full[i] and math.isfinite(estimate[i])]
    errors = [float(estimate[i]) - float(truth[i]) for i in scored]
    barred = [(error, float(std[i])) for error, i in zip(errors, scored, strict=True) if 0 < std[i] < math.inf]
    ratios = [error / deviation for error, deviation in barred]
    expected = plain_statistics(errors, [float(truth[i]) for i in scored], len(known), ratios)
    assert_same(error_statistics(estimate, truth, region, full, std), expected, 1e6)
    plain = expected | {"rms_z": None, "coverage_2_std": None}
    assert_same(error_statistics(estimate, truth, region, full), plain, 1e6)


@given(vectors, vectors, masks, masks)
def test_endpoint_statistics_are_those_of_distances(estimate: Map, truth: Map, region: Mask, full: Mask) -> None:
    known = [i for i in range(SIZE) if region[i] and all(map(math.isfinite, truth[:, i]))]
    scored = [i for i in known if full[i] and all(map(math.isfinite, estimate[:, i]))]
    errors = [math.dist(estimate[:, i], truth[:, i]) for i in scored]
    expected = plain_statistics(errors, [math.hypot(*truth[:, i]) for i in scored], len(known))
    assert_same(endpoint_statistics(estimate, truth, region, full), expected, 1e6)


@given(finite_maps)
def test_perfect_estimate_has_no_error(truth: Map) -> None:
    result = error_statistics(truth, truth, EVERYWHERE)
    assert [result[name] for name in ("bias", "rmse", "median_abs_error", "p95_abs_error")] == [0, 0, 0, 0]
    assert (result["density"], result["count"]) == (1.0, SIZE)
    assert result["relative_rmse"] == (0.0 if truth.any() else None)


@given(finite_maps, some.integers(-50, 50))
def test_constant_offset_is_bias_and_rms(truth: Map, offset: int) -> None:
    result = error_statistics(truth + offset, truth, EVERYWHERE)
    assert result["bias"] == pytest.approx(offset, abs=1e-9)
    for name in ("rmse", "median_abs_error", "p95_abs_error"):
        assert result[name] == pytest.approx(abs(offset), abs=1e-9)


@given(finite_maps, finite_maps, some.permutations(range(SIZE)))
def test_order_of_pixels_does_not_matter(estimate: Map, truth: Map, order: list[int]) -> None:
    result = error_statistics(estimate[order], truth[order], EVERYWHERE)
    assert_same(result, error_statistics(estimate, truth, EVERYWHERE), 1e3)


@given(finite_maps, finite_maps, some.sampled_from([0.25, 2.0, 1024.0]))
def test_errors_scale_with_the_unit(estimate: Map, truth: Map, factor: float) -> None:
    plain, scaled = (error_statistics(k * estimate, k * truth, EVERYWHERE) for k in (1.0, factor))
    for name in ("bias", "rmse", "median_abs_error", "p95_abs_error"):
        assert scaled[name] == pytest.approx(factor * float(plain[name] or 0.0), rel=1e-9, abs=1e-9)
    assert scaled["relative_rmse"] == pytest.approx(plain["relative_rmse"])


@given(finite_maps, finite_maps, masks)
def test_estimate_without_value_is_a_pixel_less(estimate: Map, truth: Map, missing: Mask) -> None:
    holes = np.where(missing, np.nan, estimate)
    by_value = error_statistics(holes, truth, EVERYWHERE)
    assert by_value == error_statistics(estimate, truth, EVERYWHERE, ~missing)
    assert by_value["density"] == (SIZE - int(missing.sum())) / SIZE


@pytest.mark.parametrize("factor", [0.25, 1.0, 2.0])
def test_normal_errors_with_known_error_bars(factor: float) -> None:
    count = 20_000
    rng = np.random.default_rng(5)
    std = rng.uniform(0.1, 10, count)
    truth = rng.uniform(600, 700, count)
    estimate = truth + std * rng.standard_normal(count)
    right = error_statistics(estimate, truth, np.ones(count, dtype=bool), std=std)
    # Five standard deviations of the rms of so many normal numbers, and of the share of so many trials.
    assert right["rms_z"] == pytest.approx(1, abs=5 / math.sqrt(2 * count))
    assert right["coverage_2_std"] == pytest.approx(0.9545, abs=5 * math.sqrt(0.9545 * 0.0455 / count))
    scaled = error_statistics(estimate, truth, np.ones(count, dtype=bool), std=factor * std)
    assert scaled["rms_z"] == pytest.approx(float(right["rms_z"] or 0) / factor, rel=1e-12)
    share = math.erf(2 * factor / math.sqrt(2))
    assert scaled["coverage_2_std"] == pytest.approx(share, abs=5 * math.sqrt(share * (1 - share) / count) + 1e-3)
    others = [name for name in STATISTICS if name not in ("rms_z", "coverage_2_std")]
    assert [scaled[name] for name in others] == [right[name] for name in others]


def test_error_of_exactly_two_standard_deviations_is_within() -> None:
    truth, error = np.zeros(4), np.array([1.0, -1.0, 1.25, 0.0])
    result = error_statistics(truth + error, truth, np.ones(4, dtype=bool), std=np.full(4, 0.5))
    assert result["coverage_2_std"] == 0.75


def test_pixels_without_error_bars_count_for_all_else() -> None:
    truth, error = np.zeros(4), np.array([1.0, 7.0, 7.0, 7.0])
    result = error_statistics(truth + error, truth, np.ones(4, dtype=bool), std=np.array([0.5, 0.0, np.nan, np.inf]))
    assert (result["rms_z"], result["coverage_2_std"], result["count"]) == (2.0, 1.0, 4)
    assert standardised(error, np.array([0.5, 0.0, np.nan, np.inf])).tolist() == [2.0]


def test_truth_of_zero_has_no_relative_error() -> None:
    result = error_statistics(np.ones(3), np.zeros(3), np.ones(3, dtype=bool))
    assert result["relative_rmse"] is None
    assert result["rmse"] == 1.0


@pytest.mark.parametrize(("known", "density"), [(True, 0.0), (False, None)])
def test_nothing_scored_is_undefined(known: bool, density: float | None) -> None:
    truth = np.full(2, 1.0 if known else np.nan)
    result = error_statistics(np.full(2, np.nan), truth, np.ones(2, dtype=bool))
    assert result == {**dict.fromkeys(STATISTICS, None), "density": density, "count": 0}


def test_diverged_estimate_overflows_nothing() -> None:
    everywhere = np.ones(2, dtype=bool)
    far = error_statistics(np.full(2, 1e300), np.ones(2), everywhere)
    assert far["rmse"] == pytest.approx(1e300)
    further = error_statistics(np.full(2, 1.7e308), np.full(2, -1.7e308), everywhere, std=np.ones(2))
    assert further["rmse"] is None
    assert (further["rms_z"], further["coverage_2_std"]) == (None, 0.0)
    tiny = error_statistics(np.full(2, 1e300), np.ones(2), everywhere, std=np.full(2, 1e-300))
    assert (tiny["rms_z"], tiny["coverage_2_std"]) == (None, 0.0)
    assert endpoint_statistics(np.full((3, 2), 1.7e308), np.ones((3, 2)), everywhere)["rmse"] is None


def test_all_packages_use_the_same_names() -> None:
    assert {*STATISTICS} <= {*STATISTIC_TITLES}
    assert {*sweeps.STATISTICS} <= {*STATISTIC_TITLES}
    assert {*optimisation.STATISTICS, *(one.scored for one in optimisation.STATISTICS.values())} <= {*STATISTIC_TITLES}
    assert {*_SUMMARY_STATISTICS, *(case.headline[1] for case in all_cases().values())} <= {*STATISTIC_TITLES}
    assert len({*STATISTIC_TITLES.values()}) == len(STATISTIC_TITLES)


def pairs_of(
    disparity: tuple[Map, Map], flow: tuple[Map, Map], full: Mask | None = None
) -> dict[str, EstimateTruthPair]:
    """Return the pairs of estimates and truths of a disparity (n,) and a flow (2, n)."""
    return {
        "disparity": EstimateTruthPair(*disparity, full),
        "flow_x": EstimateTruthPair(flow[0][0], flow[1][0], full),
        "flow_y": EstimateTruthPair(flow[0][1], flow[1][1], full),
    }


def rates(
    disparity: tuple[float, float], flow: tuple[tuple[float, float], tuple[float, float]]
) -> tuple[float | int | None, ...]:
    """Return the rates of one pixel."""
    result = outlier_rates(
        pairs_of(
            (np.array([disparity[0]]), np.array([disparity[1]])),
            (np.array(flow[0])[:, None], np.array(flow[1])[:, None]),
        )
    )
    assert tuple(result) == RATES
    return tuple(result.values())


STILL = ((0.0, 0.0), (0.0, 0.0))


@pytest.mark.parametrize(
    ("estimate", "truth", "outlier"),
    [
        (43.0, 40.0, 0),  # exactly 3 px
        (43.25, 40.0, 1),  # above 3 px and above 5 %
        (36.75, 40.0, 1),  # the sign does not matter
        (-43.25, -40.0, 1),  # nor that of the truth
        (104.0, 100.0, 0),  # above 3 px, below 5 %
        (84.0, 80.0, 0),  # exactly 5 %
        (42.5, 40.0, 0),  # above 5 %, below 3 px
    ],
)
def test_disparity_is_an_outlier_above_both_thresholds(estimate: float, truth: float, outlier: int) -> None:
    assert rates((estimate, truth), STILL) == (outlier, 0, outlier, 1)


@pytest.mark.parametrize(
    ("estimate", "truth", "outlier"),
    [
        ((33.0, 40.0), (30.0, 40.0), 0),  # endpoint exactly 3 px
        ((33.0, 36.0), (30.0, 40.0), 1),  # endpoint 5 px, length 50 px
        ((63.0, 84.0), (60.0, 80.0), 0),  # endpoint 5 px, exactly 5 %
        ((62.0, 82.0), (60.0, 80.0), 0),  # below both
        ((93.0, 124.0), (90.0, 120.0), 0),  # endpoint 5 px, below 5 %
        ((0.0, 2.0), (0.0, 1.0), 0),  # above 5 %, below 3 px
    ],
)
def test_flow_is_an_outlier_above_both_thresholds(
    estimate: tuple[float, float], truth: tuple[float, float], outlier: int
) -> None:
    assert rates((40.0, 40.0), (estimate, truth)) == (0, outlier, outlier, 1)


def test_scene_flow_is_an_outlier_if_either_is() -> None:
    disparity = np.array([10.0, 20.0, 10.0, 20.0, np.nan])
    flow = np.array([[0.0, 0.0, 9.0, 9.0, 9.0], np.zeros(5)])
    truth = np.full(5, 10.0), np.zeros((2, 5))
    result = outlier_rates(pairs_of((disparity, truth[0]), (flow, truth[1])))
    assert result == {"disparity_rate": 0.5, "flow_rate": 0.5, "scene_flow_rate": 0.75, "count": 4}
    full = np.array([True, False, False, False, True])
    assert outlier_rates(pairs_of((disparity, truth[0]), (flow, truth[1]), full))["count"] == 1


def test_outliers_of_nothing_are_undefined() -> None:
    nothing = np.zeros(1, dtype=bool)
    result = outlier_rates(pairs_of((np.ones(1), np.ones(1)), (np.ones((2, 1)), np.ones((2, 1))), nothing))
    assert result == {"disparity_rate": None, "flow_rate": None, "scene_flow_rate": None, "count": 0}


def test_rates_need_their_own_quantities_only() -> None:
    pairs = pairs_of((np.array([10.0, 20.0]), np.full(2, 10.0)), (np.full((2, 2), np.nan), np.zeros((2, 2))))
    assert outlier_rates(pairs, ["disparity_rate"]) == {"disparity_rate": 0.5, "count": 2}
    assert outlier_rates({"disparity": pairs["disparity"]}, ["disparity_rate"])["count"] == 2
    assert outlier_rates(pairs, ["disparity_rate", "flow_rate"])["count"] == 0


ALIKE = 38.0 + np.linspace(-0.5, 0.5, 40)
APART = np.linspace(5.0, 90.0, 40)
"""True disparities as of the seed paper, and as of a street."""
NO_FLOW = (np.zeros((2, 40)), np.zeros((2, 40)))
ALL_PIXELS = np.ones(40, dtype=bool)


def test_rates_say_nothing_where_even_a_guess_has_no_outlier() -> None:
    assert meaningful_rates(pairs_of((ALIKE + 0.01, ALIKE), NO_FLOW), ALL_PIXELS) == ()


def test_rates_say_something_where_a_guess_has_outliers() -> None:
    both = meaningful_rates(pairs_of((APART + 0.01, APART), NO_FLOW), ALL_PIXELS)
    assert both == ("disparity_rate", "scene_flow_rate")
    flow = np.stack([np.linspace(-8.0, 8.0, 40), np.zeros(40)])
    assert meaningful_rates(pairs_of((ALIKE, ALIKE), (flow, flow)), ALL_PIXELS) == ("flow_rate", "scene_flow_rate")


def test_rates_say_something_where_the_estimate_has_outliers() -> None:
    wrong = np.where(np.arange(40) == 7, ALIKE + 9, ALIKE)
    pairs = pairs_of((wrong, ALIKE), NO_FLOW)
    assert meaningful_rates(pairs, ALL_PIXELS) == ("disparity_rate", "scene_flow_rate")
    assert meaningful_rates({"disparity": pairs["disparity"]}, ALL_PIXELS) == ("disparity_rate",)
    # Neither does a wrong pixel count that is not looked at, nor one that the estimate does not claim to know.
    assert meaningful_rates(pairs, np.arange(40) != 7) == ()
    assert meaningful_rates(pairs_of((wrong, ALIKE), NO_FLOW, np.arange(40) != 7), ALL_PIXELS) == ()


def test_estimates_without_disparity_and_flow_have_no_rates() -> None:
    assert meaningful_rates({"depth": EstimateTruthPair(ALIKE, APART)}, ALL_PIXELS) == ()
    assert meaningful_rates(pairs_of((APART * np.nan, APART), NO_FLOW), ALL_PIXELS) == ()


PERCENT = (0, 1, 5, 50, 95, 99, 100)
# Outside of 2^-48 to 2^48 there are no bins.
parts_of_values = some.one_of(
    some.floats(-1e9, 1e9).filter(lambda value: value == 0 or abs(value) > 1e-12), some.just(0.0), some.just(3.0)
)


@given(arrays.arrays(np.float64, some.integers(1, 60), elements=parts_of_values), some.integers(1, 5))
@example(np.array([-1.0, -1.0, 2.0]), 2)
@example(np.array([0.0, 0.0]), 1)
def test_parts_are_right_to_a_bin(whole: NDArray[np.float64], count: int) -> None:
    found = StreamingQuantiles(single=False)
    for part in np.array_split(whole, count):
        found.add(part)
    # Between two values, a histogram knows nothing: the quantile lies between the neighbouring ones, or in their bins.
    low, high = (np.percentile(whole, PERCENT, method=method) for method in ("lower", "higher"))
    widest = np.maximum(np.abs(low), np.abs(high)) * 2.0**-9 + 2.0**-48
    at = np.array(found.at(PERCENT))
    assert (at >= low - widest).all()
    assert (at <= high + widest).all()


def test_many_values_are_right_to_the_stated_bound() -> None:
    rng = np.random.default_rng(3)
    whole = rng.normal(0.2, 1.0, 200_000)
    found = StreamingQuantiles(single=False)
    for part in np.array_split(whole, 7):
        found.add(part)
    np.testing.assert_allclose(found.at(PERCENT), np.percentile(whole, PERCENT), rtol=2e-3)


def test_one_part_is_exact() -> None:
    whole = np.random.default_rng(4).normal(size=1001)
    found = StreamingQuantiles(single=True)
    found.add(whole)
    assert found.at(PERCENT) == np.percentile(whole, PERCENT).tolist()


@pytest.mark.parametrize("single", [True, False])
def test_of_nothing_there_are_none(single: bool) -> None:
    found = StreamingQuantiles(single=single)
    found.add(np.empty(0))
    assert np.isnan(found.at([50])).all()


def test_what_has_no_end_is_told_so() -> None:
    found = StreamingQuantiles(single=False)
    found.add(np.array([1.0, np.inf, np.inf]))
    low, middle, high = found.at([0, 50, 100])
    assert low == pytest.approx(1.0, rel=2e-3)
    assert (middle, high) == (np.inf, np.inf)
