"""Demosaicing against the published kernels, against functions that it reproduces, and against its own mosaic."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from scenetruth.camera.sensor import demosaic, mosaic

PATTERNS = ("RGGB", "GRBG", "GBRG", "BGGR")
METHODS = ("bilinear", "malvar")
ALL = (*METHODS, "binomial")

# Malvar, He and Cutler (2004), figure 2, as printed.
GREEN_AT_RED = [[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]
RED_AT_GREEN_OF_RED_ROW = np.array(
    [[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1], [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]]
)
RED_AT_BLUE = [[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5], [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]]
BILINEAR_GREEN = [[0, 1, 0], [1, 0, 1], [0, 1, 0]]
BILINEAR_RED = [[1, 2, 1], [2, 4, 2], [1, 2, 1]]


def masks(shape: tuple[int, int], pattern: str) -> dict[str, Any]:
    """Return where each colour is, from the letters of the pattern."""
    y, x = np.indices(shape)
    letters = np.array(list(pattern))[2 * (y % 2) + x % 2]
    return {colour: letters == colour for colour in "RGB"}


def by_convolution(image: Any, pattern: str, method: str) -> Any:
    """Return the demosaiced image from whole-image convolutions that are put together by masks."""
    where = masks(image.shape, pattern)

    def filtered(values: Any, kernel: Any, scale: float) -> Any:
        return ndimage.convolve(values, np.array(kernel) / scale, mode="mirror")

    if method == "bilinear":
        green = filtered(image * where["G"], BILINEAR_GREEN, 4)
        channels = [filtered(image * where[colour], BILINEAR_RED, 4) for colour in "RB"]
        return np.stack([channels[0], np.where(where["G"], image, green), channels[1]], axis=-1)
    along_row = filtered(image, RED_AT_GREEN_OF_RED_ROW, 8)
    along_column = filtered(image, np.transpose(RED_AT_GREEN_OF_RED_ROW), 8)
    diagonal = filtered(image, RED_AT_BLUE, 8)
    channels = [np.where(where["G"], image, filtered(image, GREEN_AT_RED, 8))]
    for colour, other in ("RB", "BR"):
        has_colour = np.broadcast_to(where[colour].any(axis=1, keepdims=True), image.shape)
        at_green = np.where(has_colour, along_row, along_column)
        channels.append(np.select([where[colour], where[other]], [image, diagonal], at_green))
    return np.stack([channels[1], channels[0], channels[2]], axis=-1)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("pattern", PATTERNS)
@given(shape=st.tuples(st.integers(3, 9), st.integers(3, 9)), seed=st.integers(0, 99))
def test_equals_the_convolutions_of_the_paper(method: Any, pattern: str, shape: tuple[int, int], seed: int) -> None:
    image = np.random.default_rng(seed).uniform(-1, 1, shape)
    expected = by_convolution(image, pattern, method)
    # The sums have another order: a few roundings of values up to 3.
    np.testing.assert_allclose(demosaic(image, pattern, method), expected, rtol=0, atol=4e-15)


@pytest.mark.parametrize("pattern", PATTERNS)
@given(shape=st.tuples(st.integers(3, 9), st.integers(3, 9)), seed=st.integers(0, 99))
def test_binomial_is_bilinear_and_a_filter(pattern: str, shape: tuple[int, int], seed: int) -> None:
    image = np.random.default_rng(seed).uniform(-1, 1, shape)
    expected = by_convolution(image, pattern, "bilinear")
    kernel = np.outer([1, 4, 6, 4, 1], [1, 4, 6, 4, 1]) / 256
    expected = ndimage.convolve(expected, kernel[..., None], mode="mirror")
    np.testing.assert_allclose(demosaic(image, pattern, "binomial"), expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_affine_functions_of_each_colour_are_exact(method: Any, pattern: str) -> None:
    y, x = np.indices((12, 15)).astype(float)
    colour = np.stack([3 + x - 2 * y, 7 - 4 * x + y, 1 + 2 * x + 8 * y], axis=-1)
    result = demosaic(mosaic(colour, pattern), pattern, method)
    # Weights, coordinates and values are multiples of 1/16 below 2^53: exact. Mirrored ramps at borders are not ramps.
    np.testing.assert_array_equal(result[3:-3, 3:-3], colour[3:-3, 3:-3])
    assert np.abs(result - colour).max() > 1


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_colours_without_texture_are_exact_up_to_the_borders(method: Any, pattern: str) -> None:
    colour = np.broadcast_to(np.array([3.0, 5.0, 11.0]), (7, 8, 3))
    np.testing.assert_array_equal(demosaic(mosaic(colour, pattern), pattern, method), colour)


@pytest.mark.parametrize(("method", "share"), [("bilinear", 1 / 4), ("malvar", -1 / 4)])
def test_error_of_grey_parabolas_is_a_quarter_of_the_second_derivatives(method: Any, share: float) -> None:
    # Second moments of the kernels: green at red and blue, and the diagonal colour of Malvar, are wrong by ± 1/4 of
    # the Laplacian (bilinear: mean of x² over the cross is 1/2; Malvar adds 1/2 of -2 times the Laplacian).
    y, x = np.indices((14, 14)).astype(float)
    grey = 2 * x**2 + 3 * y**2 + x * y
    result = demosaic(grey, "RGGB", method)[2:-2, 2:-2] - grey[2:-2, 2:-2, None]
    at_red, at_green = result[::2, ::2], result[::2, 1::2]
    second = (4.0, 6.0)  # of x and y
    np.testing.assert_array_equal(at_red[..., 1], share * sum(second))
    np.testing.assert_array_equal(at_red[..., 0], 0)
    np.testing.assert_array_equal(at_red[..., 2], (2 if method == "bilinear" else 1) * share * sum(second))
    np.testing.assert_array_equal(at_green[..., 0], (2 if method == "bilinear" else 1) * share * second[0])
    np.testing.assert_array_equal(at_green[..., 2], (2 if method == "bilinear" else 1) * share * second[1])


@pytest.mark.parametrize("method", METHODS)
@given(seed=st.integers(0, 99), rows=st.integers(0, 3), columns=st.integers(0, 3))
def test_patterns_are_shifts_of_each_other(method: Any, seed: int, rows: int, columns: int) -> None:
    """Two pixels give the same pattern again: demosaicing is covariant under shifts by its period."""
    image = np.random.default_rng(seed).normal(size=(15, 16))
    letters = np.array(list("RGGB")).reshape(2, 2)
    pattern = "".join(np.roll(letters, (-rows, -columns), (0, 1)).ravel())
    shifted = demosaic(image[rows:, columns:], pattern, method)[2:-2, 2:-2]
    np.testing.assert_array_equal(shifted, demosaic(image, "RGGB", method)[rows + 2 : -2, columns + 2 : -2])


@pytest.mark.parametrize("method", METHODS)
@given(seed=st.integers(0, 99), pattern=st.sampled_from(PATTERNS), dtype=st.sampled_from(["u1", "u2", "f4", "f8"]))
def test_samples_are_kept_and_types_too(method: Any, seed: int, pattern: str, dtype: str) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (6, 5)).astype(dtype)
    result = demosaic(image, pattern.lower(), method)
    assert result.dtype == image.dtype
    np.testing.assert_array_equal(mosaic(result, pattern), image)


@pytest.mark.parametrize("method", ALL)
@given(seed=st.integers(0, 99), bits=st.sampled_from([8, 12, 16]))
def test_integers_are_rounded_and_clipped_at_full_scale(method: Any, seed: int, bits: int) -> None:
    largest = 2**bits - 1
    image = np.random.default_rng(seed).choice([0, largest // 2, largest], (8, 9))
    kind: Any = np.uint8 if bits == 8 else np.uint16
    result = demosaic(image.astype(kind), "BGGR", method, full_scale=largest)
    expected = np.clip(np.rint(demosaic(image.astype(float), "BGGR", method)), 0, largest)
    np.testing.assert_array_equal(result, expected)


def test_malvar_overshoots_unless_integers() -> None:
    edge = np.where(np.arange(12) < 6, 0, 255)[None, :] * np.ones((8, 1), int)
    assert demosaic(edge.astype(float), "RGGB", "malvar").min() < -10
    assert demosaic(edge.astype(np.uint8), "RGGB", "malvar").min() == 0


@pytest.mark.parametrize(
    ("image", "pattern", "method", "message"),
    [
        (np.zeros((4, 4)), "RGBG", "malvar", r"pattern: must be one of RGGB, GRBG, GBRG, BGGR; got 'RGBG'"),
        (np.zeros((4, 4)), "RGGB", "median", r"method: must be one of bilinear, malvar, binomial; got 'median'"),
        (np.zeros((1, 4)), "RGGB", "malvar", r"mosaic: must have the shape \(y, x\) with at least 2 x 2 pixels"),
        (np.zeros((4, 4, 3)), "RGGB", "malvar", r"mosaic: must have the shape"),
        (np.zeros((4, 4), bool), "RGGB", "malvar", r"mosaic: must be integers or floating-point numbers; got bool"),
    ],
)
def test_bad_input_is_named(image: Any, pattern: str, method: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        demosaic(image, pattern, method)


def test_mosaic_names_bad_input() -> None:
    with pytest.raises(ValueError, match=r"colour: must have the shape \(y, x, 3\); got \(4, 4\)"):
        mosaic(np.zeros((4, 4)), "RGGB")
