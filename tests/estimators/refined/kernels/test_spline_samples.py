"""Samples of splines, compared with SciPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from scenetruth.estimators.refined.kernels.spline_samples import (
    cubic_values,
    quintic_values,
    sample_cubic,
    sample_quintic,
)


@pytest.mark.parametrize(
    ("sample", "only_values", "order"), [(sample_cubic, cubic_values, 3), (sample_quintic, quintic_values, 5)]
)
def test_values_and_derivatives_up_to_the_last_pixel(sample: Any, only_values: Any, order: int) -> None:
    """Vector instructions read beyond the last tap, but not beyond the last row of an image."""
    height, width = 9, 12
    generator = np.random.default_rng(order)
    coefficients = generator.normal(size=(height, width))
    down, right = np.mgrid[2 : height - 3, 2 : width - 3].reshape(2, -1)
    fractions = generator.uniform(size=(2, down.size)).astype(np.float32)
    offsets = (down - 2) * width + right - 2
    out = np.zeros((3, down.size), dtype=np.float32)
    single = coefficients.astype(np.float32)
    skipped = np.where(np.arange(down.size) == 3, -1, offsets)
    sample(single.ravel(), skipped, width, fractions[0], fractions[1], out)
    assert (out[:, 3] == 0).all()
    sample(single.ravel(), offsets, width, fractions[0], fractions[1], out)

    def at(by_x: float, by_y: float) -> Any:
        points = np.stack([down + fractions[1] + by_y, right + fractions[0] + by_x])
        return ndimage.map_coordinates(single.astype(float), points, order=order, prefilter=False)

    step = 1e-3
    slopes = [(at(step, 0) - at(-step, 0)) / (2 * step), (at(0, step) - at(0, -step)) / (2 * step)]
    np.testing.assert_allclose(out, [at(0, 0), *slopes], atol=3e-6)
    values = np.full(down.size, -1.0, dtype=np.float32)
    only_values(single.ravel(), skipped, width, fractions[0], fractions[1], values)
    assert values[3] == -1.0
    np.testing.assert_allclose(np.delete(values, 3), np.delete(at(0, 0), 3), atol=3e-6)
