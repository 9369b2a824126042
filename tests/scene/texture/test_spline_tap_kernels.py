"""Vector instructions for splines beside the same operations one by one, and beside SciPy."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from scenetruth.kernels import kernel
from scenetruth.scene.texture.spline_tap_kernels import spline_value
from scenetruth.scene.texture.texture_kernels import cubic_weights, spline_at


@kernel(cache=False)
def _value(flat, first, stride, right, below):  # type: ignore[no-untyped-def]
    return spline_value(flat, first, stride, right, below)


@kernel(cache=False)
def _value_at(flat, rows, columns, x, y):  # type: ignore[no-untyped-def]
    return spline_at(flat, rows, columns, x, y)


def test_values_are_those_of_single_operations_in_the_same_order() -> None:
    generator = np.random.default_rng(6)
    values = generator.standard_normal((7, 9)).astype(np.float32)
    for _ in range(200):
        row, column = int(generator.integers(0, 4)), int(generator.integers(0, 6))
        right, below = generator.random(2).astype(np.float32)
        across, down = (np.array(cubic_weights.py_func(share), dtype=np.float32) for share in (right, below))
        taps = values[row : row + 4, column : column + 4]
        columns = ((down[0] * taps[0] + down[1] * taps[1]) + down[2] * taps[2]) + down[3] * taps[3]
        terms = across * columns
        expected = (terms[0] + terms[1]) + (terms[2] + terms[3])
        assert _value(values.ravel(), row * 9 + column, 9, right, below) == expected


def test_splines_repeat_across_their_border() -> None:
    generator = np.random.default_rng(7)
    values = generator.standard_normal((8, 11)).astype(np.float32)
    places = generator.uniform(-12, 20, (300, 2))
    expected = map_coordinates(values.astype(np.float64), places.T, order=3, prefilter=False, mode="grid-wrap")
    found = [float(_value_at(values.ravel(), 8, 11, x, y)) / 36 for y, x in places]
    # float32 weights and sums of sixteen products.
    np.testing.assert_allclose(found, expected, atol=3e-6)
