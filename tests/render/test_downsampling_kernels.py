"""The kernel that averages samples, beside its reading in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.render.downsampling_kernels import average_samples


@pytest.mark.parametrize("n", [1, 2, 5])
def test_means_are_those_of_numpy(n: int) -> None:
    generator = np.random.default_rng(3)
    height, width = 7, 11
    samples = generator.random((height * n, width * n), dtype=np.float32)
    weights = generator.random(n)
    weights /= weights.sum()
    out = np.empty((height, width), dtype=np.float32)
    average_samples(samples, weights, out)
    blocks = samples[::-1].reshape(height, n, width, n).astype(np.float64)
    # Rows of samples run from the bottom up, and so do those within a pixel.
    expected = np.einsum("ykxj,k,j->yx", blocks, weights, weights)
    np.testing.assert_allclose(out, expected, rtol=6e-8)


def test_equal_samples_keep_every_bit() -> None:
    value = np.float32(0.123456)
    out = np.empty((2, 2), dtype=np.float32)
    average_samples(np.full((14, 14), value), np.full(7, 1 / 7), out)
    assert (out == value).all()
