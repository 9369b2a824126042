"""Fits between every other row and column of one surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.fit_maps import carried
from scenetruth.estimators.refined.kernels import member_lattice, window_solver
from tests.helpers.kernel_images import Array

HEIGHT, WIDTH, EDGE = 9, 12, 7
ARMS, LIMITS = np.array([2.0, 2.0, 2.0, 0.2]), (0.25, 0.05)


def surface(d: float) -> Array:
    """Return the parameters of one curved surface in motion, at every pixel: those of one model, carried."""
    wide = np.full((15, 2 * HEIGHT, 2 * WIDTH), np.nan)
    wide[:, 0, 0] = np.random.default_rng(3).normal(0.0, 0.01, 15)
    wide[0, 0, 0] = d
    begun = np.empty((15, HEIGHT, WIDTH))
    for down, right in np.ndindex(HEIGHT, WIDTH):
        begun[:, down, right] = carried(wide, right, down)[:, down, right]
    return begun


def fitted(theta: Array) -> window_solver.Fit:
    """Return the fit of all pixels in a single row, of values that vary linearly, known at nodes only."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    along = (2.0 + 0.1 * x + 0.2 * y).reshape(1, -1)
    variance, element, of_element = (
        np.stack([n + along for n in range(count)]) for count in (9, window_solver.VALUES, window_solver.FUNCTIONALS)
    )
    # Directions of either sign.
    sign = np.where((x // 2 + y // 2) % 2 == 0, 1.0, -1.0).reshape(1, -1)
    element[window_solver.DIRECTION :] *= sign
    fit = window_solver.Fit(
        theta.reshape(15, 1, -1).copy(), variance, element, of_element, along.copy(), np.stack([along, 3.0 * along])
    )
    between = ((y % 2 == 1) | (x % 2 == 1)).ravel()
    for values in fit:
        values[..., between] = np.nan
    return fit


def interpolated(begun: Array, theta: Array) -> tuple[window_solver.Fit, Array, NDArray[np.bool_]]:
    fit, pixels = fitted(theta), np.argwhere(np.ones((HEIGHT, WIDTH), dtype=bool)).copy(order="C")
    index = np.arange(HEIGHT * WIDTH, dtype=np.int32).reshape(HEIGHT, WIDTH)
    nodes = member_lattice.is_node(pixels)
    left, shares = ~nodes, np.stack([fit.images[0], 2.0 * fit.images[0]], axis=-1)
    row = begun.reshape(15, 1, -1)
    member_lattice.interpolate_members(pixels, index, nodes, row, fit, shares, ARMS, LIMITS, left, (0, len(pixels)))
    return fit, shares, left.reshape(HEIGHT, WIDTH)


def test_one_surface_is_that_of_the_nodes() -> None:
    """Its parameters are exact between nodes, also of curvature, and values that vary linearly are, too."""
    theta = surface(20.0)
    fit, shares, left = interpolated(theta, theta)
    # The last column has no nodes to the right.
    inner = np.ones((HEIGHT, WIDTH), dtype=bool)
    inner[:, WIDTH - 1] = False
    np.testing.assert_array_equal(left, ~inner)
    known = inner.ravel()
    np.testing.assert_allclose(fit.theta.reshape(15, -1)[:, known], theta.reshape(15, -1)[:, known], rtol=1e-9)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    along = (2.0 + 0.1 * x + 0.2 * y).ravel()[known]
    for values, first in ((fit.variance[5, 0], 5.0), (fit.images[0], 0.0), (fit.element_variance[9, 0], 9.0)):
        np.testing.assert_allclose(values[known], first + along)
    np.testing.assert_allclose(fit.residual[1, 0, known], 3.0 * along)
    np.testing.assert_allclose(shares[known], np.stack([along, 2.0 * along], axis=-1))
    np.testing.assert_allclose(
        np.abs(fit.element[window_solver.DIRECTION :, 0, known]), along + np.array([[10], [11], [12]])
    )


def test_pixels_beside_another_surface_are_left() -> None:
    """Nodes across an edge are not used, neither those of other initial parameters, nor those of other fits."""
    one, other = surface(20.0), surface(20.0)
    other[0, :, EDGE:] += 1.0
    # Columns 6 and 8 have nodes: column 7 has one on each side, and the last column on one side only.
    beside = np.zeros((HEIGHT, WIDTH), dtype=bool)
    beside[:, [EDGE, WIDTH - 1]] = True
    beside[::2, ::2] = False
    for begun, theta in ((other, other), (other, one), (one, other)):
        _, _, left = interpolated(begun, theta)
        np.testing.assert_array_equal(left, beside)
