"""Maps of fits: parameters, selection between two fits, significant differences, and discontinuities."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels.neighbours import find_jumps, mark_extended
from scenetruth.estimators.refined.kernels.smoothing import gaussian_mean
from scenetruth.estimators.refined.kernels.warp import ACCELERATED, STEADY
from scenetruth.estimators.refined.kernels.window_solver import ALL, FULL, FUNCTIONALS, TOLD, VALUES, Fit
from scenetruth.threads import bands, in_threads

__all__ = [
    "CURVATURES",
    "DISCONTINUITY_PX",
    "LEAST_PX",
    "STEADY_PLACES",
    "VARIANCES",
    "accelerated",
    "between",
    "blank_fit",
    "carried",
    "carried_to",
    "chosen_fit",
    "differ",
    "every_nth",
    "every_other",
    "explained",
    "extract_fields",
    "fill_between",
    "find_discontinuities",
    "find_mixed_pixels",
    "initial_parameters",
    "nearest_node",
    "with_bias",
]


STEADY_PLACES = [0, 6, 9, 12]
"""Indices of d, q_X, q_Y and q_Z among the parameters."""
VARIANCES = (0, 3, 4, 5)
"""Their indices among the variances."""
CURVATURES = [3, 4, 5]
"""Indices of d_xx, d_xy and d_yy."""
_ACCELERATION = [15, 16, 17]

Map = NDArray[np.float64]


def initial_parameters(start: Map, *, accelerated: bool) -> Map:
    """Return initial parameters, shape (15 or 18, y, x), from disparity and velocity, shape (4, y, x)."""
    theta = np.zeros((ALL if accelerated else FULL, *start.shape[1:]))
    theta[STEADY_PLACES] = start
    return theta


def accelerated(theta: Map) -> Map:
    """Return parameters extended by an acceleration, 0 if there was none, shape (18, y, x)."""
    out = np.zeros((ALL, *theta.shape[1:]))
    out[: len(theta)] = theta
    return out


def extract_fields(theta: Map) -> Map:
    """Return d, q and, if present, their acceleration at the pixels, shape (4 or 7, y, x), from parameters."""
    return theta[STEADY_PLACES + (_ACCELERATION if len(theta) > FULL else [])]


def _count_fields(theta: Map) -> int:
    """Return the number of fields of parameters."""
    return STEADY if len(theta) <= FULL else ACCELERATED


def fill_between(theta: Map) -> None:
    """Propagate the parameters of even rows and columns to the pixels below and to the right, in place."""
    even = theta[:, ::2, ::2]
    for down, right in ((0, 1), (1, 0), (1, 1)):
        out = theta[:, down::2, right::2]
        out[:] = _moved(even[:, : out.shape[1], : out.shape[2]], right, down)


def carried(theta: Map, right: int, down: int) -> Map:
    """Return the parameters (15 or 18, y, x) at every pixel that follow from the model of the pixel at an offset."""
    height, width = theta.shape[1:]
    out = np.full_like(theta, np.nan)
    if abs(right) >= width or abs(down) >= height:
        return out
    rows, columns = slice(max(down, 0), height + min(down, 0)), slice(max(right, 0), width + min(right, 0))
    from_rows = slice(max(-down, 0), height + min(-down, 0))
    out[:, rows, columns] = _moved(theta[:, from_rows, max(-right, 0) : width + min(-right, 0)], right, down)
    return out


def carried_to(
    theta: Map, rows: NDArray[np.integer[Any]], columns: NDArray[np.integer[Any]], right: int, down: int
) -> Map:
    """Return the parameters (15 or 18, n) at some pixels that follow from the models of the pixels at an offset."""
    return _moved(theta[:, rows - down, columns - right], right, down)


def _moved(p: Map, right: int, down: int) -> Map:
    """Return parameters relative to another point of the window, at an offset in columns and rows."""
    moved = p.copy()
    x, y = float(right), float(down)
    moved[0] += p[1] * x + p[2] * y + p[3] * x * x + p[4] * x * y + p[5] * y * y
    moved[1] += 2.0 * p[3] * x + p[4] * y
    moved[2] += p[4] * x + 2.0 * p[5] * y
    for k in STEADY_PLACES[1:]:
        moved[k] += p[k + 1] * x + p[k + 2] * y
    return moved


_SIGNIFICANT = 4.0  # ratio of the squared change of disparity or velocity to that of noise from which it is significant
_EXPLAINED_PX = 0.17  # images are explained if the residual is at most that of a texture shift by this many px
_LEAST_PART = 0.5  # lower limit of the noise of their difference, relative to that of the finer fit
LEAST_PX = 2.5e-4
"""Lower limit of the noise of a difference, as an image shift in px.

