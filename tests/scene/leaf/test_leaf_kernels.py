"""The kernels of leaves beside plain readings."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.path import Path as Outline
from scipy.ndimage import map_coordinates

from scenetruth.scene.leaf.leaf_kernels import draw_dots, draw_veins, inside, look_up_linearly, net


def test_inside_is_the_even_odd_rule() -> None:
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    star = np.column_stack([np.cos(angle), np.sin(angle)]) * np.where(np.arange(40) % 2, 1.0, 0.5)[:, None]
    points = np.random.default_rng(2).uniform(-1.1, 1.1, (3000, 2))
    np.testing.assert_array_equal(inside(points, star), Outline(star).contains_points(points))


def test_dots_are_as_many_as_a_poisson_process_has() -> None:
    raster = np.zeros((200, 300), dtype=np.float32)
    places = np.array([[20.0, 30.0], [20.5, 30.0], [150.25, 100.5]])
    draw_dots(raster, places, 2.0, np.ones(3))
    y, x = np.mgrid[:200, :300]
    left = np.ones((200, 300))
    for column, row in places:
        square = (x - column) ** 2 + (y - row) ** 2
        left *= 1 - np.exp(-square / 8)
    # Dots end at 4.5 standard deviations, where exp(-4.5² / 2) = 4e-5.
    np.testing.assert_allclose(raster, 1 - left, atol=5e-5)
    assert raster.max() <= 1


def test_linear_interpolation_on_several_grids_is_that_of_scipy() -> None:
    generator = np.random.default_rng(4)
    sizes = np.array([[5, 9], [2, 3], [12, 4]])
    grids = [generator.normal(size=(3, *size)) for size in sizes]
    of_each = generator.integers(0, 3, 500)
    # A part of the places outside the grids, and some on their points.
    rows, columns = generator.uniform(-2, 14, (2, 500))
    rows[:60], columns[30:90] = np.round(rows[:60]), np.round(columns[30:90])
    first = np.cumsum([0, *(grid[0].size for grid in grids[:-1])])
    found = (np.empty(500), np.empty(500), np.empty(500))
    fields = np.concatenate([grid.reshape(3, -1) for grid in grids], axis=1)
    look_up_linearly(fields, sizes, first, of_each, rows, columns, found)
    for number, grid in enumerate(grids):
        here = of_each == number
        for values, field in zip(found, grid, strict=True):
            expected = map_coordinates(field, (rows[here], columns[here]), order=1, mode="nearest")
            # Few roundings of values of order one.
            np.testing.assert_allclose(values[here], expected, rtol=0, atol=1e-15)


def test_lines_have_their_profile() -> None:
    raster = np.zeros((40, 60), dtype=np.float32)
    draw_veins(raster, np.array([[-5.0, 20.0], [30.0, 20.0], [65.0, 20.0]]), np.full(3, 2.0), np.array([1.0, 0.5, 0.5]))
    rows = np.arange(40) - 20
    expected = np.exp(-(rows**2) / 8) * (np.abs(rows) < 8)
    np.testing.assert_allclose(raster[:, 45], 0.5 * expected, atol=1e-6)
    np.testing.assert_allclose(raster[20, :30], 1 - 0.5 * (np.arange(30) + 5) / 35, atol=1e-6)


def test_net_is_the_border_of_nearest_seeds() -> None:
    """The kernel against a plain reading over all seeds around."""
    generator = np.random.default_rng(5)
    seeds = 0.5 + generator.uniform(-0.36, 0.36, (8, 8, 2))
    powers = generator.uniform(0.3, 1, (8, 8))
    x, y = np.meshgrid(np.linspace(-3, 5, 23).astype(np.float32), np.linspace(-4, 9, 19).astype(np.float32))
    cell, sigma = (1.0, 1.9), 0.15
    found = net(x, y, seeds, powers, cell, sigma)
    row, column = np.mgrid[-8:12, -10:14]
    places = (np.stack([column, row], axis=-1) + seeds[row % 8, column % 8]).reshape(-1, 2) * cell
    power = powers[row % 8, column % 8].ravel()
    for i, j in np.ndindex(x.shape):
        apart = places - (x[i, j], y[i, j])
        first = np.argmin((apart**2).sum(1))
        across = places - places[first]
        size = np.linalg.norm(across, axis=1)
        size[first] = np.inf
        distance = ((apart + apart[first]) / 2 * across).sum(1) / size
        lines = (power + power[first]) / 2 * np.exp(-(distance**2) / (2 * sigma**2)) * (np.abs(distance) < 4 * sigma)
        lines[first] = 0
        # Float32 results; a profile ends at four standard deviations.
        assert found[i, j] == pytest.approx(lines.max(), abs=1e-6)
