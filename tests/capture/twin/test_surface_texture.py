"""Textures of twins: mean of the images, its noise, and the noise that is not part of a surface."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from scenetruth.capture.twin import (
    Canvas,
    ImageMean,
    ImageSet,
    MeasuredMotion,
    NoiseLine,
    SurfacePart,
    average_images,
    fit_noise_line,
    make_texture,
)
from tests.helpers.measured_twins import shifted_recording

STILL = MeasuredMotion("static", np.zeros(3), np.zeros(3), np.zeros((3, 3)))


def smooth_texture(shape: tuple[int, int], seed: int, sigma: float = 2.0) -> np.ndarray:
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal(shape), sigma, mode="wrap")
    return np.asarray(0.4 + 0.1 * noise / noise.std())


def wall(canvas: Canvas, depth: float = 500.0) -> SurfacePart:
    full = np.ones(canvas.shape, dtype=bool)
    return SurfacePart("surface_1", np.full(canvas.shape, depth), full, full, full)


def rendered(texture: np.ndarray) -> np.ndarray:
    """Return means over pixels of 4 x 4 samples, between which texels are interpolated bilinearly."""
    height, width = (size // 2 for size in texture.shape)
    rows, columns = ((np.arange(4 * size) + 0.5) / 2 - 0.5 for size in (height, width))
    samples = map_coordinates(texture, np.meshgrid(rows, columns, indexing="ij"), order=1, mode="nearest")
    return np.asarray(samples.reshape(height, 4, width, 4).mean(axis=(1, 3)))


def averaged(noise: float, seed: int = 3) -> tuple[ImageMean, np.ndarray, Canvas]:
    """Return the mean of five images, the true image on the canvas, and the canvas."""
    texture = smooth_texture((60, 96), seed)
    recording = shifted_recording(texture, 4.0, noise, seed)
    images = ImageSet.of(recording)
    canvas = Canvas(images.camera, 8)
    (mean,) = average_images(images, canvas, [wall(canvas)], [STILL])
    return mean, np.pad(texture, ((8, 8), (0, 0)), constant_values=np.nan), canvas


def test_the_mean_of_the_images_is_the_texture() -> None:
    mean, truth, _ = averaged(0.0)
    # The outer images show 8 px beyond the reference image.
    assert np.isfinite(mean.mean[8:-8]).all()
    assert np.nanmax(np.abs(mean.mean - truth)) < 1e-4
    assert mean.counts.sum(axis=0).max() == 5


def test_the_noise_of_the_mean_is_that_of_its_halves() -> None:
    noise = 0.02
    mean, truth, _ = averaged(noise)
    everywhere = mean.counts.sum(axis=0) == 5
    error = (mean.mean - truth)[everywhere]
    # 2640 pixels: the deviation of a standard deviation is 1.4 %.
    assert error.std() == pytest.approx(noise / np.sqrt(5), rel=0.07)
    assert mean.noise()[everywhere].std() == pytest.approx(error.std(), rel=0.07)
    assert np.sqrt(np.median(mean.variance[everywhere])) == pytest.approx(noise, rel=0.15)


def test_the_line_of_the_noise_is_recovered() -> None:
    dark, slope, count = 2e-5, 4e-4, 9
    draw = np.random.default_rng(5)
    level = np.linspace(0.1, 0.8, 120)[None] * np.ones((100, 1))
    values = level + np.sqrt(dark + slope * level) * draw.standard_normal((count, 100, 120))
    numbers = np.full((2, 100, 120), count / 2)
    mean = ImageMean(values.mean(axis=0), np.stack([values[::2].mean(axis=0)] * 2), numbers, values.var(axis=0, ddof=1))
    line = fit_noise_line([mean])
    assert line is not None
    assert line.slope == pytest.approx(slope, rel=0.1)
    assert line.variance(np.array(0.45)) == pytest.approx(dark + slope * 0.45, rel=0.03)
    assert fit_noise_line([ImageMean(level, np.stack([level] * 2), numbers, np.full(level.shape, np.nan))]) is None


@pytest.mark.parametrize("contrast", [0.0, 0.02, 0.1])
def test_noise_adds_no_contrast_to_the_texture(contrast: float) -> None:
    shape, noise = (80, 100), 0.01
    canvas = Canvas(ImageSet.of(shifted_recording(np.full((80, 108), 0.4), 2.0, 0.0, 1)).camera, 0)
    assert canvas.shape == shape
    truth = 0.4 + contrast / 0.1 * (smooth_texture(shape, 4, 2.5) - 0.4)
    draw = np.random.default_rng(6)
    halves = truth + np.sqrt(2) * noise * draw.standard_normal((2, *shape))
    mean = ImageMean(halves.mean(axis=0), halves, np.full((2, *shape), 5.0), np.full(shape, 10 * noise**2))
    texture = make_texture(canvas, wall(canvas), mean, NoiseLine(10 * noise**2, 0.0), 1)
    assert texture.shape == (160, 200)
    seen = rendered(texture)
    power = [float(np.mean(np.gradient(each)[0] ** 2)) for each in (seen, truth, mean.mean)]
    if contrast == 0.0:
        assert power[0] < 0.15 * power[2]
    elif contrast == 0.1:
        assert power[0] == pytest.approx(power[1], rel=0.1)
        assert np.abs(seen - truth).max() < 6 * noise
    else:
        # Noise triples the power of the gradient of the mean; it is removed but for the scatter of local powers.
        assert power[2] > 2.5 * power[1]
        assert power[0] == pytest.approx(power[1], rel=0.25)


def test_unknown_pixels_continue_smoothly() -> None:
    mean, _, canvas = averaged(0.0)
    holes = mean.mean.copy()
    holes[20:30, 20:30] = np.nan
    texture = make_texture(
        canvas, wall(canvas), ImageMean(holes, mean.halves, mean.counts, mean.variance), NoiseLine(0.0, 0.0), 1
    )
    assert np.isfinite(texture).all()
    assert texture.min() > 0.05
    assert texture.max() < 0.9
