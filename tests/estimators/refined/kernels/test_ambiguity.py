"""Dissimilarities of windows from sums over blocks, beside sums over pixels."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.estimators.refined.kernels import ambiguity
from tests.helpers.kernel_images import Array

HEIGHT, WIDTH, BLOCK = 27, 41, 3


def image() -> Array:
    return np.random.default_rng(0).normal(0.0, 1.0, (HEIGHT, WIDTH)).astype(np.float32)


@pytest.mark.parametrize(("right", "down"), [(0, 0), (4, 0), (-3, 5), (7, -2)])
def test_similarities_are_sums_of_products_over_blocks(right: int, down: int) -> None:
    grey, first = image(), 2
    sums = np.zeros((2, 5, 14), dtype=np.float32)
    ambiguity.add_similarity(grey, right, down, BLOCK, first, sums)
    expected = np.zeros_like(sums)
    for row, column in np.ndindex(5, 14):
        for y in range((first + row) * BLOCK, min((first + row + 1) * BLOCK, HEIGHT), 2):
            for x in range(column * BLOCK, min((column + 1) * BLOCK, WIDTH)):
                if 0 <= y + down < HEIGHT and 0 <= x + right < WIDTH:
                    a, b = grey[y, x], grey[y + down, x + right]
                    expected[:, row, column] += [a * b, a * a + b * b]
    np.testing.assert_allclose(sums, expected, atol=1e-4)


def test_windows_are_compared_by_weighted_sums_of_blocks() -> None:
    """Dense matrices of weights, without the windows that leave the image."""
    generator = np.random.default_rng(1)
    sums = generator.normal(0.0, 1.0, (2, 9, 14)).astype(np.float32)
    sums[1] = np.abs(sums[1]) + 2.0
    first = [np.array([0, 2, 4, 4]), np.array([0, 3, 6, 9, 9])]
    weights = [generator.uniform(0.1, 1.0, (len(places), 5)).astype(np.float32) for places in first]
    dense = [np.zeros((len(places), count)) for places, count in zip(first, sums.shape[1:], strict=True)]
    for matrix, places, values in zip(dense, first, weights, strict=True):
        for row, place, line in zip(matrix, places, values, strict=True):
            row[place : place + 5] = line
    inside = [generator.uniform(0.5, 1.0, (2, len(places))).astype(np.float32) for places in first]
    out = np.empty((4, 5), dtype=np.float32)
    pairs = [(places.astype(np.int64), values) for places, values in zip(first, weights, strict=True)]
    ambiguity.compare_windows(sums, pairs[0], pairs[1], inside[0], inside[1], 0.7, 1.1, out)
    cross, power = dense[0] @ sums.astype(np.float64) @ dense[1].T
    share = np.einsum("ky,kx->yx", *inside)
    expected = 1.0 - 2.0 * cross / np.maximum(power - 0.7 * share, 0.1 * power)
    np.testing.assert_allclose(out, np.where(share > 1.1, expected, 1.0), rtol=1e-4, atol=1e-5)
    assert 0.2 < (share > 1.1).mean() < 0.9
