"""Figures of a case: an estimate made of the truth with known noise, blur and bias gives these back."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

import scenetruth as st
from scenetruth.benchmark.cases.case import ALL, COMMON_VALID, METHOD_VALID, BenchmarkRecord, CaseEstimates, all_cases
from scenetruth.benchmark.cases.reference_scene import apply_changes
from scenetruth.benchmark.error_statistics import compute_statistic_records
from scenetruth.scene import Scene
from scenetruth.scoring.regions import visible_throughout
from scenetruth.simulation import simulate


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
