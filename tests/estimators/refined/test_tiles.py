"""Tiles: they cover an image once, take the parts of the images that they need, and agree with the whole image."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.camera import Distortion
from scenetruth.estimators.refined import (
    FIT_LIMITS,
    DefectFilteredFrames,
    FrameEvidence,
    FramesNeeded,
    ImageStack,
    Region,
    RegionImages,
    Splines,
    choose_tiles,
    find_hidden,
    margin_px,
    spread_regions,
    withdraw_chance_results,
)
from scenetruth.indexing import centred_indices
from scenetruth.schema import REASONS, make_recording
from tests.helpers.nightly import nightly
from tests.helpers.scanned_plane import ScannedPlane
from tests.helpers.wavy_plane import MovingPlane, turning

PLANE = MovingPlane(size=(160, 200), gradient=turning(4e-3, -3e-3, 5e-3) + 2e-3 * np.eye(3))
SETTINGS: dict[str, Any] = {"window_sigma_px": 4.0, "discontinuity_refit": False}


@pytest.fixture
def limits() -> Iterator[None]:
    """Restore the sizes of tiles."""
    before = FIT_LIMITS.whole_pixels, FIT_LIMITS.tile_pixels
    yield
    FIT_LIMITS.whole_pixels, FIT_LIMITS.tile_pixels = before


@pytest.mark.parametrize("shape", [(2056, 2464), (1024, 1280), (701, 999), (300, 4000)])
@pytest.mark.parametrize("sigma_px", [2.0, 6.0, 10.0])
def test_tiles_cover_an_image_once(shape: tuple[int, int], sigma_px: float) -> None:
    tiles = choose_tiles(shape, sigma_px)
    covered, margin = np.zeros(shape, dtype=np.int64), margin_px(sigma_px)
    for tile in tiles:
        covered[tile.inner.rows, tile.inner.columns] += 1
        assert tile.region.height * tile.region.width <= FIT_LIMITS.tile_pixels
        # The kept part of the region is the inner part, and has the margin on all sides that are not the border.
        inner = np.zeros(shape, dtype=np.bool_)
        inner[tile.region.rows, tile.region.columns][tile.kept] = True
        assert inner[tile.inner.rows, tile.inner.columns].all()
        assert inner.sum() == tile.inner.height * tile.inner.width
        assert tile.region.top == max(tile.inner.top - margin, 0)
        assert tile.region.left + tile.region.width == min(tile.inner.left + tile.inner.width + margin, shape[1])
    assert (covered == 1).all()


def test_margins_take_less_than_a_third_of_a_large_image() -> None:
    total = sum(tile.region.height * tile.region.width for tile in choose_tiles((2056, 2464), 6.0))
    assert total < 1.3 * 2056 * 2464
    assert margin_px(6.0) % 4 == 0


def test_small_images_are_one_tile() -> None:
    (tile,) = choose_tiles((480, 640), 6.0)
    assert tile.region == tile.inner == Region(0, 0, 480, 640, (480, 640))


def test_sample_includes_the_corners() -> None:
    regions = spread_regions((2056, 2464))
    assert len(regions) == 25
    assert sum(each.height * each.width for each in regions) < 0.05 * 2056 * 2464
    assert {0, 2056 - 96} <= {each.top for each in regions}
    assert {0, 2464 - 96} <= {each.left for each in regions}


def test_parts_of_images_are_those_of_whole_images() -> None:
    """Coefficients at all positions that the initial fields predict, and grey values of the reference, are the same."""
    recording = PLANE.recording(cameras=3, frames=3)
    reader = DefectFilteredFrames(recording)
    placed = np.array([[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0]])
    centre = (99.5, 79.5)
    whole = Region(0, 0, 160, 200, (160, 200))
    outline = ImageStack([], placed, np.arange(-1.0, 2.0), 1000.0, centre, np.zeros((9, 4)), region=whole)
    source = RegionImages(reader, FramesNeeded(1, 0, 3), outline)
    region = Region(40, 60, 64, 80, (160, 200))
    fields = PLANE.start()[:, region.rows, region.columns]
    part = source.stack(region, PLANE.start())
    every = Splines(reader, 5).frames(0, 3)
    assert part.shape == (64, 80)
    assert part.origin is not None
    assert part.coefficients[0].shape[-1] < 200
    y, x = np.mgrid[40:104, 60:140]
    for n, (s, _, t) in enumerate(zip(*part.view()[:3], strict=True)):
        frame, camera = divmod(n, 3)
        d, q_x, q_y, q_z = fields
        scale = 1.0 / (1.0 + t * d * q_z / 1000.0)
        at_x = (x - centre[0] + d * (t * q_x - s)) * scale + centre[0]
        at_y = (y - centre[1] + d * t * q_y) * scale + centre[1]
        left, top = (part.origin[n] + [60, 40]).astype(int)
        height, width = part.coefficients[frame].shape[-2:]
        rows, columns = np.rint(at_y).astype(int), np.rint(at_x).astype(int)
        inside = (rows >= 3) & (rows < 156) & (columns >= 3) & (columns < 196)
        rows, columns = rows[inside], columns[inside]
        # With the samples around them.
        assert (rows - top).min() >= 3
        assert (rows - top).max() < height - 3
        assert (columns - left).min() >= 3
        assert (columns - left).max() < width - 3
        own = part.coefficients[frame][0, camera, rows - top, columns - left]
        np.testing.assert_allclose(own, every[frame][0, camera, rows, columns], rtol=0, atol=2e-6)
    as_whole = ImageStack(every, placed, outline.times, 1000.0, centre, outline.moved)
    np.testing.assert_allclose(part.reference_grey()[8:-8, 8:-8], as_whole.reference_grey()[48:96, 68:132], atol=2e-6)


def test_points_beyond_a_tile_occlude_those_within() -> None:
    """A strip in front of a plane, 40 px wide, hides the same points of a tile beside it as of the whole image."""
    recording = PLANE.recording(cameras=3, frames=3)
    placed = np.array([[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0]])
    centre, times = (99.5, 79.5), np.arange(-1.0, 2.0)
    start = np.zeros((4, 160, 200))
    start[0], start[1] = 8.0, 0.25
    start[0, :, 20:60] = 40.0
    whole = Region(0, 0, 160, 200, (160, 200))
    outline = ImageStack([], placed, times, 1000.0, centre, np.zeros((9, 4)), region=whole)
    reader = DefectFilteredFrames(recording)
    part = RegionImages(reader, FramesNeeded(1, 0, 3), outline).stack(Region(30, 64, 90, 100, (160, 200)), start)
    every = ImageStack(Splines(reader, 5).frames(0, 3), placed, times, 1000.0, centre, outline.moved)
    found = find_hidden(part, np.ascontiguousarray(start[:, 30:120, 64:164]))
    np.testing.assert_array_equal(found, find_hidden(every, start)[:, 30:120, 64:164])
    # From the camera at -1 at time 0, the strip is displaced by 32 px relative to the plane: over columns 52 to 91.
    hidden = (found[0, 45] >> 3) & 1
    assert 28 <= np.count_nonzero(hidden) <= 30


@pytest.mark.parametrize(
    ("fitting", "violated", "valid", "swept", "left"),
    [(100, 1000, 90, 300, [2, 3, 1, 0]), (100, 1000, 60, 300, [2, 0, 1, 0]), (100, 2500, 90, 300, [0, 0, 0, 0])],
)
def test_frames_in_which_almost_nothing_fits_are_invalid_as_a_whole(
    fitting: int, violated: int, valid: int, swept: int, left: list[int]
) -> None:
    status = np.array([[2, 3, 1, 0]], dtype=np.uint8)
    maps: dict[str, Any] = {
        "depth": np.where(status > 0, 5.0, np.nan),
        "velocity": np.where(status == 2, 1.0, np.nan) * np.ones((3, 1, 1)),
        "residual": np.ones(status.shape),
        "motion_model": (status == 2).astype(np.uint8),
        "status": status,
        "valid": status == 2,
        "status_disparity": np.array([[2, 3, 2, 0]], dtype=np.uint8),
        "invalid_reason": np.zeros(status.shape, dtype=np.uint8),
    }
    withdraw_chance_results(maps, FrameEvidence(fitting, violated, valid, swept))
    expected = np.array([left])
    np.testing.assert_array_equal(maps["status"], expected)
    np.testing.assert_array_equal(maps["status_disparity"] > 0, expected > 0)
    np.testing.assert_array_equal(np.isfinite(maps["depth"]), expected > 0)
    np.testing.assert_array_equal(np.isfinite(maps["velocity"][0]), expected == 2)
    np.testing.assert_array_equal(maps["valid"], expected == 2)
    np.testing.assert_array_equal(maps["motion_model"], expected == 2)
    assert (maps["residual"] == 1.0).all()


def _in_both(recording: xr.Dataset, **settings: Any) -> tuple[xr.Dataset, xr.Dataset]:
    """Return the estimates of a recording as a whole and in four tiles."""
    FIT_LIMITS.whole_pixels = 4e5
    whole = st.estimate(recording, "refined", **{**SETTINGS, **settings})
    FIT_LIMITS.whole_pixels, FIT_LIMITS.tile_pixels = 1.0, 13000.0
    assert len(choose_tiles((160, 200), 4.0)) == 4
    return whole, st.estimate(recording, "refined", **{**SETTINGS, **settings})


def _difference(whole: xr.Dataset, tiled: xr.Dataset, name: str) -> np.ndarray:
    """Return the differences in standard deviations, at pixels that are valid in both."""
    left, right = whole[name].values, tiled[name].values
    found = np.abs(left - right) / whole[f"{name}_std"].values
    return np.asarray(found[np.isfinite(found)])


@nightly
@pytest.mark.usefixtures("limits")
def test_tiles_agree_with_the_whole_image() -> None:
    """Windows are complete within the margin, so that fits are equal up to their convergence, 0.01 px per iteration.

    Standard deviations contain changes averaged over several windows, up to eight for growth, which margins truncate.
    """
    whole, tiled = _in_both(PLANE.recording(cameras=3, frames=5, noise_std=0.01))
    assert whole.attrs["excluded_images"] == tiled.attrs["excluded_images"] == "[]"
    for name in ("status", "motion_model", "surface_model", "invalid_reason"):
        assert np.mean(whole[name].values != tiled[name].values) < 1e-3
    for name in ("depth", "velocity", "slope", "growth_rate", "rotation_rate"):
        assert np.quantile(_difference(whole, tiled, name), 0.99) < 0.02
        ratio = tiled[f"{name}_std"].values / whole[f"{name}_std"].values
        low, high = np.nanquantile(ratio, (0.02, 0.98))
        assert 0.75 < low <= high < 1.34


def _assert_same(whole: xr.Dataset, tiled: xr.Dataset, near: float = 0.02) -> None:
    """Compare the maps of both, of which the same pixels are valid."""
    for name in ("status", "invalid_reason", "motion_model", "surface_model"):
        assert np.mean(whole[name].values != tiled[name].values) < 1e-3
    assert np.mean(whole["status"].values == 2) > 0.85
    for name in ("depth", "velocity", "slope", "growth_rate"):
        assert np.quantile(_difference(whole, tiled, name), 0.99) < near


@nightly
@pytest.mark.usefixtures("limits")
def test_tiles_have_the_lens_and_the_times_of_the_whole_image() -> None:
    """Barrel distortion and a rolling shutter depend on the place in the image, not in the tile."""
    plane = ScannedPlane(
        size=(160, 200), focal_px=300.0, depth_mm=300.0, baseline_mm=6.0, velocity_mm=(0.3, -0.2, -0.4), cameras=3,
        delay=0.1, line=0.5 / 160, distortion=Distortion(k1=-0.3, p1=2e-3), noise_std=0.01,
    )  # fmt: skip
    whole, tiled = _in_both(plane.recording())
    _assert_same(whole, tiled)
    inner = (0, slice(20, -20), slice(20, -20))
    error = (tiled["disparity"].values - plane.truth()["disparity"])[inner] / tiled["disparity_std"].values[inner]
    assert 0.7 < np.sqrt(np.nanmean(error**2)) < 1.3


@nightly
@pytest.mark.usefixtures("limits")
def test_tiles_have_the_colours_defects_and_noise_of_the_whole_image() -> None:
    """Single pixels, an area of all images, and a part of one image are missing; shot noise is that of a sensor."""
    images = PLANE.recording(cameras=3, frames=3, channels=3)["image"].values.copy()
    generator = np.random.default_rng(0)
    images += generator.normal(0.0, 1.0, images.shape) * np.sqrt(0.005**2 + 2e-4 * images)
    images[generator.random(images.shape[:-1]) < 0.003] = np.nan
    images[:, :, 70:90, 90:120] = np.nan
    images[0, 1, 20:60] = np.nan
    noise = {"dark_noise_dn": 0.005, "gain_dn_per_e": 2e-4}
    whole, tiled = _in_both(make_recording(images, 1000.0, 4.0), noise=noise)
    assert whole.attrs["excluded_pixel_counts"] == tiled.attrs["excluded_pixel_counts"]
    _assert_same(whole, tiled)
    np.testing.assert_array_equal(
        whole["invalid_reason"] == REASONS.index("masked"), tiled["invalid_reason"] == REASONS.index("masked")
    )


@nightly
@pytest.mark.usefixtures("limits")
def test_every_frame_is_the_same_in_tiles() -> None:
    """The first and the last frame have two frames, and noise is that of the images."""
    whole, tiled = _in_both(
        PLANE.recording(cameras=3, frames=4, noise_std=0.01), frames="all", window_frames=3, noise="estimated"
    )
    assert whole.sizes["t"] == 4
    _assert_same(whole, tiled, 0.1)


@nightly
@pytest.mark.usefixtures("limits")
def test_tiles_know_the_properties_of_whole_images() -> None:
    """An image that contradicts the others is excluded in all tiles; and a tile without texture is invalid."""
    images = PLANE.recording(cameras=3, frames=5, noise_std=0.01)["image"].values.copy()
    generator = np.random.default_rng(0)
    images[:, :, :76, :96] = 0.5 + generator.normal(0.0, 0.01, images[:, :, :76, :96].shape)
    images[2, 4] = images[2, 4][::-1, ::-1]
    images[1, 2, 100:104, 120:123] = np.nan
    with pytest.warns(st.EstimateWarning, match=r"\(s 1, t 2\) are excluded"):
        whole, tiled = _in_both(make_recording(images, 1000.0, 4.0))
    assert whole.attrs["excluded_images"] == tiled.attrs["excluded_images"] == "[[1, 2]]"
    assert whole.attrs["excluded_pixel_counts"] == tiled.attrs["excluded_pixel_counts"]
    status = [each["status"].values for each in (whole, tiled)]
    assert np.mean(status[0] != status[1]) < 3e-3
    assert (tiled["status"].values[..., 10:60, 10:80] != 2).all()
    assert np.quantile(_difference(whole, tiled, "depth"), 0.98) < 0.1


@nightly
@pytest.mark.usefixtures("limits")
def test_poses_are_those_of_the_whole_image() -> None:
    """Shifts across the baselines, which look like no depth, are found from the sample."""
    moved = np.zeros((3, 5, 4))
    moved[:, :, 1] = np.random.default_rng(3).normal(0.0, 0.2, (3, 1))
    recording = PLANE.recording(cameras=3, frames=5, noise_std=0.01, moved=moved)
    whole, tiled = _in_both(recording, pose_corrections={"y_px": 0.2})
    found = [each["image_shift"].values[1].ravel() for each in (whole, tiled)]
    expected = moved[:, 2, 1] - moved[1, 2, 1]
    for each in found:
        np.testing.assert_allclose(each, expected, atol=0.02)
    np.testing.assert_allclose(found[0], found[1], atol=5e-3)


@nightly
@pytest.mark.usefixtures("limits")
def test_surfaces_that_move_unevenly_are_the_same_in_tiles() -> None:
    """The right half of the images moves by 0.15 mm (standard deviation) around its path: 0.3 px between frames."""
    generator = np.random.default_rng(5)
    away = {t: generator.normal(0.0, 0.15, 2) for t in centred_indices(5)}
    images = np.empty((3, 5, *PLANE.size))
    for i, x_mm in enumerate(PLANE.baseline_mm * centred_indices(3)):
        for j, t in enumerate(centred_indices(5)):
            off = away[t] / t if t else np.zeros(2)
            velocity = PLANE.velocity_mm[0] + off[0], PLANE.velocity_mm[1] + off[1], PLANE.velocity_mm[2]
            uneven = replace(PLANE, velocity_mm=velocity, seed=3)
            images[i, j] = PLANE.image((x_mm, 0.0), t)
            images[i, j, :, 110:] = uneven.image((x_mm, 0.0), t)[:, 110:]
    images += generator.normal(0.0, 0.01, images.shape)
    recording = make_recording(images, PLANE.focal_px, PLANE.baseline_mm)
    whole, tiled = _in_both(recording, frames="all", window_frames=3, noise="estimated")
    # Motions at the limit of what noise reveals differ.
    for name in ("status", "invalid_reason", "motion_model", "surface_model"):
        assert np.mean(whole[name].values != tiled[name].values) < 5e-3
    assert 0.3 < np.mean(whole["status"].values == 2) < 0.7
