"""Noise of demosaiced images against that of demosaiced impulses, and weights of channels of unequal noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from numpy.typing import NDArray
from scipy import ndimage

import scenetruth as st
from scenetruth.camera import demosaic, mosaic
from scenetruth.estimators.channel_noise import DEMOSAICED_NOISE, compute_channel_weights, read_demosaicing
from scenetruth.estimators.refined import resampled_transfer
from scenetruth.estimators.structure_tensor import PAPER
from scenetruth.schema import DEMOSAICING, STATUS_VALID
from tests.helpers.analytic_plane import Plane
from tests.helpers.nightly import nightly
from tests.helpers.wavy_plane import MovingPlane

SIZE = 32
METHODS: tuple[Any, ...] = DEMOSAICING
UNEQUAL, IN_ONE = (0.05, 0.0125, 0.0125), (0.02, 0.005, 0.005)
INNER = {"y": slice(16, -16, 3), "x": slice(24, -24, 3)}


def impulses(method: Any) -> NDArray[np.float64]:
    """Return the demosaiced images of one pixel of each phase of the pattern, shape (4, y, x, 3)."""
    found = []
    for y, x in np.ndindex(2, 2):
        image = np.zeros((SIZE, SIZE))
        image[SIZE // 2 + y, SIZE // 2 + x] = 1.0
        found.append(demosaic(image, "RGGB", method))
    return np.array(found)


def spectrum(responses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the power of the noise of unit variance, averaged over colours; white noise has 1."""
    return np.asarray((np.abs(np.fft.fft2(responses, axes=(1, 2))) ** 2).sum(axis=0).mean(axis=-1) / 4)


@pytest.mark.parametrize("method", METHODS)
def test_noise_of_pixels_and_residuals_is_that_of_impulses(method: Any) -> None:
    power, noise = spectrum(impulses(method)), DEMOSAICED_NOISE[method]
    assert noise.of_pixels == pytest.approx(power[0, 0] / power.mean(), abs=5e-4)
    spectra = np.fft.fft2(impulses(method), axes=(1, 2))
    for one, other in np.ndindex(3, 3):
        both = (spectra[..., one].conj() * spectra[..., other]).sum(axis=0) / 4
        expected, given_there = np.fft.ifft2(both).real / power[0, 0], noise.covariances[one][other]
        count = len(given_there)
        np.testing.assert_allclose(np.array(given_there).reshape(count, count), expected[:count, :count], atol=6e-6)
        # Beyond, pixels are independent.
        expected[np.ix_(*[np.arange(1 - count, count)] * 2)] = 0.0
        np.testing.assert_allclose(expected, 0.0, atol=6e-6)
    _, smoothing = PAPER.transfer(np.asarray(2 * np.pi * np.fft.fftfreq(SIZE), dtype=np.float64))
    passed = np.multiply.outer(np.abs(smoothing) ** 2, np.abs(smoothing) ** 2)
    assert noise.of_residuals == pytest.approx(power[0, 0] / (power * passed).sum() * passed.sum(), abs=2e-3)


@pytest.mark.parametrize("method", METHODS)
def test_share_is_what_splines_leave(method: Any) -> None:
    responses = impulses(method)
    left = 0.0
    for moved in (places := (np.arange(4) + 0.5) / 4):
        for other in places:
            for channel in range(3):
                shifted = ndimage.shift(responses[..., channel], (0, moved, other), order=5, mode="grid-wrap")
                left += float((shifted**2).sum()) / 4 / 3 / len(places) ** 2
    transfer = resampled_transfer(5, DEMOSAICED_NOISE[method].share)
    assert transfer**2 == pytest.approx(left / spectrum(responses)[0, 0], rel=0.02)


