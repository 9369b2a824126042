"""Correlations of the images of a block, beside those of NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels import agreement
from tests.helpers.kernel_images import Array

COUNT, ROWS, WIDTH, COLUMNS, LEAST = 7, 12, 40, (5, 23), 0.5


def images() -> NDArray[np.float32]:
    """Return images of one texture with noise, gain, offset and invalid pixels; two of them without information."""
    generator = np.random.default_rng(5)
    texture = generator.normal(100.0, 20.0, (ROWS, WIDTH))
    noise = generator.normal(0.0, 1.0, (COUNT, 1, 1)) + generator.normal(0.0, 15.0, (COUNT, ROWS, WIDTH))
    values = (generator.uniform(0.5, 2.0, (COUNT, 1, 1)) * (texture + noise) + 7.0).astype(np.float32)
    values[generator.random(values.shape) < 0.2] = np.nan
    values[2] = 33.3
    values[5, :, : COLUMNS[0] + 12] = np.nan
    return values


def compared(warped: NDArray[np.float32]) -> tuple[Array, Array]:
    found, contrasts = np.empty(len(warped)), np.empty(len(warped))
    agreement.correlate_images(warped, COLUMNS, LEAST, found, contrasts)
    return found, contrasts


def test_correlations_are_those_with_the_mean_of_the_other_images() -> None:
    warped = images()
    found, contrasts = compared(warped)
    block = warped[:, :, slice(*COLUMNS)].reshape(COUNT, -1).astype(np.float64)
    known = np.isfinite(block)
    # Too few pixels, and no contrast.
    assert np.isnan([found[5], contrasts[5]]).all()
    assert (found[2], contrasts[2]) == (0.0, 0.0)
    used = [0, 1, 3, 4, 6]
    unit = {n: (block[n] - np.nanmean(block[n])) / np.nanstd(block[n]) for n in used}
    for n in used:
        np.testing.assert_allclose(contrasts[n], np.nanstd(block[n]), rtol=1e-12)
        others = np.stack([np.where(known[m], unit[m], 0.0) for m in used if m != n])
        number = np.maximum(known[[m for m in used if m != n]].sum(axis=0), 1)
        mean = (others.sum(axis=0) / number)[known[n]]
        np.testing.assert_allclose(found[n], np.corrcoef(unit[n][known[n]], mean)[0, 1], rtol=1e-10)
    assert 0.3 < found[used].min() < found[used].max() < 0.95


def test_a_single_image_with_contrast_has_no_others() -> None:
    warped = np.full((3, ROWS, WIDTH), 8.0, dtype=np.float32)
    warped[1] += np.arange(WIDTH, dtype=np.float32)
    found, contrasts = compared(warped)
    np.testing.assert_array_equal(found, [0.0, np.nan, 0.0])
    assert contrasts[1] > 0.0
    np.testing.assert_array_equal(contrasts[[0, 2]], 0.0)
