"""Statistics against a reading in plain Python, and the laws that they obey."""

from __future__ import annotations

import math
import statistics

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from scenetruth.benchmark.benchmark_report import _SUMMARY_STATISTICS
from scenetruth.benchmark.cases.case import all_cases
from scenetruth.design.optimisation import design_records
from scenetruth.design.sweeps import sweep_result
from scenetruth.scoring.statistics import (
    STATISTIC_TITLES,
    STATISTICS,
    Statistics,
    endpoint_statistics,
    error_statistics,
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
    assert {*sweep_result.STATISTICS} <= {*STATISTIC_TITLES}
    assert {*design_records.STATISTICS, *(one.scored for one in design_records.STATISTICS.values())} <= {
        *STATISTIC_TITLES
    }
    assert {*_SUMMARY_STATISTICS, *(case.headline[1] for case in all_cases().values())} <= {*STATISTIC_TITLES}
    assert len({*STATISTIC_TITLES.values()}) == len(STATISTIC_TITLES)
