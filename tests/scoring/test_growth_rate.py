"""Growth rates against closed forms, against windows fitted one by one, and with noise."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from scenetruth.errors import ScoreError
from scenetruth.schema import STATUS_NORMAL, Intrinsics, label
from scenetruth.scoring import compute_growth_rate, score
from scenetruth.scoring.error_pairs import compute_surface_points
from scenetruth.scoring.growth_rate import compute_growth_maps, compute_windowed_growth, label_depth_segments
from scenetruth.settings import ScoreSettings
from tests.helpers.synthetic_case import make_growing_case

Map = NDArray[np.float64]

INTRINSICS = Intrinsics(500.0, (39.5, 29.5), 5.0, 60.0)
SHAPE = (60, 80)
ROUNDING = 1e-11
"""Of rates of 1e-3 per frame: moments of depths of 600 mm keep about thirteen digits of slopes of 1 mm per px."""


def rays() -> Map:
    return compute_surface_points(np.ones(SHAPE), INTRINSICS)


def plane(tilt_deg: float) -> Map:
    """Return the depth of a plane through (0, 0, 600), turned about an axis in the image."""
    slope = math.tan(math.radians(tilt_deg))
    ray_x, ray_y, _ = rays()
    return np.asarray(600.0 / (1.0 - slope * (0.8 * ray_x + 0.6 * ray_y)))


def sphere(radius_mm: float = 60.0) -> tuple[Map, Map]:
    """Return depth, NaN beside it, and centre of a sphere before the camera."""
    centre = np.array([3.0, -2.0, 600.0])
    ray = rays()
    square, along = (ray**2).sum(axis=0), np.tensordot(centre, ray, 1)
    with np.errstate(invalid="ignore"):
        depth = (along - np.sqrt(along**2 - square * (centre @ centre - radius_mm**2))) / square
    return depth, centre


def growth(depth: Map, velocity: Map, window_px: float = 5.0, **settings: float) -> Map:
    chosen = ScoreSettings(growth_window_px=window_px, **settings)
    arrays = {"depth": depth, "velocity": velocity, "disparity": depth, "flow": velocity[:2]}
    arrays = {name: values[..., None, :, :] for name, values in arrays.items()}
    return np.asarray(compute_growth_rate(label("estimate", arrays, INTRINSICS, t=[0]), settings=chosen).values[0])


def turning(points: Map, omega: tuple[float, float, float]) -> Map:
    return np.cross(np.array(omega)[:, None, None], points, axis=0)


@pytest.mark.parametrize("tilt_deg", [0.0, 35.0, -65.0])
def test_plane_that_grows_by_different_rates_along_two_directions(tilt_deg: float) -> None:
    points = compute_surface_points(plane(tilt_deg), INTRINSICS)
    slope = math.tan(math.radians(tilt_deg))
    normal = np.array([0.8 * slope, 0.6 * slope, -1.0])
    first = np.cross(normal, [0.3, 1.0, 0.1])
    first /= np.linalg.norm(first)
    second = np.cross(normal / np.linalg.norm(normal), first)
    offset = points - np.array([5.0, 1.0, 600.0])[:, None, None]
    velocity = sum(
        rate * side[:, None, None] * np.tensordot(side, offset, 1) for rate, side in ((7e-4, first), (-2e-4, second))
    )
    found = growth(points[2], velocity + turning(points, (1e-3, 2e-3, -1e-3)) + 0.3)
    assert np.isfinite(found[10:-10, 10:-10]).all()
    np.testing.assert_allclose(found[np.isfinite(found)], 5e-4, rtol=0, atol=ROUNDING)


def test_isotropic_growth_of_a_plane_is_twice_the_linear_rate() -> None:
    points = compute_surface_points(plane(40.0), INTRINSICS)
    found = growth(points[2], 2.5e-4 * points)
    np.testing.assert_allclose(found[np.isfinite(found)], 5e-4, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("window_px", [1.5, 4.0, 9.0])
def test_sphere_of_growing_radius_grows_by_twice_its_relative_rate(window_px: float) -> None:
    depth, centre = sphere()
    points = compute_surface_points(depth, INTRINSICS)
    radius_rate = 0.03
    velocity = radius_rate / 60.0 * (points - centre[:, None, None])
    found = growth(depth, velocity, window_px)
    assert np.isfinite(found).sum() > 0.5 * np.isfinite(depth).sum()
    np.testing.assert_allclose(found[np.isfinite(found)], 2 * radius_rate / 60.0, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("shape", ["plane", "sphere"])
def test_rigid_motion_is_no_growth(shape: str) -> None:
    depth = plane(50.0) if shape == "plane" else sphere()[0]
    points = compute_surface_points(depth, INTRINSICS)
    found = growth(depth, turning(points, (0.01, -0.02, 0.03)) + np.array([1.0, -2.0, 3.0])[:, None, None])
    assert np.isfinite(found).any()
    # Velocities of 10 mm per frame instead of 1.
    np.testing.assert_allclose(found[np.isfinite(found)], 0.0, atol=10 * ROUNDING)


def test_growth_is_that_of_windows_fitted_one_by_one() -> None:
    rng = np.random.default_rng(5)
    points, velocity = rng.standard_normal((2, 3, 30, 40))
    y, x = np.indices((30, 40), dtype=np.float64)
    points += np.stack([x, y, 0.3 * x])
    patches = (rng.random((30, 40)) < 0.2).astype(np.int32) * -1
    patches[(patches == 0) & (x > 24)] = 1
    sigma = 3.0
    found = compute_windowed_growth(points, velocity, patches, sigma, min_coverage=0.3)
    checked = 0
    for row, column in np.argwhere(np.isfinite(found))[::7]:
        u, v = x - column, y - row
        near = (patches == patches[row, column]) & (np.maximum(abs(u), abs(v)) <= 9)
        root = np.exp(-(u[near] ** 2 + v[near] ** 2) / (4 * sigma**2))
        design = np.stack([np.ones(near.sum()), u[near], v[near]], axis=1) * root[:, None]
        values = np.concatenate([points[:, near], velocity[:, near]]).T * root[:, None]
        (_, by_x, by_y) = np.linalg.lstsq(design, values)[0]
        area = np.cross(by_x[:3], by_y[:3])
        change = np.cross(by_x[3:], by_y[:3]) + np.cross(by_x[:3], by_y[3:])
        assert found[row, column] == pytest.approx(change @ area / (area @ area), rel=1e-9, abs=1e-12)
        checked += 1
    assert checked > 50
    assert np.isnan(found[patches < 0]).all()


def test_growth_that_varies_is_averaged_by_the_window() -> None:
    """A slope fitted with Gaussian weights is the mean of the derivative with the same weights."""
    sigma, per_mm2 = 4.0, 1e-6
    points = compute_surface_points(plane(0.0), INTRINSICS)
    velocity = np.stack([per_mm2 * points[0] ** 3 / 6, 0 * points[0], 0 * points[0]])
    found = growth(points[2], velocity, sigma)[30, 15:65]
    pixel_mm = 600.0 / INTRINSICS.focal_length_px
    pointwise = per_mm2 * points[0, 30, 15:65] ** 2 / 2
    # The window ends at three standard deviations, which takes a tenth off its fourth moment (0.0887 of 3 sigma^4).
    np.testing.assert_allclose(found - pointwise, per_mm2 * (sigma * pixel_mm) ** 2 / 2, rtol=0.1)


def test_noise_falls_with_the_square_of_the_window() -> None:
    """White noise of U leaves sigma_U f / (2 pi^1/2 Z sigma^2) in the growth of a frontal plane."""
    rng = np.random.default_rng(8)
    noise, measured = 0.01, []
    depth = plane(0.0)
    for sigma in (3.0, 6.0):
        samples = [growth(depth, noise * rng.standard_normal((3, *SHAPE)), sigma)[18:-18, 18:-18] for _ in range(40)]
        measured.append(float(np.std(samples)))
        expected = noise * INTRINSICS.focal_length_px / 600.0 / (2 * math.sqrt(math.pi) * sigma**2)
        # 40 x 44 x 24 px hold about 40 x 1056 / (4 pi 36) > 90 independent windows: 7.5 %; the window's end adds 2 %.
        assert measured[-1] == pytest.approx(expected, rel=0.15)
    assert measured[0] / measured[1] == pytest.approx(4, rel=0.15)


def test_windows_do_not_reach_across_jumps_of_depth() -> None:
    depth = plane(0.0)
    left = np.indices(SHAPE)[1] < 40
    depth[:, :40] = 560.0
    velocity = np.where(left, 1.0, -1.0) * np.ones((3, *SHAPE))
    found = growth(depth, velocity)
    np.testing.assert_allclose(found[10:-10], 0.0, atol=ROUNDING)
    across = compute_windowed_growth(
        compute_surface_points(depth, INTRINSICS), velocity, np.zeros(SHAPE, dtype=np.int32), 5.0
    )
    assert np.abs(across[10:-10]).max() > 1e-3


def test_patches_are_connected_and_gentle() -> None:
    depth = np.array([[100.0, 101.0, 140.0], [100.0, np.nan, 141.0], [np.nan, 100.0, 100.0]])
    labels = label_depth_segments(depth, focal_length_px=100.0)
    assert labels[0, 0] == labels[0, 1] == labels[1, 0]
    assert labels[0, 2] == labels[1, 2] != labels[0, 0]
    assert labels[2, 1] == labels[2, 2]
    assert len(set(labels[labels >= 0].tolist())) == 3
    assert (labels == -1).tolist() == np.isnan(depth).tolist()
    # A step of 1 mm at 100 mm and f = 100 px is a slope of 45 degrees.
    assert label_depth_segments(np.array([[100.0, 101.0]]), 100.0, 45.1).tolist() == [[0, 0]]
    assert label_depth_segments(np.array([[100.0, 101.0]]), 100.0, 44.9).tolist() == [[0, 1]]


def test_windows_that_hold_too_little_have_no_growth() -> None:
    points = compute_surface_points(plane(0.0), INTRINSICS)
    whole = growth(points[2], 1e-4 * points, growth_min_coverage=0.5)
    strict = growth(points[2], 1e-4 * points, growth_min_coverage=1.0 - 1e-9)
    # At a straight border more than half of the weight is inside, in a corner about a quarter.
    assert np.isfinite(whole[30]).all()
    assert np.isnan(whole[0, 0])
    assert np.isfinite(strict[15:-15, 15:-15]).all()
    assert np.isnan(strict[:15]).all()
    line = np.full(SHAPE, np.nan)
    line[30] = 600.0
    assert np.isnan(growth(line, np.ones((3, *SHAPE)), growth_min_coverage=0.01)).all()


def test_estimate_of_the_truth_has_the_bias_of_the_window_only() -> None:
    case = make_growing_case()
    settings = ScoreSettings(growth_window_px=8)
    maps = compute_growth_maps(case.estimate, case.truth, settings)
    assert maps is not None
    np.testing.assert_array_equal(maps.estimate, maps.truth_windowed)
    known = np.isfinite(maps.estimate)
    factor = 100 * 3600 / 60
    assert np.nanmin(factor * maps.truth) == pytest.approx(1.0)
    assert np.nanmax(factor * maps.truth) == pytest.approx(3.0)
    bias = factor * (maps.estimate - maps.truth)[known]
    # The rate rises by 2 %/h over 144 px. At a straight border half a Gaussian is left, whose slope is that of
    # (2 / pi)^1/2 / (2 - 4 / pi) = 1.10 standard deviations further in; pixels are a tenth wider on one side.
    assert 1e-4 < np.abs(bias).max() < 1.10 * 1.1 * 2 * 8 / 144
    result = score(case.estimate, case.truth, settings={"interior_margin_px": 24, "growth_window_px": 8}).regions[
        "interior"
    ]
    assert result["growth_rate_windowed"]["rmse"] == 0.0
    # Whole windows average a rate that is linear on the leaf, nearly so in the image.
    assert abs(result["growth_rate"]["bias"] or 1) < 0.02
    assert result["growth_rate"]["density"] == 1.0


def test_bands_of_rows_are_the_whole_to_the_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    generator = np.random.default_rng(1)
    depth = sphere(60.0)[0] + generator.normal(0, 0.01, SHAPE)
    velocity = generator.normal(0, 1e-3, (3, *SHAPE))
    whole = growth(depth, velocity, 2.0)
    monkeypatch.setattr("scenetruth.scoring.growth_rate._BAND_PIXELS", 1)
    np.testing.assert_array_equal(growth(depth, velocity, 2.0), whole)
    assert np.isfinite(whole).sum() > 1000


def test_growth_is_scored_in_percent_per_hour() -> None:
    case = make_growing_case()
    factor = 100 * 3600 / 60
    faster = case.estimate.assign(velocity=1.5 * case.estimate["velocity"])
    result = score(faster, case.truth, settings={"growth_window_px": 8})
    expected = compute_growth_rate(faster, settings=ScoreSettings(growth_window_px=8)).values * factor
    error = expected - case.truth["growth_rate"].values * factor
    error = error[np.isfinite(error)]
    values = result.regions["all"]["growth_rate"]
    assert values["count"] == error.size
    assert values["bias"] == pytest.approx(error.mean())
    assert values["rmse"] == pytest.approx(np.sqrt((error**2).mean()))
    # Growth is linear in the velocity.
    assert result.regions["all"]["growth_rate_windowed"]["relative_rmse"] == pytest.approx(0.5)
    assert values["rms_z"] is None
    assert result.to_dataframe().loc[("all", "growth_rate"), "units"] == "%/h"
    hourly = [dataset.assign_attrs(frame_interval_s=3600.0) for dataset in (faster, case.truth)]
    slow = score(*hourly, settings={"growth_window_px": 8}).regions["all"]["growth_rate"]
    assert slow["rmse"] == pytest.approx(float(values["rmse"] or 0) / 60)


def test_only_full_pixels_are_used() -> None:
    case = make_growing_case()
    kind, velocity = case.estimate["status"].copy(deep=True), case.estimate["velocity"].copy(deep=True)
    kind[:, 50:60, 70:80] = STATUS_NORMAL
    velocity[:, :, 50:60, 70:80] = 1e3
    settings = ScoreSettings(growth_window_px=8)
    maps = compute_growth_maps(case.estimate.assign(status=kind, velocity=velocity), case.truth, settings)
    assert maps is not None
    np.testing.assert_array_equal(maps.estimate, maps.truth_windowed)
    assert np.isnan(maps.estimate[:, 50:60, 70:80]).all()


def test_growth_is_left_out_where_it_cannot_be_scored() -> None:
    case = make_growing_case(80, 60, 600.0)
    assert "growth_rate" not in score(case.estimate, case.truth.drop_vars("growth_rate")).regions["all"]
    still = case.estimate.assign(status=0 * case.estimate["status"])
    assert "growth_rate" not in score(still, case.truth).regions["all"]


@pytest.mark.parametrize(("name", "value"), [("growth_window_px", 0), ("growth_min_coverage", 1.5), ("growth", 1)])
def test_impossible_settings_are_refused(name: str, value: Any) -> None:
    case = make_growing_case(16, 12, 150.0)
    with pytest.raises(ScoreError, match=name):
        score(case.estimate, case.truth, settings={name: value})


def test_a_large_frame_takes_little_time() -> None:
    case = make_growing_case(640, 480, 5000.0)
    start = time.process_time()
    values = compute_growth_rate(case.estimate)
    # Processor time, which a busy machine hardly changes: 0.5 s is usual.
    assert time.process_time() - start < 5.0
    assert isinstance(values, xr.DataArray)
    assert (values.dims, values.attrs["units"]) == (("t", "y", "x"), "1/frame")


def test_truth_is_connected_by_its_own_surfaces() -> None:
    """An estimate that blurs a step connects both sides; the truth beside it does not."""
    depth = plane(0.0)
    left = np.indices(SHAPE)[1] < 40
    depth[:, :40] = 560.0
    velocity = np.where(left, 1.0, -1.0) * np.ones((3, *SHAPE))
    arrays = {"depth": depth, "velocity": velocity, "disparity": depth, "flow": velocity[:2], "growth_rate": 0 * depth}
    arrays = {name: values[..., None, :, :] for name, values in arrays.items()}
    truth = label("truth", arrays, INTRINSICS, t=[0])
    blurred = ndimage.gaussian_filter1d(depth, 6.0, axis=-1)
    settings = ScoreSettings(growth_window_px=5, growth_max_slope_deg=85)
    assert len(np.unique(label_depth_segments(blurred, INTRINSICS.focal_length_px, 85))) == 1
    maps = compute_growth_maps(truth.assign(depth=(truth["depth"].dims, blurred[None])), truth, settings)
    assert maps is not None
    np.testing.assert_allclose(maps.truth_windowed[:, 10:-10], 0.0, atol=ROUNDING)
    assert np.nanmax(np.abs(maps.estimate)) > 1e-3


def test_windows_do_not_reach_from_object_to_object() -> None:
    """Where objects touch, depth alone does not tell them apart; a truth does."""
    depth = plane(0.0)
    left = np.indices(SHAPE)[1] < 40
    velocity = np.where(left, 1.0, -1.0) * np.ones((3, *SHAPE))
    arrays = {"depth": depth, "velocity": velocity, "disparity": depth, "flow": velocity[:2]}
    arrays = {name: values[..., None, :, :] for name, values in arrays.items()}
    truth = label("truth", {**arrays, "object_id": left[None].astype(np.int32)}, INTRINSICS, t=[0])
    settings = ScoreSettings(growth_window_px=5)
    np.testing.assert_allclose(compute_growth_rate(truth, settings=settings).values[:, 10:-10], 0.0, atol=ROUNDING)
    assert np.nanmax(np.abs(compute_growth_rate(truth.drop_vars("object_id"), settings=settings).values)) > 1e-3


def test_pixels_unknown_to_the_estimate_are_in_no_window_of_the_truth() -> None:
    case = make_growing_case(80, 60, 620.0)
    kind, velocity = case.estimate["status"].copy(deep=True), case.truth["velocity"].copy(deep=True)
    kind[:, 20:30, 30:40] = STATUS_NORMAL
    settings = ScoreSettings(growth_window_px=5)
    estimate = case.estimate.assign(status=kind)
    expected = compute_growth_maps(estimate, case.truth, settings)
    velocity[:, :, 20:30, 30:40] = 1e3
    found = compute_growth_maps(estimate, case.truth.assign(velocity=velocity), settings)
    assert expected is not None
    assert found is not None
    np.testing.assert_array_equal(found.truth_windowed, expected.truth_windowed)


def test_growth_of_a_part_is_that_of_the_whole() -> None:
    """Places in space follow from the coordinates of the pixels, and windows are as wide on every other pixel."""
    points = compute_surface_points(plane(40.0), INTRINSICS)
    arrays = {"depth": points[2], "velocity": 2.5e-4 * points, "disparity": points[2], "flow": points[:2]}
    arrays = {name: values[..., None, :, :] for name, values in arrays.items()}
    whole = label("estimate", arrays, INTRINSICS, t=[0])
    settings = ScoreSettings(growth_window_px=4)
    for part in (whole.isel(x=slice(20, 70), y=slice(5, 50)), whole.isel(x=slice(None, None, 2), y=slice(1, None, 3))):
        found = compute_growth_rate(part, settings=settings)
        np.testing.assert_array_equal(found["x"], part["x"])
        assert np.isfinite(found.values).mean() > 0.8
        np.testing.assert_allclose(found.values[np.isfinite(found.values)], 5e-4, rtol=0, atol=ROUNDING)
    wider = label_depth_segments(whole["depth"].values[0, :, ::8], INTRINSICS.focal_length_px, 43.0, step_px=(1.0, 8.0))
    assert wider.max() == 0
    assert label_depth_segments(whole["depth"].values[0, :, ::8], INTRINSICS.focal_length_px, 43.0).max() > 0


def test_growth_needs_depth_and_velocity() -> None:
    case = make_growing_case(16, 12, 150.0)
    with pytest.raises(ScoreError, match=r"velocity: is missing; growth is computed from depth and velocity"):
        compute_growth_rate(case.estimate[["depth", "status"]])
    assert compute_growth_maps(case.estimate[["depth", "status"]], case.truth, ScoreSettings()) is None
