"""Areas of polygons in pixels, against clipping of the polygon at every pixel."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as some
from numpy.typing import NDArray

from scenetruth.capture.coverage_kernels import add_edges

Array = NDArray[np.float64]
HEIGHT, WIDTH = 5, 7


def coverage(polygon: Array) -> Array:
    area = np.zeros((HEIGHT, WIDTH + 1))
    add_edges(polygon, np.roll(polygon, -1, axis=0), area)
    return np.cumsum(area, axis=1)[:, :-1]


def cut(polygon: list[Array], axis: int, limit: float, sign: float) -> list[Array]:
    """Keep the part of a polygon on one side of a line along an axis (Sutherland and Hodgman 1974)."""
    kept = []
    for one, other in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        a, b = sign * (one[axis] - limit), sign * (other[axis] - limit)
        if a >= 0:
            kept.append(one)
        if (a > 0 > b) or (a < 0 < b):
            kept.append(one + (other - one) * a / (a - b))
    return kept


def shoelace(polygon: list[Array]) -> float:
    return 0.5 * sum(
        float(one[0] * other[1] - other[0] * one[1])
        for one, other in zip(polygon, polygon[1:] + polygon[:1], strict=True)
    )


def clipped(polygon: Array) -> Array:
    areas = np.zeros((HEIGHT, WIDTH))
    for row, column in np.ndindex(areas.shape):
        part = list(polygon)
        for axis, low in ((0, column), (1, row)):
            part = cut(part, axis, low, 1.0) if part else part
            part = cut(part, axis, low + 1, -1.0) if part else part
        areas[row, column] = shoelace(part) if part else 0.0
    return areas


# Positions on pixel borders and beyond the image are as frequent as others.
PLACE: Any = some.one_of(
    some.floats(-4, 12), some.integers(-3, 10).map(float), some.integers(-6, 20).map(lambda n: n / 2)
)
POLYGON: Any = some.lists(some.tuples(PLACE, PLACE), min_size=3, max_size=8)


@given(corners=POLYGON)
def test_areas_are_those_of_clipped_polygons(corners: list[tuple[float, float]]) -> None:
    polygon = np.array(corners)
    # Polygons that cross themselves have signed areas in both. Areas are sums of about ten products of numbers below
    # 200, whose rounding errors are below 1e-13.
    np.testing.assert_allclose(coverage(polygon), clipped(polygon), rtol=0, atol=1e-11)


def test_square_that_covers_all_covers_each_pixel_once() -> None:
    square = np.array([[-3.0, -2.0], [20.0, -2.0], [20.0, 9.0], [-3.0, 9.0]])
    np.testing.assert_allclose(coverage(square), 1, rtol=0, atol=1e-13)
    np.testing.assert_allclose(coverage(square[::-1].copy()), -1, rtol=0, atol=1e-13)


def test_shared_edges_cancel() -> None:
    left = np.array([[0.3, 0.2], [2.7, 0.9], [3.1, 3.7], [0.6, 4.1]])
    right = np.array([[2.7, 0.9], [6.2, 1.3], [5.9, 4.4], [3.1, 3.7]])
    whole = np.array([[0.3, 0.2], [2.7, 0.9], [6.2, 1.3], [5.9, 4.4], [3.1, 3.7], [0.6, 4.1]])
    np.testing.assert_allclose(coverage(left) + coverage(right), coverage(whole), rtol=0, atol=1e-13)
