"""Maps of fits: their parameters, the choice between two fits at every pixel, significant differences.

Discontinuities between neighbouring pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels.window_solver import ALL, FULL, FUNCTIONALS, TOLD, VALUES, Fit

__all__ = [
    "CURVATURES",
    "DISCONTINUITY_PX",
    "STEADY_PLACES",
    "accelerated",
    "between",
    "blank_fit",
    "carried",
    "chosen_fit",
    "differ",
    "every_other",
    "explained",
    "extract_fields",
    "fill_between",
    "find_discontinuities",
    "find_mixed_pixels",
    "initial_parameters",
    "with_bias",
]


STEADY_PLACES = [0, 6, 9, 12]
"""Places of d, q_X, q_Y and q_Z among the parameters."""
CURVATURES = [3, 4, 5]
"""Places of d_xx, d_xy and d_yy."""
_ACCELERATION = [15, 16, 17]

Map = NDArray[np.float64]


def initial_parameters(start: Map, *, accelerated: bool) -> Map:
    """Return parameters to start from, shape (15 or 18, y, x).

    ``start``: Disparity and velocity, shape (4, y, x).
    """
    theta = np.zeros((ALL if accelerated else FULL, *start.shape[1:]))
    theta[STEADY_PLACES] = start
    return theta


def accelerated(theta: Map) -> Map:
    """Return parameters with room for an acceleration, which is 0 if there was none, shape (18, y, x).

    ``theta``: Parameters, shape (15 or 18, y, x).
    """
    out = np.zeros((ALL, *theta.shape[1:]))
    out[: len(theta)] = theta
    return out


def extract_fields(theta: Map) -> Map:
    """Return d and q at the pixels, and their acceleration if there is one, shape (4 or 7, y, x).

    ``theta``: Parameters, shape (15 or 18, y, x).
    """
    return theta[STEADY_PLACES + (_ACCELERATION if len(theta) > FULL else [])]


def fill_between(theta: Map) -> None:
    """Give every pixel in odd rows or columns the parameters of the pixel above, or at the left, carried to it.

    ``theta``: Parameters, shape (15 or 18, y, x); read at even rows and columns, written elsewhere.
    """
    even = theta[:, ::2, ::2]
    for down, right in ((0, 1), (1, 0), (1, 1)):
        out = theta[:, down::2, right::2]
        out[:] = _moved(even[:, : out.shape[1], : out.shape[2]], right, down)


def carried(theta: Map, right: int, down: int) -> Map:
    """Return parameters at every pixel as the model of a pixel beside it has them.

    ``theta``: Parameters of the full model, shape (15 or 18, y, x).
    """
    height, width = theta.shape[1:]
    out = np.full_like(theta, np.nan)
    if abs(right) >= width or abs(down) >= height:
        return out
    rows, columns = slice(max(down, 0), height + min(down, 0)), slice(max(right, 0), width + min(right, 0))
    from_rows = slice(max(-down, 0), height + min(-down, 0))
    out[:, rows, columns] = _moved(theta[:, from_rows, max(-right, 0) : width + min(-right, 0)], right, down)
    return out


def _moved(p: Map, right: int, down: int) -> Map:
    """Return parameters as of another place in the window, so many columns and rows away."""
    moved = p.copy()
    x, y = float(right), float(down)
    moved[0] += p[1] * x + p[2] * y + p[3] * x * x + p[4] * x * y + p[5] * y * y
    moved[1] += 2.0 * p[3] * x + p[4] * y
    moved[2] += p[4] * x + 2.0 * p[5] * y
    for k in STEADY_PLACES[1:]:
        moved[k] += p[k + 1] * x + p[k + 2] * y
    return moved


# How many times as large as by noise alone the square of a change of disparity or velocity must be to count.
_SIGNIFICANT = 4.0
# Images are explained where a shift of their texture by so many px would leave as much.
_EXPLAINED_PX = 0.17
# Noise that makes them differ is at least this part of the finer fit's.
_LEAST_PART = 0.5
# And what shifts images by this many px: they are means of few samples, and splines between them are not exact. Where
# there is hardly any other noise, all fits would differ.
_LEAST_PX = 2.5e-4
# How many times as much each must change to do so: velocities count by the disparity; q_Z by x / f too, about a
# sixteenth near the edges of an image.
_PER_PX = (1.0, 1.0, 1.0, 16.0)
# Variances of the parameters that a steady motion has.
_STEADY = int(np.count_nonzero(TOLD < FULL))


def blank_fit(state: Map, *, variances: bool) -> Fit:
    """Return a fit that starts from some parameters."""
    shape = state.shape[1:] if variances else (1, 1)
    variance = np.full((np.count_nonzero(len(state) > TOLD), *shape), np.nan)
    element, of_element = (np.full((count, *shape), np.nan, dtype=np.float32) for count in (VALUES, FUNCTIONALS))
    images = np.full(shape, np.nan, dtype=np.float32)
    return Fit(state.copy(), variance, element, of_element, images, np.full((2, *state.shape[1:]), np.nan))


def chosen_fit(where: NDArray[np.bool_], fit: Fit, other: Fit) -> Fit:
    """Return one fit where it is chosen, and another elsewhere; without the acceleration, if one has none.

    ``where``: Pixels where it is, shape (y, x).
    """
    if len(fit.theta) != len(other.theta):
        fit, other = (each._replace(theta=each.theta[:FULL], variance=each.variance[:_STEADY]) for each in (fit, other))
    return Fit(*(np.where(where, getattr(fit, name), getattr(other, name)) for name in Fit._fields))


def explained(
    square: NDArray[np.floating[Any]], gradient: NDArray[np.floating[Any]], noise: float
) -> NDArray[np.bool_]:
    """Tell where what a fit leaves may be noise, or the texture's own."""
    with np.errstate(invalid="ignore"):
        return np.asarray(square <= np.maximum(noise**2, _EXPLAINED_PX**2 * gradient))


