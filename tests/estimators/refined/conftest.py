"""Images, fields of motion and warped images that tests of the kernels share."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from tests.helpers.kernel_images import COUNT, HEIGHT, WIDTH, Array, Warped, warped_by


@pytest.fixture(scope="module")
def images() -> Array:
    generator = np.random.default_rng(0)
    return np.array(ndimage.gaussian_filter(generator.normal(0, 10, (COUNT, HEIGHT, WIDTH)), (0, 1.5, 1.5)))


@pytest.fixture(scope="module")
def accelerated() -> Array:
    """Return d, q and acceleration of every pixel."""
    generator = np.random.default_rng(1)
    smooth = ndimage.gaussian_filter(generator.normal(0, 1, (7, HEIGHT, WIDTH)), (0, 6, 6))
    scale = np.reshape([5.0, 1.0, 1.0, 5.0, 1.0, 1.0, 5.0], (7, 1, 1))
    return np.array(scale * smooth + np.reshape([3.0, 0.2, -0.1, 1.0, 0.2, -0.3, 2.0], (7, 1, 1)))


@pytest.fixture(scope="module")
def fields(accelerated: Array) -> Array:
    return np.ascontiguousarray(accelerated[:4])


@pytest.fixture(scope="module")
def warped(images: Array, fields: Array) -> Warped:
    return warped_by(images, fields)