Images are averages over few samples, and their splines are not exact. Without this limit, all fits would differ
significantly in images without noise.
"""
# Change of each parameter per px of image shift: velocities are multiplied by the disparity; q_Z also by x / f, about
# 1/16 near the edges of an image.
_PER_PX = (1.0, 1.0, 1.0, 16.0)
_STEADY = int(np.count_nonzero(TOLD < FULL))  # number of variances of a motion without acceleration


def blank_fit(state: Map, *, variances: bool, element: bool = True) -> Fit:
    """Return a fit with initial parameters; without the quantities of the surface ``element`` if not required."""
    shape = state.shape[1:] if variances else (1, 1)
    variance = np.full((np.count_nonzero(len(state) > TOLD), *shape), np.nan)
    element_shape = shape if element else (1, 1)
    values, of_element = (np.full((n, *element_shape), np.nan, dtype=np.float32) for n in (VALUES, FUNCTIONALS))
    images = np.full(shape, np.nan, dtype=np.float32)
    return Fit(state.copy(), variance, values, of_element, images, np.full((2, *state.shape[1:]), np.nan))


def chosen_fit(where: NDArray[np.bool_], fit: Fit, other: Fit) -> Fit:
    """Return one fit in the mask ``where``, else another; without acceleration, if one has none."""
    if len(fit.theta) != len(other.theta):
        fit, other = (each._replace(theta=each.theta[:FULL], variance=each.variance[:_STEADY]) for each in (fit, other))
    return Fit(*(np.where(where, getattr(fit, name), getattr(other, name)) for name in Fit._fields))


def explained(
    square: NDArray[np.floating[Any]], gradient: NDArray[np.floating[Any]], noise: float
) -> NDArray[np.bool_]:
    """Return where the residual of a fit is explained by noise or by the texture."""
    with np.errstate(invalid="ignore"):
        return np.asarray(square <= np.maximum(noise**2, _EXPLAINED_PX**2 * gradient))


def every_other(fit: Fit) -> Fit:
    """Return a fit at every other row and column."""
    return every_nth(fit, 2)


def every_nth(fit: Fit, step: int) -> Fit:
    """Return a fit at every n-th row and column."""
    return Fit._make(each[..., ::step, ::step] for each in fit)


def nearest_node(found: NDArray[np.bool_], step: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return a mask of every n-th row and column at all pixels: that of the nearest."""
    rows, columns = (
        np.minimum((np.arange(size) + step // 2) // step, count - 1)
        for size, count in zip(shape, found.shape, strict=True)
    )
    return np.asarray(found[rows][:, columns])


def between(found: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """Return a map of every other row and column, extended to the pixels below and to the right."""
    return np.asarray(np.repeat(np.repeat(found, 2, axis=0), 2, axis=1)[: shape[0], : shape[1]])


def differ(
    coarse: Fit,
    fine: Fit,
    sigma_px: float,
    *,
    motion: bool = False,
    among: NDArray[np.bool_] | None = None,
    most: float = np.inf,
    noise_ratio: float = 1.0,
) -> NDArray[np.bool_]:
    """Return where two fits differ by more than noise.

    If the coarse fit is optimal for its model, and the fine fit has the same images with more parameters or a smaller
    window, the variance of their difference due to noise is the difference of their variances. The squared difference,
    averaged over a window, must exceed four times that.

    ``among``: Pixels included in the average, shape (y, x); default: all.
    ``noise_ratio``: Variance of the parameters by noise relative to that which the fits state.
    """
    found = np.zeros(coarse.theta.shape[1:], dtype=np.bool_)
    for _, _, square, noise in _changes(coarse, fine, sigma_px, among, most, fields=4 if motion else 1):
        found |= square > _SIGNIFICANT * noise_ratio * noise
    return found


def with_bias(fine: Fit, coarse: Fit, sigma_px: float, coarse_sigma_px: float, noise_ratio: float = 1.0) -> Fit:
    """Return a fit in windows that are still too large, with the bias added to the variances of disparity and velocity.

    Where the fitted quantity changes within a window beyond the model, the bias is proportional to the square of the
    window width, so that it follows from the change between two widths.

    ``noise_ratio``: Variance by noise relative to that which the fits state; maps multiply variances by it.
    """
    share = sigma_px**2 / (coarse_sigma_px**2 - sigma_px**2)
    variance = fine.variance.copy()
    for _, number, square, noise in _changes(coarse, fine, sigma_px, None, np.inf):
        variance[number] += share**2 * np.maximum(square / noise_ratio - noise, 0.0)
    return fine._replace(variance=variance)


def _changes(
    coarse: Fit, fine: Fit, sigma_px: float, among: NDArray[np.bool_] | None, most: float, fields: int = 4
) -> Iterator[tuple[int, int, Map, Map]]:
    """Yield index and variance index of disparity and velocity, their squared change, and that due to noise."""
    before, share = np.zeros(0, dtype=np.bool_), np.zeros(0)
    for place, number, per_px in list(zip(STEADY_PLACES, VARIANCES, _PER_PX, strict=True))[:fields]:
        with np.errstate(invalid="ignore"):
            # A curved surface in full windows may be less certain than a plane in small windows.
            floor = LEAST_PX * per_px / (1.0 if place == 0 else np.maximum(np.abs(coarse.theta[0]), 1e-3))
            least = np.maximum(_LEAST_PART * fine.variance[number], floor**2)
            noise = np.maximum(fine.variance[number] - coarse.variance[number], least)
            square = np.minimum((fine.theta[place] - coarse.theta[place]) ** 2, most * noise)
            known = np.isfinite(square) & np.isfinite(noise) & (True if among is None else among)
            if not np.array_equal(known, before):
                mean = np.maximum(gaussian_mean(known.astype(np.float64), sigma_px), 1e-9)
                before, share = known, np.where(known, mean, np.inf)
            changed, expected = (
                gaussian_mean(np.where(known, values, 0.0), sigma_px) / share for values in (square, noise)
            )
            yield place, number, changed, expected


DISCONTINUITY_PX = 0.5
"""Adjacent pixels belong to different surfaces if their parameters displace a point by more than this, in px."""
_DOMINANT = 4.0  # ratio of mean square gradients from which one texture dominates the windows on both sides
_MIXED_PX = 2  # distance of the neighbours whose other surface may contribute to a pixel of the nearer surface

Mask = NDArray[np.bool_]


def find_discontinuities(images: ImageStack, theta: Map) -> Mask:
    """Return where the surface of an adjacent pixel is another, or invalid."""
    found, theta = np.zeros(images.shape, dtype=np.bool_), np.ascontiguousarray(theta)
    for offset in ((1, 0), (0, 1)):
        fixed = theta, images.arms(_count_fields(theta)), offset, DISCONTINUITY_PX, found
        in_threads(partial(find_jumps, *fixed), bands(len(found)))
    return found


def find_mixed_pixels(
    images: ImageStack, theta: Map, gradient: NDArray[np.floating[Any]] | None = None, *, distance: int = _MIXED_PX
) -> Mask:
    """Return pixels within a distance of a discontinuity whose surface the images extend too far.

    Image blur extends the nearer surface; and the surface with the much stronger texture, whose gradient dominates the
    windows of both sides.

    ``gradient``: Mean square texture gradient of the neighbourhood of every pixel.
    """
    found, theta = np.zeros(images.shape, dtype=np.bool_), np.ascontiguousarray(theta)
    steps = [step * sign for step in range(1, distance + 1) for sign in (1, -1)]
    texture = np.zeros((0, 0), dtype=np.float32) if gradient is None else gradient
    for offset in [*((step, 0) for step in steps), *((0, step) for step in steps)]:
        limits = DISCONTINUITY_PX, texture, _DOMINANT
        fixed = theta, images.arms(_count_fields(theta)), offset, *limits, found
        in_threads(partial(mark_extended, *fixed), bands(len(found)))
    return found