def every_other(fit: Fit) -> Fit:
    """Return a fit at every other row and column."""
    return Fit._make(each[..., ::2, ::2] for each in fit)


def between(found: NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return what was found at every other row and column for the pixels below and at the right, too."""
    return np.asarray(np.repeat(np.repeat(found, 2, axis=0), 2, axis=1)[: shape[0], : shape[1]])


def differ(
    coarse: Fit,
    fine: Fit,
    sigma_px: float,
    *,
    motion: bool = False,
    among: NDArray[np.bool_] | None = None,
    most: float = np.inf,
) -> NDArray[np.bool_]:
    """Tell where two fits differ by more than noise.

    If the coarse fit is the best one of its model, and the fine one is another of the same images with more parameters
    or a smaller window, noise alone makes them differ by the difference of their variances. Squares of the difference,
    averaged over a window, must be more than four times that.

    ``among``: Pixels that tell, shape (y, x); all do without.
    """
    found = np.zeros(coarse.theta.shape[1:], dtype=np.bool_)
    for place, _, square, noise in _changes(coarse, fine, sigma_px, among, most):
        if motion or place == 0:
            found |= square > _SIGNIFICANT * noise
    return found


def with_bias(fine: Fit, coarse: Fit, sigma_px: float, coarse_sigma_px: float) -> Fit:
    """Return a fit in windows that are too large still, with variances of disparity and velocity that hold their bias.

    Where what is fitted changes within a window by more than the model allows, the bias goes with the square of the
    window's width: what another width changes, tells of it.
    """
    share = sigma_px**2 / (coarse_sigma_px**2 - sigma_px**2)
    variance = fine.variance.copy()
    for _, number, square, noise in _changes(coarse, fine, sigma_px, None, np.inf):
        variance[number] += share**2 * np.maximum(square - noise, 0.0)
    return fine._replace(variance=variance)


def _changes(
    coarse: Fit, fine: Fit, sigma_px: float, among: NDArray[np.bool_] | None, most: float
) -> Iterator[tuple[int, int, Map, Map]]:
    """Yield place and number of the variance of disparity and velocity, their squared change, and that of noise."""
    from scipy.ndimage import gaussian_filter

    for place, number, per_px in zip(STEADY_PLACES, (0, 3, 4, 5), _PER_PX, strict=True):
        with np.errstate(invalid="ignore"):
            # A curved surface in whole windows may be less certain than a plane in small ones.
            floor = _LEAST_PX * per_px / (1.0 if place == 0 else np.maximum(np.abs(coarse.theta[0]), 1e-3))
            least = np.maximum(_LEAST_PART * fine.variance[number], floor**2)
            noise = np.maximum(fine.variance[number] - coarse.variance[number], least)
            square = np.minimum((fine.theta[place] - coarse.theta[place]) ** 2, most * noise)
            known = np.isfinite(square) & np.isfinite(noise) & (True if among is None else among)
            share = np.where(known, np.maximum(gaussian_filter(known.astype(np.float64), sigma_px), 1e-9), np.inf)
            yield (
                place,
                number,
                *(gaussian_filter(np.where(known, values, 0.0), sigma_px) / share for values in (square, noise)),
            )


DISCONTINUITY_PX = 0.5
"""Neighbours whose own parameters move a point by more than this against each other's are of different surfaces."""
# Neighbours on whose other surface a pixel in front may show in part.
_MIXED_BY = ((1, 0), (-1, 0), (0, 1), (0, -1), (2, 0), (-2, 0), (0, 2), (0, -2))

Mask = NDArray[np.bool_]


def find_discontinuities(images: ImageStack, theta: Map) -> Mask:
    """Tell where the surface of a pixel's neighbour is not its own, or unknown."""
    found = np.zeros(images.shape, dtype=np.bool_)
    for right, down in ((1, 0), (0, 1)):
        with np.errstate(invalid="ignore"):
            moved = images.moved_px(extract_fields(theta), extract_fields(carried(theta, right, down)))
        jump = ~(moved <= DISCONTINUITY_PX)
        jump[:down], jump[:, :right] = False, False
        found |= jump
    return found


def find_mixed_pixels(images: ImageStack, theta: Map) -> Mask:
    """Tell which pixels lie in front within 2 px of a jump: the outline's blur carries the nearer surface too far."""
    found = np.zeros(images.shape, dtype=np.bool_)
    for right, down in _MIXED_BY:
        beside = extract_fields(carried(theta, right, down))
        with np.errstate(invalid="ignore"):
            found |= (images.moved_px(extract_fields(theta), beside) > DISCONTINUITY_PX) & (
                np.abs(theta[0]) > np.abs(beside[0])
            )
    return found
