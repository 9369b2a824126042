"""How the noise's variance depends on the grey value, and what it brings to know it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st_
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from scenetruth.errors import RecordingError
from scenetruth.estimators.refined import (
    EVEN,
    GreyVariance,
    estimate_variance,
    photon_transfer_variance,
    resampled_transfer,
    spline_transfer,
)
from tests.helpers.estimated_plane import INSIDE, errors, estimated
from tests.helpers.nightly import by_night, nightly
from tests.helpers.wavy_plane import MovingPlane

DARK, GAIN = 0.004, 0.002


@given(st_.floats(0.1, 100.0), st_.floats(0.0, 10.0), st_.integers(0, 99))
def test_a_photon_transfer_is_found(gain: float, dark: float, seed: int) -> None:
    """Squares of 45 images scatter by a fifth; of 40,000 pixels, each quartile by 1 %; the line's ends by some more."""
    generator = np.random.default_rng(seed)
    grey = generator.uniform(10.0, 200.0, 40_000)
    true = dark**2 + gain * grey
    square = true * generator.chisquare(44, grey.shape) / 44
    # One of ten pixels is not fitted.
    square[::10] *= 9.0
    found, expected = estimate_variance(grey, square), photon_transfer_variance(dark, gain, 0.0, float(grey.mean()))
    at = np.array([10.0, 105.0, 200.0])
    np.testing.assert_allclose(found.at(at), expected.at(at), rtol=0.1, atol=0.02)
    np.testing.assert_allclose(expected.at(at), (dark**2 + gain * at) / (dark**2 + gain * grey.mean()), rtol=1e-9)


def test_equal_noise_stays_equal() -> None:
    generator = np.random.default_rng(0)
    grey = generator.uniform(10.0, 200.0, 40_000)
    found = estimate_variance(grey, generator.chisquare(44, grey.shape) / 44)
    np.testing.assert_allclose(found.at(np.array([10.0, 200.0])), 1.0, atol=0.05)
    # Less noise where it is brighter is no photon transfer; and nothing tells where all is alike, or nothing known.
    assert estimate_variance(grey, 1.0 / grey) == EVEN
    assert estimate_variance(np.full(1000, 7.0), np.ones(1000)) == EVEN
    assert estimate_variance(grey, np.full(grey.shape, np.inf)) == EVEN


def test_where_all_is_dark_noise_does_not_vanish() -> None:
    assert GreyVariance(-0.5, 1.0).at(np.array([0.0, 1.0])).tolist() == [0.01, 0.5]


def scaled(found: xr.Dataset, plane: MovingPlane) -> NDArray[Any]:
    parts = [errors(found, plane, name) / found[f"{name}_std"].isel(INSIDE).values for name in ("depth", "velocity")]
    return np.concatenate([part.reshape(-1, *part.shape[-2:]) for part in parts])


@nightly
def test_weights_by_noise_bring_smaller_errors_that_are_stated() -> None:
    """Grey values from 0.01 to 1 with shot noise: bright pixels have a hundred times the variance of dark ones."""
    plane = MovingPlane(size=(96, 128))
    recording = plane.recording()
    image = recording["image"]
    bright = 0.1 * np.exp(8.0 * (image.values - 0.5))
    noise = np.random.default_rng(1).normal(0.0, 1.0, image.shape) * np.sqrt(DARK**2 + GAIN * bright)
    recording = recording.assign(image=(image.dims, bright + noise, image.attrs))
    known: Any = {"dark_noise_dn": DARK, "gain_dn_per_e": GAIN}
    even, *weighted = (estimated(plane, recording, surface="plane", noise=n) for n in ("uniform", "estimated", known))
    for found in weighted:
        assert (found["depth_std"] / even["depth_std"]).median() < 0.97
        assert np.std(errors(found, plane, "depth")) < 0.95 * np.std(errors(even, plane, "depth"))
        # 20 windows that share no noise, four quantities: the root of 80 mean squares scatters by 8 %.
        assert np.sqrt(np.mean(scaled(found, plane) ** 2)) == pytest.approx(1.0, abs=0.2)
        # In grey values, of the mean one.
        expected = np.sqrt(DARK**2 + GAIN * bright[2, 4].mean())
        assert found["residual"].median() == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("order", [5, *by_night(3)])
def test_noise_after_two_interpolations(order: int) -> None:
    """White noise that is resampled at one subpixel position, and interpolated at all others, for each position."""
    generator = np.random.default_rng(order)
    noise = generator.standard_normal((400, 600))
    y, x = np.mgrid[20:380, 20:580].astype(float)
    for right, down in ((0.5, 0.5), (0.25, 0.0), (0.3, 0.4), (0.0, 0.0)):
        rows, columns = np.mgrid[:400, :600].astype(float)
        first = map_coordinates(noise, [rows + down, columns + right], order=5, mode="nearest")
        share = first[20:-20, 20:-20].var()
        at = [y + generator.uniform(0, 1, y.shape), x + generator.uniform(0, 1, x.shape)]
        found = map_coordinates(first, at, order=order).std()
        # 201,600 values, correlated over two pixels: 0.3 %.
        assert found == pytest.approx(float(resampled_transfer(order, share)), rel=0.012)
    assert float(resampled_transfer(order, 1.0)) == spline_transfer(order)


@nightly
def test_bars_of_resampled_images_are_right() -> None:
    """Images displaced by half a pixel along x and y have 70 % of the noise, but no less error of depth."""
    plane = MovingPlane(size=(96, 128))
    recording = plane.recording()
    noise = np.random.default_rng(1).normal(0.0, 0.02, recording["image"].shape)
    image = recording["image"].values + noise
    rows, columns = np.mgrid[:96, :128].astype(float)
    moved = np.array([[map_coordinates(each, [rows + 0.5, columns + 0.5], order=5, mode="nearest") for each in frames]
                      for frames in image])  # fmt: skip
    x, y = recording.attrs["principal_point_px"]
    resampled = recording.assign(image=(recording["image"].dims, moved, recording["image"].attrs))
    resampled = resampled.assign_attrs(principal_point_px=[x - 0.5, y - 0.5])
    share = np.full((96, 128), 0.8365**2, dtype=np.float32)
    stated = resampled.assign(noise_share=(("y", "x"), share))
    plain, right = (estimated(plane, given, surface="plane") for given in (resampled, stated))
    original = estimated(plane, recording.assign(image=(recording["image"].dims, image, recording["image"].attrs)),
                         surface="plane")  # fmt: skip
    for name in ("depth_std", "velocity_std"):
        # Windows on other pixels of the same noise.
        assert float((right[name] / original[name]).isel(INSIDE).median()) == pytest.approx(1.0, abs=0.04)
        assert float((plain[name] / original[name]).isel(INSIDE).median()) < 0.92
    # Noise and validity are those of the recorded images.
    assert float(right["residual"].isel(INSIDE).median()) == pytest.approx(0.02, rel=0.03)
    assert bool(right["valid"].isel(INSIDE).all())
    assert not bool(plain["valid"].isel(INSIDE).all())


@pytest.mark.parametrize(
    ("share", "problem"),
    [
        (("x", "y"), "must have the dimensions y and x"),
        (("y",), "must have the dimensions y and x"),
    ],
)
def test_noise_shares_of_other_dimensions_are_rejected(share: tuple[str, ...], problem: str) -> None:
    plane = MovingPlane(size=(24, 32))
    recording = plane.recording(cameras=2, frames=2)
    values = np.ones([recording.sizes[dim] for dim in share], dtype=np.float32)
    with pytest.raises(RecordingError, match=problem):
        estimated(plane, recording.assign(noise_share=(share, values)))
