"""Surfaces in front of others: every pixel is told of its own."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.refined import continues_on_both_sides, fill_beyond_images
from scenetruth.schema import make_recording
from scenetruth.schema.variables import MOTION_AFFINE
from tests.helpers.nightly import nightly
from tests.helpers.shifted_stack import shifted_parameters, shifted_stack
from tests.helpers.wavy_plane import MovingPlane

Array = NDArray[np.float64]
# Pixels are means of 3 x 3 samples, as a sensor takes them.
FINE = 3
SIZE, WIDE_PX = (48, 104), 20
NEAR_MM, FAR_MM = 450.0, 500.0
ROWS = slice(12, -12)
NOISE_STD = 0.003


def board(depth_mm: float, velocity_mm: tuple[float, float, float], seed: int) -> MovingPlane:
    return MovingPlane(
        slopes=(0.0, 0.0),
        velocity_mm=velocity_mm,
        depth_mm=depth_mm,
        focal_px=1000.0 * FINE,
        size=(SIZE[0] * FINE, SIZE[1] * FINE),
        waves=16,
        wavelengths_px=(5.0 * FINE, 15.0 * FINE),
        seed=seed,
    )


NEAR, FAR = board(NEAR_MM, (0.1, 0.0, 0.0), 3), board(FAR_MM, (0.0, 0.1, 0.0), 4)
HALF_MM = 0.5 * WIDE_PX * NEAR_MM / 1000.0


def recordings() -> tuple[xr.Dataset, xr.Dataset]:
    """A strip 20 px wide in front of a wall, and of one without texture, which move in different ways."""
    images = np.empty((2, 5, 5, *SIZE))
    for i, s in enumerate(range(-2, 3)):
        for j, t in enumerate(range(-2, 3)):
            inside = np.abs(NEAR._hit((s * 4.0, 0.0), t)[0][..., 0]) < HALF_MM
            near = NEAR.image((s * 4.0, 0.0), t)
            for n, far in enumerate((FAR.image((s * 4.0, 0.0), t), np.full_like(near, 0.5))):
                fine = np.where(inside, near, far)
                images[n, i, j] = fine.reshape(SIZE[0], FINE, SIZE[1], FINE).mean(axis=(1, 3))
    images += np.random.default_rng(7).normal(0.0, NOISE_STD, images.shape)
    textured, plain = (make_recording(each, 1000.0, 4.0) for each in images)
    return textured, plain


@pytest.fixture(scope="module")
def boards() -> tuple[xr.Dataset, xr.Dataset]:
    return recordings()


def estimated(recording: xr.Dataset, *, outlines: bool = True) -> xr.Dataset:
    return st.estimate(recording, "refined", window_frames=5, discontinuity_refit=outlines).isel(t=0, y=ROWS)


@pytest.fixture(scope="module")
def estimates(boards: tuple[xr.Dataset, xr.Dataset]) -> tuple[xr.Dataset, xr.Dataset]:
    """Of the wall with texture, and the same by whole windows only."""
    return estimated(boards[0]), estimated(boards[0], outlines=False)


def distances() -> Array:
    """Distance of each column from the strip's nearer edge, positive inside."""
    x = np.arange(SIZE[1]) - (SIZE[1] - 1) / 2
    return np.asarray(0.5 * WIDE_PX - np.abs(x))


def inner() -> NDArray[np.bool_]:
    """Columns that all cameras see, with their windows."""
    x = np.arange(SIZE[1]) - (SIZE[1] - 1) / 2
    return np.asarray(np.abs(x) < SIZE[1] / 2 - 24)


def test_every_pixel_is_told_of_its_own_surface(estimates: tuple[xr.Dataset, ...]) -> None:
    """Up to 1.5 px from the outline, on both sides, though windows are wider than the strip.

    Noise of 0.003 in windows of sigma 2.4 leaves some 1e-2 px of disparity, which is 0.6 mm; surfaces are 50 mm apart.
    """
    found, plain = estimates
    away = distances()
    truth = np.where(away > 0, NEAR_MM, FAR_MM)
    motion = np.where(away > 0, np.array(NEAR.velocity_mm)[:, None], np.array(FAR.velocity_mm)[:, None])
    for where in (away > 1.5, (away < -1.5) & inner()):
        known = (found["status"].values == 2)[:, where]
        assert known.mean() > 0.95
        error = np.abs(found["depth"].values - truth)[:, where][known]
        assert np.quantile(error, 0.98) < 2.0
        off = np.abs(found["velocity"].values - motion[:, None])[:2, :, where][:, known]
        assert np.quantile(off, 0.98) < 0.02
    # Whole windows see both at once.
    close = np.abs(away) < 5
    right = (plain["status"].values == 2) & (np.abs(plain["depth"].values - truth) < 2.0)
    assert right[:, close].mean() < 0.3


def test_error_bars_hold_beside_outlines(estimates: tuple[xr.Dataset, ...]) -> None:
    """Beyond 6 stated standard deviations lie at most 2 % where windows hold the outline."""
    found, away = estimates[0], distances()
    truth = np.where(away > 0, NEAR_MM, FAR_MM)
    motion = np.where(away > 0, np.array(NEAR.velocity_mm)[:, None], np.array(FAR.velocity_mm)[:, None])
    with np.errstate(invalid="ignore"):
        scaled = [np.abs(found["depth"].values - truth) / found["depth_std"].values]
        scaled += list(np.abs(found["velocity"].values - motion[:, None]) / found["velocity_std"].values)
    for each in scaled:
        close = each[:, (np.abs(away) > 1.5) & (np.abs(away) < 12) & inner()]
        assert np.mean(close[np.isfinite(close)] > 6) < 0.02


