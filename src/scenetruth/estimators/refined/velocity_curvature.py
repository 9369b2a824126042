"""Smooth part of the velocity of a surface: its second derivatives, which the linear velocity of a window lacks.

Where growth changes along a surface, the velocity is of second order within a window. Its image motion is that of a
surface that turns out of the image plane, whose perspective motion is of second order as well: growth is biased by
some Z tan(tilt) times its gradient. The smooth part is removed before windows are fitted, and added to the result.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.initialisation import fill_gaps
from scenetruth.estimators.refined.kernels.pixel_equations import PAIR_OF, SIDE_OF
from scenetruth.estimators.refined.kernels.window_solver import (
    FUNCTIONALS,
    VALUES,
    Fit,
    describe_element,
)
from scenetruth.kernels import kernel

__all__ = ["add_velocity", "remove_slopes", "remove_velocity", "smooth_velocity"]


VELOCITY_PLACES = [6, 9, 12]
"""Indices of q_X, q_Y and q_Z among the parameters."""
# Width of the smoothing in window widths: the noise of second derivatives is proportional to its third power, and is
# some thirty times below that of a window.
_WIDER = 3.0
_LEAST_WINDOWS = 36.0  # smallest surface with a smooth part, in squares of the window width
_Q_X = 3  # variance of q_X
_CUT = 3.0  # half-width of the smoothing in standard deviations
_RIDGE = 1e-6  # of the normal matrix of unit diagonal, for surfaces that are strips

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


def smooth_velocity(fit: Fit, among: Mask, sigma_px: float) -> Map:
    """Return the smooth velocity of surfaces, shape (3, y, x), from a fit with variances at included pixels; else NaN.

    It is the local polynomial of second order with Gaussian weights over the variances, at every other row and column.
    Parts that do not touch are separate surfaces. Pixels between them, whose windows show two surfaces, have the
    nearest one.
    """
    from scipy.ndimage import distance_transform_edt, find_objects, label, map_coordinates

    height, width = among.shape
    velocity, variance = fit.theta[VELOCITY_PLACES][:, ::2, ::2], fit.variance[_Q_X, ::2, ::2]
    included = among[::2, ::2] & np.isfinite(velocity).all(axis=0) & (variance > 0.0)
    out = np.full((3, *included.shape), np.nan)
    surfaces, _ = label(included)
    large = np.bincount(surfaces.ravel()) * 4 >= _LEAST_WINDOWS * sigma_px**2
    large[0] = False
    kept = large[surfaces]
    if not kept.any():
        return np.full((3, height, width), np.nan)
    nearest = distance_transform_edt(~included, return_distances=False, return_indices=True)
    owner = surfaces[nearest[0], nearest[1]]
    scale = 0.5 * _WIDER * sigma_px
    for number, box in enumerate(find_objects(owner), 1):
        if box is None or not large[number]:
            continue
        own = surfaces[box] == number
        part = variance[box]
        weights = np.where(own, np.median(part[own]) / np.where(own, part, 1.0), 0.0)
        smooth = _local_polynomial(np.where(own, velocity[(slice(None), *box)], 0.0), weights, scale)
        here = owner[box] == number
        out[(slice(None), *box)] = np.where(here, smooth, out[(slice(None), *box)])
    valid = np.asarray(np.isfinite(out).all(axis=0))
    filled = fill_gaps(out, valid) if valid.any() else out
    # Linear between rows and columns: cubic splines would oscillate near other surfaces.
    filled = np.pad(filled, ((0, 0), (0, 1), (0, 1)), mode="reflect", reflect_type="odd")
    places = np.mgrid[:height, :width] / 2.0
    fine = np.stack([map_coordinates(each, places, order=1, mode="nearest") for each in filled])
    return np.where(np.repeat(np.repeat(valid, 2, axis=0), 2, axis=1)[:height, :width], fine, np.nan)


def _local_polynomial(values: Map, weights: Map, sigma_px: float) -> Map:
    """Return the constant term of local polynomials of second order, shape (n, y, x)."""
    from scipy.ndimage import correlate1d

    reach = math.ceil(_CUT * sigma_px)
    at = np.arange(-reach, reach + 1) / sigma_px
    powers = np.exp(-0.5 * at**2) * at ** np.arange(5)[:, None]

    def moments(image: Map, degree: int) -> dict[tuple[int, int], Map]:
        rows = [correlate1d(image, powers[j], axis=-1, mode="constant") for j in range(degree + 1)]
        return {
            (j, k): correlate1d(rows[j], powers[k], axis=-2, mode="constant")
            for j in range(degree + 1)
            for k in range(degree + 1 - j)
        }

    sums, sides = moments(weights, 4), moments(weights * values, 2)
    terms = list(sides)
    normal = np.stack([np.stack([sums[j + m, k + n] for m, n in terms], axis=-1) for j, k in terms], axis=-2)
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("...ii->...i", normal), 1e-12))
    normal = normal * scale[..., :, None] * scale[..., None, :] + _RIDGE * np.eye(len(terms))
    right = np.stack([sides[term] for term in terms], axis=-1) * scale
    found = np.linalg.solve(normal, np.moveaxis(right, 0, -2).swapaxes(-1, -2))
    return np.asarray(np.moveaxis(found[..., terms.index((0, 0)), :] * scale[..., :1], -1, 0))


def remove_slopes(theta: Map, smooth: Map) -> Map:
    """Return parameters without velocity slopes where the smooth velocity is removed, as their curvature is."""
    out = theta.copy()
    for place in VELOCITY_PLACES:
        out[place + 1 : place + 3] = np.where(np.isfinite(smooth[0]), 0.0, out[place + 1 : place + 3])
    return out


def remove_velocity(products: Map, first_row: int, smooth: Map) -> None:
    """Remove a velocity from the normal equations of pixels, in place: their sides are M (d, q) + b."""
    q = np.nan_to_num(smooth[:, first_row : first_row + products.shape[1]])
    for field in range(7 if len(products) > SIDE_OF[4] else 4):
        products[SIDE_OF[field]] -= sum(products[PAIR_OF[field, 1 + c]] * q[c] for c in range(3))


def add_velocity(fit: Fit, smooth: Map, images: ImageStack, where: Mask, step: int = 1) -> None:
    """Add a velocity and its slopes to the parameters of an affine fit, in place, and to its rates if it has any.

    ``smooth``: The velocity at all pixels, shape (3, y, x).
    ``where``: Windows with a fit, at every n-th pixel, as the fit.
    ``step``: Distance of the windows.
    """
    nodes = slice(None), slice(None, None, step), slice(None, None, step)
    parts = [each[nodes] for each in (smooth, *np.gradient(smooth, axis=(2, 1)))]
    valid = where & np.isfinite([each[0] for each in parts]).all(axis=0)
    for c, place in enumerate(VELOCITY_PLACES):
        for offset, part in enumerate(parts):
            fit.theta[place + offset][valid] += part[c][valid]
    if fit.element.shape[1:] == fit.theta.shape[1:]:
        _describe_rates(fit.theta, valid, step, *images.centre, images.focal, fit.element)


@kernel()
def _describe_rates(
    theta: Any, where: Any, step: int, centre_x: float, centre_y: float, focal: float, element: Any
) -> None:
    """Write the rotation and growth rates of affine parameters."""
    values, gradients = np.empty(VALUES), np.empty((FUNCTIONALS, theta.shape[0]))
    for y in range(where.shape[0]):
        for x in range(where.shape[1]):
            if where[y, x] and not np.isnan(theta[0, y, x]):
                own = theta[:, y, x].copy()
                describe_element(3, 3, own, x * step - centre_x, y * step - centre_y, focal, values, gradients)
                for k in range(4, VALUES):
                    element[k, y, x] = values[k]
