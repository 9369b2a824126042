"""Interpolation between the nodes of a lattice."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels import lattice

SHAPE, STEP = (22, 31), 3


def places() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 10.0
    return y, x


def interpolated(values: NDArray[np.float64], *, positive: bool = False, signed: int = -1) -> NDArray[np.float64]:
    nodes = np.ascontiguousarray(values[:, ::STEP, ::STEP])
    smooth = np.zeros(nodes.shape[1:], dtype=np.bool_)
    models = np.zeros(smooth.shape, dtype=np.int8)
    lattice.find_smooth_cells(np.zeros_like(smooth), models, smooth)
    out, wanted = np.full_like(values, np.nan), np.ones(SHAPE, dtype=np.bool_)
    lattice.interpolate_rows(nodes, STEP, smooth, wanted, positive, signed, out, (0, SHAPE[0]))
    return out


def test_polynomials_of_third_degree_are_exact_up_to_the_borders() -> None:
    y, x = places()
    values = np.stack([1 + 2 * x - y**3 + x**3 * y**2, x * y, x**3 * y**3])
    out = interpolated(values)
    # Pixels beyond the last nodes are not interpolated.
    ends = [STEP * ((size - 1) // STEP) for size in SHAPE]
    assert np.isfinite(out[:, : ends[0], : ends[1]]).all()
    assert np.isnan(out[:, ends[0] :]).all()
    np.testing.assert_allclose(out[:, : ends[0], : ends[1]], values[:, : ends[0], : ends[1]], atol=1e-12)


def test_positive_values_remain_positive() -> None:
    values = np.random.default_rng(0).exponential(1.0, (1, *SHAPE)) ** 4
    ends = [STEP * ((size - 1) // STEP) for size in SHAPE]
    inner = (slice(None), slice(ends[0]), slice(ends[1]))
    assert (interpolated(values)[inner] < 0).any()
    assert (interpolated(values, positive=True)[inner] > 0).all()


def test_directions_of_arbitrary_sign() -> None:
    y, x = places()
    direction = np.stack([np.cos(0.3 * x + 0.2 * y), np.sin(0.3 * x + 0.2 * y), 0.1 * np.ones(SHAPE)])
    signs = np.random.default_rng(1).choice([-1.0, 1.0], SHAPE)
    out = interpolated(direction * signs, signed=0)
    known = np.isfinite(out[0])
    assert known.mean() > 0.8
    alike = np.abs((out * direction).sum(axis=0))[known]
    # |direction|² is 1.01; the error of cubic polynomials over 0.3 rad is below 1e-3.
    np.testing.assert_allclose(alike, 1.01, atol=1e-3)


@pytest.mark.parametrize("place", [(4, 5), (0, 0), (6, 9)])
def test_cells_beside_another_model_or_a_rough_node_are_not_smooth(place: tuple[int, int]) -> None:
    rough, models = np.zeros((8, 11), dtype=np.bool_), np.zeros((8, 11), dtype=np.int8)
    out = np.zeros_like(rough)
    lattice.find_smooth_cells(rough, models, out)
    assert out[:-1, :-1].all()
    changed = models.copy()
    changed[place] = -128
    lattice.find_smooth_cells(rough, changed, out)
    cells = np.argwhere(~out[:-1, :-1])
    assert (np.abs(cells - place).max(axis=1) <= 3).all()
    rough[place] = True
    lattice.find_smooth_cells(rough, models, out)
    cells = np.argwhere(~out[:-1, :-1])
    assert (np.abs(cells + 0.5 - place).max(axis=1) <= 0.5).all()


def test_parameters_of_a_node_are_converted_to_the_pixel() -> None:
    """A model of second order, carried from one node, is the polynomial itself."""
    generator = np.random.default_rng(2)
    c = generator.normal(size=6)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    theta = np.zeros((15, *SHAPE))
    theta[0] = c[0] + c[1] * x + c[2] * y + c[3] * x * x + c[4] * x * y + c[5] * y * y
    theta[1], theta[2] = c[1] + 2 * c[3] * x + c[4] * y, c[2] + c[4] * x + 2 * c[5] * y
    theta[3:6] = c[3:, None, None]
    theta[6], theta[7], theta[8] = 1.0 + 0.2 * x - 0.1 * y, 0.2, -0.1
    nodes = np.ascontiguousarray(theta[:, ::STEP, ::STEP])
    cells, wanted = np.ones(nodes.shape[1:], dtype=np.bool_), np.ones(SHAPE, dtype=np.bool_)
    out = np.full_like(theta, np.nan)
    lattice.carry_rows(nodes, STEP, cells, wanted, True, out, (0, SHAPE[0]))
    np.testing.assert_allclose(out, theta, atol=1e-9)