@nightly
def test_error_bars_of_velocity_hold_at_edges_of_changing_light() -> None:
    """Light grows on one half of a board and fades on the other: one gain for a window displaces the texture."""
    images = np.empty((5, 5, *SIZE))
    for i, s in enumerate(range(-2, 3)):
        for j, t in enumerate(range(-2, 3)):
            grows = NEAR._hit((s * 4.0, 0.0), t)[0][..., 0] > 0
            fine = NEAR.image((s * 4.0, 0.0), t) * np.where(grows, 1.0 + 0.04 * t, 1.0 - 0.04 * t)
            images[i, j] = fine.reshape(SIZE[0], FINE, SIZE[1], FINE).mean(axis=(1, 3))
    images += np.random.default_rng(7).normal(0.0, NOISE_STD, images.shape)
    found = st.estimate(make_recording(images, 1000.0, 4.0), "refined", window_frames=5, pose_corrections="none")
    close = slice(SIZE[1] // 2 - 16, SIZE[1] // 2 + 16)
    found = found.isel(t=0, y=ROWS, x=close)
    error = found["velocity"].values - np.array(NEAR.velocity_mm)[:, None, None]
    scaled = np.abs(error) / found["velocity_std"].values
    known = np.isfinite(scaled).all(axis=0)
    assert known.mean() > 0.6
    assert np.mean(scaled[:, known] > 6, axis=1).max() < 0.02


def test_an_untextured_wall_is_told_from_the_board_before_it(boards: tuple[xr.Dataset, xr.Dataset]) -> None:
    """Windows beside the board hold its texture; the wall's own pixels show none, and are not told."""
    known, away = estimated(boards[1])["status"].values == 2, distances()
    assert known[:, away > 1.5].mean() > 0.9
    # The outline's own gradient reaches 3 px beyond it.
    assert known[:, away < -5].mean() < 0.02


@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 90.0, 225.0])
def test_a_tilted_plane_continues_and_a_slope_between_two_surfaces_does_not(angle_deg: float) -> None:
    """The step is seen through a window, as the fit of two surfaces by one: of Gaussian shape, here σ = 2.5 px wide."""
    from scipy.special import erf

    sigma, small, step = 6.0, 2.5, 1.3
    y, x = np.mgrid[:60, :70] - 30.0
    direction = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    across = direction[0] * x + direction[1] * y

    def fields(disparity: Array, slope: Array) -> Array:
        return np.stack([disparity, slope * direction[0], slope * direction[1]])

    plane = fields(5.0 + 0.2 * across, np.full_like(x, 0.2))
    assert continues_on_both_sides(plane, sigma)[9:-9, 9:-9].all()
    slope = step * np.exp(-0.5 * (across / small) ** 2) / np.sqrt(2 * np.pi) / small
    between = fields(5.0 + 0.5 * step * erf(across / small / np.sqrt(2)), slope)
    steep = slope > 0.3 * slope.max()
    assert not continues_on_both_sides(between, sigma)[steep].any()
    assert not continues_on_both_sides(np.full_like(plane, np.nan), sigma).any()


def test_invalid_pixels_where_the_images_end_are_filled_and_holes_are_not() -> None:
    """Of three cameras with a disparity of 7 px, one does not show the first 7 columns."""
    images, theta = shifted_stack(lambda x, y: np.sin(x) * np.cos(y)), shifted_parameters()
    theta[0, :, 10:] += 0.5
    theta[:, :, :10], theta[:, 30:40, 40:50] = np.nan, np.nan
    found = fill_beyond_images(images, theta, 3)
    filled = np.isfinite(found[0]) & np.isnan(theta[0])
    # Fewer than half of the images show columns, and rows, 0 and 1, and 3 px around them are filled.
    assert filled[:, :5].all()
    assert not filled[6:-6, 5:].any()
    np.testing.assert_array_equal(found[:, 36, :5], np.repeat(theta[:, 36, 10:11], 5, axis=1))


@nightly
def test_anisotropic_growth_at_the_edges_of_the_images() -> None:
    """Windows at the edges are one-sided: the plain model would displace their velocities, by 1.6 deviations here."""
    tangents = np.array([[1.0, 0.0, 0.3], [0.0, 1.0, -0.2]])
    along, across = (np.outer(tangents[k], np.linalg.pinv(tangents)[:, k]) for k in (0, 1))
    plane = MovingPlane(size=(96, 128), gradient=0.01 * across - 0.004 * along, velocity_mm=(0.2, 0.1, 0.3))
    recording = plane.recording(noise_std=0.001, seed=3)
    found = st.estimate(recording, "refined", window_sigma_px=4.0, acceleration=False).isel(t=0)
    edge = np.ones((96, 128), dtype=np.bool_)
    edge[8:-8, 8:-8] = False
    valid = found["status"].values == 2
    error = (found["velocity"].values - plane.truth()["velocity"]) / found["velocity_std"].values
    for where in (valid & edge, valid & ~edge):
        assert (np.sqrt(np.mean(error[:, where] ** 2, axis=1)) < 1.35).all()
    assert np.mean(found["motion_model"].values[valid & edge] == MOTION_AFFINE) > 0.5
