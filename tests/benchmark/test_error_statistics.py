"""Figures of a case: known noise, blur and bias give themselves back."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as strategies
from scipy import ndimage, special

import scenetruth as st
from scenetruth.benchmark.cases import (
    ALL,
    COMMON_VALID,
    METHOD_VALID,
    BenchmarkRecord,
    CaseEstimates,
    all_cases,
    apply_changes,
)
from scenetruth.benchmark.error_statistics import (
    COVERAGE_FACTORS,
    compute_coverage,
    compute_interval_statistics,
    compute_rms_z,
    compute_sparsification,
    compute_statistic_records,
)
from scenetruth.benchmark.spatial_resolution import compute_amplitude_ratio, compute_cutoff_periods
from scenetruth.scene import Scene
from scenetruth.scoring.regions import visible_throughout
from scenetruth.simulation import simulate
from tests.helpers.nightly import nightly


def made(kind: str, value: float) -> tuple[xr.Dataset, xr.Dataset]:
    # Maps of the truth at t = 0 are the same with fewer images.
    few = apply_changes(all_cases()[kind].scene(value), {"frames.count": 2, "stage.positions": 2})
    recording, whole = simulate(Scene.from_dict(few))
    throughout = visible_throughout(whole)
    return recording, whole.sel(t=[0]).assign(seen_throughout=(("y", "x"), throughout))


def estimate_of(recording: xr.Dataset, truth: xr.Dataset, **changes: object) -> xr.Dataset:
    given = {"disparity": truth["disparity"].values, "velocity": truth["velocity"].values, **changes}
    return st.make_estimate(recording=recording, t=[0], **given)  # type: ignore[arg-type]  # any arrays


def one(
    rows: list[BenchmarkRecord], method: str, quantity: str, statistic: str, pixels: str = METHOD_VALID
) -> BenchmarkRecord:
    (found,) = [
        row
        for row in rows
        if (row.method, row.quantity, row.statistic, row.pixels) == (method, quantity, statistic, pixels)
    ]
    return found


@pytest.fixture(scope="module")
def still() -> tuple[xr.Dataset, xr.Dataset]:
    return made("noise", 0.005)


def test_known_noise_bias_and_error_bars_come_back(still: tuple[xr.Dataset, xr.Dataset]) -> None:
    recording, truth = still
    generator = np.random.default_rng(2)
    found = []
    exact = truth["disparity"].values
    for _ in range(12):
        noise = generator.normal(0, 0.02, exact.shape)
        std = np.full(exact.shape, 0.01)
        known = estimate_of(recording, truth, disparity=exact + 0.005 + noise, disparity_std=std)
        found.append(CaseEstimates({"known": known}, truth, recording, 0.005))
    rows = list(compute_statistic_records(all_cases()["noise"], 0.005, found))
    # 12 x 112 x 76 values: their standard deviation is known to 0.2 %, their mean to 6e-5.
    assert one(rows, "known", "disparity", "noise_std").value == pytest.approx(0.02, rel=0.02)
    assert one(rows, "known", "disparity", "bias").value == pytest.approx(0.005, abs=3e-4)
    assert one(rows, "known", "disparity", "density").value == 1
    assert one(rows, "known", "disparity", "rms_z").value == pytest.approx(np.hypot(2.0, 0.5), rel=0.02)
    # Velocity was given as it is, in float32.
    assert one(rows, "known", "velocity_x", "rmse").value < 1e-6


@nightly
def test_the_window_of_a_blurred_truth_comes_back() -> None:
    case, sigma_px = all_cases()["waves_of_motion"], 6.0
    expected = 2 * np.pi * sigma_px / np.sqrt(-2 * np.log(0.9))
    rows: list[BenchmarkRecord] = []
    # Around the period that is expected; farther away, nothing crosses.
    for value in (60.0, 72.0, 96.0):
        recording, truth = made(case.kind, value)
        # The window sees what lies beyond the image as well: a wave goes on there, here by its reflection.
        blurred = ndimage.gaussian_filter(truth["velocity"].values, (0, 0, sigma_px, 0), mode="reflect", truncate=6)
        estimates = {"blurred": estimate_of(recording, truth, velocity=blurred)}
        rows += case.further_rows(CaseEstimates(estimates, truth, recording, value))
    periods = {row.statistic: row.value for row in case.conclusions(rows)}
    first = periods["cutoff_period_first"]
    assert first == periods["cutoff_period_last"]
    assert first == pytest.approx(expected, rel=0.03)


@pytest.fixture(scope="module")
def star() -> tuple[xr.Dataset, xr.Dataset]:
    return made("star", 20.0)


@pytest.mark.parametrize("sigma_px", [3.0, 4.0, 6.0])
def test_the_window_of_a_blurred_star_comes_back(star: tuple[xr.Dataset, xr.Dataset], sigma_px: float) -> None:
    case, (recording, truth) = all_cases()["star"], star
    # The window sees what lies beyond the image as well; the star's middle is 6 sigma away from the border at least.
    blurred = ndimage.gaussian_filter(truth["velocity"].values, (0, 0, sigma_px, sigma_px), mode="reflect", truncate=6)
    estimates = {"blurred": estimate_of(recording, truth, velocity=blurred)}
    rows = [row for value in case.core for row in case.further_rows(CaseEstimates(estimates, truth, recording, value))]
    for row in rows:
        # Of a wave of one period exp(-(2 pi sigma / p)^2 / 2) is left; p changes by sigma / 4 within a window.
        assert row.value == pytest.approx(np.exp(-((2 * np.pi * sigma_px / row.level) ** 2) / 2), abs=0.01)
    periods = {row.statistic: row.value for row in case.conclusions(rows)}
    first = periods["cutoff_period_first"]
    assert first == periods["cutoff_period_last"]
    assert first == pytest.approx(2 * np.pi * sigma_px / np.sqrt(-2 * np.log(0.9)), rel=0.03)


def test_periods_lie_where_the_star_has_them(star: tuple[xr.Dataset, xr.Dataset]) -> None:
    case, truth = all_cases()["star"], star[1].isel(t=0)
    flow = truth["flow"].values[1]
    for value in case.core:
        region = case.region_at(truth, value)
        rows, columns = (np.flatnonzero(region.any(axis=axis)) for axis in (1, 0))
        middle, column = rows.mean(), flow[:, round(columns.mean())]
        # The displacement is zero a quarter of a period away from the star's middle, which is not that of the image.
        assert middle == (truth.sizes["y"] - 1) / 2 + 12
        above, below = column[: int(middle) + 1][::-1] <= 0, column[int(middle) + 1 :] <= 0
        for side in (above, below):
            assert np.argmax(side) == pytest.approx(value / 4, abs=1.5)
        # Half a pixel beside the middle, on triangles of 1 mm: 1.5 % less each, at 18 px.
        assert flow[int(middle), columns] == pytest.approx(0.2, rel=0.035)


def test_methods_are_compared_on_what_all_tell(still: tuple[xr.Dataset, xr.Dataset]) -> None:
    recording, truth = still
    exact = truth["disparity"].values
    half, wrong = exact.copy(), exact + 0.3
    half[..., : exact.shape[-1] // 2] = np.nan
    estimates = {"half": estimate_of(recording, truth, disparity=half)}
    # Right where the other is silent.
    wrong[..., : exact.shape[-1] // 2] = exact[..., : exact.shape[-1] // 2]
    estimates["wrong"] = estimate_of(recording, truth, disparity=wrong)
    rows = list(
        compute_statistic_records(all_cases()["noise"], 0.005, [CaseEstimates(estimates, truth, recording, 0.005)])
    )
    assert one(rows, "half", "disparity", "density").value == pytest.approx(0.5, abs=0.01)
    assert one(rows, "half", "disparity", "inlier_rate", ALL).value == pytest.approx(0.5, abs=0.01)
    assert one(rows, "wrong", "disparity", "density").value == 1
    assert one(rows, "wrong", "disparity", "inlier_rate", ALL).value == pytest.approx(0.5, abs=0.01)
    # Float32 leaves 2e-7 of 4.3 px.
    assert one(rows, "half", "disparity", "rmse", COMMON_VALID).value < 1e-5
    assert one(rows, "wrong", "disparity", "rmse", COMMON_VALID).value == pytest.approx(0.3, rel=1e-4)
    assert one(rows, "wrong", "disparity", "rmse").value == pytest.approx(0.3 / np.sqrt(2), rel=0.02)


def test_a_method_that_gives_less_is_not_asked_for_more(still: tuple[xr.Dataset, xr.Dataset]) -> None:
    recording, truth = still
    depth_only = st.make_estimate(recording=recording, t=[0], depth=truth["depth"].values)
    rows = list(
        compute_statistic_records(
            all_cases()["noise"], 0.005, [CaseEstimates({"depth": depth_only}, truth, recording, 0.005)]
        )
    )
    assert {row.quantity for row in rows} == {"depth", "disparity"}


GENERATOR = np.random.default_rng(3)


def test_noise_and_bias_come_back() -> None:
    errors = GENERATOR.normal(0.03, 0.2, (4, 90, 110))
    kept = GENERATOR.random(errors.shape) < 0.7
    found = compute_interval_statistics(errors, kept)
    # 27,720 values: their standard deviation is known to 0.4 %.
    assert found["precision_std"].value == pytest.approx(0.2, rel=0.02)
    assert found["bias"].value == pytest.approx(errors[kept].mean())
    assert found["rmse"].value == pytest.approx(np.hypot(0.03, 0.2), rel=0.02)
    # The median of |N(0, 1)| is 0.6745; the bias changes it by a hundredth.
    assert found["median_abs_error"].value == pytest.approx(0.6745 * 0.2, rel=0.03)
    for name in ("rmse", "precision_std", "bias"):
        assert found[name].ci_low < found[name].value < found[name].ci_high


def test_intervals_hold_the_truth_though_neighbours_err_alike() -> None:
    # Errors that are the same over some 5 px; single pixels drawn again would give intervals five times too small.
    held = 0
    for seed in range(60):
        white = np.random.default_rng(seed).normal(size=(1, 110, 146))
        smooth = ndimage.gaussian_filter(white, (0, 3, 3), mode="wrap")
        smooth *= 2 * 3 * np.sqrt(np.pi)
        found = compute_interval_statistics(smooth, np.ones(smooth.shape, dtype=bool))["rmse"]
        held += found.ci_low <= 1.0 <= found.ci_high
    # 95 % of 60 are 57; fewer than 50 would happen once in a thousand tries.
    assert held >= 50


def test_nothing_is_told_of_nothing() -> None:
    assert compute_interval_statistics(np.zeros((1, 4, 4)), np.zeros((1, 4, 4), dtype=bool)) == {}
    few = np.zeros((1, 40, 40), dtype=bool)
    few[0, 3, 3:9] = True
    assert np.isnan(compute_interval_statistics(np.ones(few.shape), few)["rmse"].ci_low)


@given(strategies.floats(0.2, 5.0))
def test_error_bars_scaled_give_the_inverse(factor: float) -> None:
    errors = np.random.default_rng(1).normal(0, 0.1, 40_000)
    std = np.full(errors.shape, 0.1 * factor)
    # 40,000 values: to 0.4 %.
    assert compute_rms_z(errors, std) == pytest.approx(1 / factor, rel=0.02)
    expected = [special.erf(number * factor / np.sqrt(2)) for number in COVERAGE_FACTORS]
    np.testing.assert_allclose(compute_coverage(errors, std), expected, atol=0.01)


def test_confidence_that_knows_sorts_errors() -> None:
    std = GENERATOR.uniform(0.1, 1.0, 50_000)
    errors = GENERATOR.normal(0, std)
    curve = compute_sparsification(errors, std)
    assert np.all(np.diff(curve) > 0)
    # The surest tenth have standard deviations from 0.1 to 0.19.
    assert curve[0] == pytest.approx(np.sqrt(np.mean(np.linspace(0.1, 0.19, 100) ** 2)), rel=0.03)
    assert curve[-1] == pytest.approx(np.sqrt(np.mean(errors**2)))
    # Confidence that knows nothing leaves the same everywhere.
    np.testing.assert_allclose(compute_sparsification(errors, GENERATOR.random(errors.shape)), curve[-1], rtol=0.05)


@pytest.mark.parametrize("sigma_px", [3.0, 5.0, 8.0])
def test_the_cut_off_of_a_known_window_comes_back(sigma_px: float) -> None:
    # A Gaussian window leaves exp(-(2 pi sigma / p)^2 / 2) of a wave of period p.
    expected = 2 * np.pi * sigma_px / np.sqrt(-2 * np.log(0.9))
    periods = expected * np.array([2.5, 1.6, 1.2, 0.9, 0.6])
    left = []
    for period in periods:
        wave = np.cos(2 * np.pi * np.arange(4000) / period)
        blurred = ndimage.gaussian_filter1d(wave, sigma_px, mode="reflect", truncate=6)
        left.append(compute_amplitude_ratio(blurred[400:-400], wave[400:-400]))
    first, last = compute_cutoff_periods(list(periods), left)
    assert first == last
    # What is interpolated is of this form; the kernel is cut off and sampled.
    assert first == pytest.approx(expected, rel=0.01)


def test_crossings_that_are_not_there() -> None:
    assert compute_cutoff_periods([80, 40], [1.0, 0.99]) == (0.0, 0.0)
    assert compute_cutoff_periods([80, 40], [0.5, 0.4]) == (np.inf, np.inf)
    # Found again below: what looks resolved at 20 px is not to be trusted at 40 px.
    first, last = compute_cutoff_periods([80, 40, 20, 10], [1.0, 0.8, 0.95, 0.5])
    assert 40 < first < 80
    assert 10 < last < 20
    assert compute_cutoff_periods([80, 40, 20], [1.0, np.nan, np.nan])[0] > 40