@pytest.mark.parametrize("method", METHODS)
def test_gradients_of_noise_are_those_of_splines(method: Any) -> None:
    """Cardinal splines of the noise of impulses, sampled at quarters of a pixel, and their central differences."""
    responses, step = impulses(method), 1e-3
    white = np.zeros((1, SIZE, SIZE, 1))
    white[0, SIZE // 2, SIZE // 2] = 1.0

    def of_slopes(images: NDArray[np.float64]) -> float:
        total = 0.0
        for image in np.moveaxis(images, -1, 1).reshape(-1, SIZE, SIZE):
            for place in np.ndindex(4, 4):
                y, x = (np.array(place) + 0.5) / 4
                ends = [ndimage.shift(image, (y, x + side), order=5, mode="grid-wrap") for side in (-step, step)]
                total += float(np.sum(((ends[1] - ends[0]) / (2 * step)) ** 2)) / 16
        return float(total / images.shape[-1] / len(images))

    ratio = of_slopes(responses) / of_slopes(white) / spectrum(responses)[0, 0]
    assert DEMOSAICED_NOISE[method].of_gradient == pytest.approx(ratio, rel=0.02)


@given(power=some.lists(some.floats(1e-6, 10.0), min_size=1, max_size=16))
def test_weights_make_noise_equal(power: list[float]) -> None:
    weights, given_power = compute_channel_weights(power), np.array(power)
    assert weights.mean() == pytest.approx(1.0)
    bounded = np.maximum(given_power, given_power.max() / 100)
    if bounded.max() <= 1.25**2 * bounded.min():
        np.testing.assert_array_equal(weights, 1.0)
    else:
        np.testing.assert_allclose(weights * bounded, (weights * bounded).mean(), rtol=1e-12)


@pytest.mark.parametrize("power", [[1.0, np.nan], [0.0, 0.0], [3.0]])
def test_weights_are_equal_where_noise_is_not_known(power: list[float]) -> None:
    np.testing.assert_array_equal(compute_channel_weights(power), 1.0)


def test_recording_states_its_demosaicing() -> None:
    images = np.zeros((2, 3, 30, 40, 3))
    assert read_demosaicing(st.make_recording(images, 500, 5)) is None
    stated = st.make_recording(images, 500, 5, attrs={"demosaicing": "malvar"})
    colours = stated.assign_coords(channel=["red", "green", "blue"])
    assert read_demosaicing(colours) == DEMOSAICED_NOISE["malvar"]
    # Of channels without names, the mean of the colours counts.
    noise, known = read_demosaicing(stated), DEMOSAICED_NOISE["malvar"].covariances
    assert noise is not None
    assert noise.covariances[0][0][0][0] == pytest.approx((2 * known[0][0][0][0] + known[1][1][0][0]) / 3)
    assert noise.covariances[0][1][0][0] == pytest.approx((2 * known[0][1][0][0] + known[0][2][0][0]) / 3)
    with pytest.raises(
        st.RecordingError, match=r"attrs.demosaicing: must be bilinear or malvar or binomial; .* \(got 'median'\)"
    ):
        st.make_recording(images, 500, 5, attrs={"demosaicing": "median"})


def scatter(std: tuple[float, ...], seeds: int, *, textured: int = 3) -> tuple[float, float]:
    """Return the scatter of depth over its uncertainty, and the scatter, of a plane with unequal noise.

    ``textured``: Number of channels with contrast.
    """
    recording = Plane(velocity=(0.1, -0.05, 0.3), size=(64, 84)).recording(np.arange(5) - 2, 9, channels=3)
    images = recording["image"].values.copy()
    images[..., textured:] = 0.5
    depth, stated = [], []
    for seed in range(seeds):
        noise = np.random.default_rng(seed).normal(0, 1, images.shape) * np.array(std) / 2
        noisy = recording.assign(image=(recording["image"].dims, (images + noise).astype(np.float32)))
        estimate = st.estimate(noisy).isel(t=0, **INNER)  # type: ignore[arg-type]
        assert (estimate["status"].values == STATUS_VALID).all()
        depth.append(estimate["depth"].values)
        stated.append(estimate["depth_std"].values.astype(np.float64))
    variance = float(np.var(depth, axis=0, ddof=1).mean())
    return float(np.sqrt(variance / np.mean(np.square(stated)))), float(np.sqrt(variance))


def test_noisy_channels_without_contrast_add_no_uncertainty() -> None:
    """Without weights, the noise of all channels is averaged, and the uncertainty is three times as large."""
    plain = Plane(velocity=(0.1, -0.05, 0.3), size=(40, 56)).recording([-1, 0, 1], 5)
    grey = plain["image"].values
    draws = np.random.default_rng(0).normal(0, 0.5, (*grey.shape, 3)) * np.array([0.0125, 0.05, 0.05])
    images = np.stack([grey, np.full_like(grey, 0.5), np.full_like(grey, 0.5)], axis=-1) + draws
    colour, alone = (
        st.estimate(
            st.make_recording(each.astype(np.float32), 1000.0, 1.0, full_scale=1.0, stage_x_mm=[-1.0, 0.0, 1.0]),
            working_point_px=2,
        )
        for each in (images, images[..., 0])
    )
    ratio = float(np.nanmedian(colour["depth_std"] / alone["depth_std"]))
    # Residuals of a window scatter by about 10 %.
    assert ratio == pytest.approx(1.0, abs=0.15)


@nightly
@pytest.mark.parametrize(("std", "textured"), [(UNEQUAL, 3), (IN_ONE, 1), (IN_ONE[::-1], 1)], ids=str)
def test_uncertainty_of_channels_of_unequal_noise(std: tuple[float, ...], textured: int) -> None:
    """Without weights, the ratio is 1.43 where only the noisy channel has contrast, and 0.3 where only a quiet has."""
    ratio, _ = scatter(std, 12, textured=textured)
    assert 0.75 <= ratio <= 1.25


@nightly
def test_quiet_channels_have_more_weight() -> None:
    # Of three textures of equal contrast: 0.025 / sqrt((1/2² + 2² + 2²) / 3), 0.60 of that of equal noise 0.025.
    (_, equal), (_, unequal) = scatter((0.025,) * 3, 12), scatter(UNEQUAL, 12)
    assert unequal / equal == pytest.approx(np.sqrt(3 / 8.25), rel=0.1)


@nightly
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("estimator", ["structure_tensor", "refined"])
def test_uncertainty_of_demosaiced_noise(method: Any, estimator: Any) -> None:
    """A grey plane behind a Bayer filter; without the attribute, ratios of refined are 1.5 and 1.9."""
    plane = MovingPlane(size=(72, 96), wavelengths_px=(8.0, 24.0))
    recording = plane.recording(5, 5)
    grey = recording["image"].values.astype(np.float64)
    settings: dict[str, Any] = {"window_sigma_px": 4.0, "discontinuity_refit": False} if estimator == "refined" else {}
    inner = (slice(18, -18, 2), slice(26, -26, 2))
    found: dict[bool, list[Any]] = {True: [], False: []}
    for seed in range(3):
        draws = np.random.default_rng(seed)
        images = np.empty((*grey.shape, 3))
        for index in np.ndindex(grey.shape[:2]):
            samples = mosaic(np.repeat(grey[index][..., None], 3, axis=-1), "RGGB")
            images[index] = demosaic(samples + draws.normal(0, 0.01, samples.shape), "RGGB", method)
        options: dict[str, Any] = {"full_scale": 1.0, "stage_x_mm": recording["stage_x_mm"].values}
        for stated in found:
            more: dict[str, Any] = {"demosaicing": method} if stated else {}
            colours = st.make_recording(
                images.astype(np.float32), plane.focal_px, plane.baseline_mm, attrs=more, **options
            )
            estimate = st.estimate(colours, estimator, **settings).sel(t=0)
            error = (estimate["depth"].values - plane.truth()["depth"])[inner]
            found[stated].append(error / estimate["depth_std"].values[inner])
    rms = {stated: float(np.sqrt(np.nanmean(np.square(each)))) for stated, each in found.items()}
    # About 20 windows that do not overlap: 9 %; biases of the filters add to those of the noise. The uncertainty of
    # refined includes the bias by aliases, which is larger than the noise behind a bilinear filter: 0.26 and 0.56.
    least = {"bilinear": 0.2, "malvar": 0.45, "binomial": 0.3}[method] if estimator == "refined" else 0.7
    assert least <= rms[True] <= 1.25
    assert rms[True] < rms[False] / 1.2
