"""Comparison of fits with the models of neighbours, beside shifted maps of all parameters."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.estimators.refined.fit_maps import carried, extract_fields
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels import neighbours
from tests.helpers.kernel_images import Array

HEIGHT, WIDTH, LIMIT = 23, 31, 0.5
OFFSETS = [(1, 0), (0, 1), (-2, 0), (0, -2), (WIDTH, 0), (0, HEIGHT), (0, -HEIGHT)]


def images() -> ImageStack:
    """Return an outline of images of five cameras in three frames, without grey values."""
    return ImageStack(
        [np.zeros((1, 5, HEIGHT, WIDTH), dtype=np.float32)] * 3,
        np.stack([np.arange(-2.0, 3.0), np.zeros(5)], axis=-1),
        np.array([-1.5, 0.0, 1.0]),
        300.0,
        (30.0, 20.0),
        np.zeros((15, 4)),
    )


def parameters(count: int) -> Array:
    """Return parameters of two surfaces, with pixels that are invalid."""
    generator = np.random.default_rng(count)
    theta = generator.normal(0.0, 0.02, (count, HEIGHT, WIDTH))
    theta[0] += 3.0 + 0.4 * (np.arange(WIDTH) > WIDTH // 2)
    theta[:, generator.random((HEIGHT, WIDTH)) < 0.1] = np.nan
    return theta


def compared(theta: Array, right: int, down: int) -> tuple[Array, Array]:
    """Return displacement and disparity of the neighbours' models at every pixel."""
    beside = extract_fields(carried(theta, right, down))
    with np.errstate(invalid="ignore"):
        return images().moved_px(extract_fields(theta), beside), beside[0]


@pytest.mark.parametrize("count", [15, 18])
@pytest.mark.parametrize(("right", "down"), OFFSETS)
def test_jumps_are_those_of_shifted_maps(count: int, right: int, down: int) -> None:
    theta, found = parameters(count), np.zeros((HEIGHT, WIDTH), dtype=np.bool_)
    arms = images().arms(len(extract_fields(theta)))
    for rows in ((0, 9), (9, HEIGHT)):
        neighbours.find_jumps(theta, arms, (right, down), LIMIT, found, rows)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    inside = (y - down >= 0) & (y - down < HEIGHT) & (x - right >= 0) & (x - right < WIDTH)
    expected = inside & ~(compared(theta, right, down)[0] <= LIMIT)
    np.testing.assert_array_equal(found, expected)
    assert not inside.any() or 0.1 < found[inside].mean() < 0.9


@pytest.mark.parametrize("count", [15, 18])
@pytest.mark.parametrize(("right", "down"), OFFSETS)
def test_surfaces_extend_over_the_farther_one_and_weaker_textures(count: int, right: int, down: int) -> None:
    theta = parameters(count)
    gradient = np.random.default_rng(9).exponential(1.0, (HEIGHT, WIDTH)).astype(np.float32)
    arms, (moved, beside) = images().arms(len(extract_fields(theta))), compared(theta, right, down)
    nearer = np.abs(theta[0]) > np.abs(beside)
    stronger = gradient > 4.0 * np.roll(gradient, (2 * down, 2 * right), axis=(0, 1))
    empty: NDArray[np.float32] = np.zeros((0, 0), dtype=np.float32)
    for texture, extended in ((empty, nearer), (gradient, nearer | stronger)):
        found = np.zeros((HEIGHT, WIDTH), dtype=np.bool_)
        for rows in ((0, 9), (9, HEIGHT)):
            neighbours.mark_extended(theta, arms, (right, down), LIMIT, texture, 4.0, found, rows)
        np.testing.assert_array_equal(found, (moved > LIMIT) & extended)
