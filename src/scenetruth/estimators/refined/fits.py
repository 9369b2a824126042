"""Fits of all pixels: blank ones, one of two at every pixel, and whether two differ by more than noise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.element import FUNCTIONALS, VALUES
from scenetruth.estimators.refined.kernels.solving import FULL, TOLD, Fit
from scenetruth.estimators.refined.parameters import STEADY_PLACES

__all__ = ["between", "blank_fit", "chosen_fit", "differ", "every_other", "explained", "with_bias"]

Map = NDArray[np.float64]

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

    Parameters
    ----------
    where
        Pixels where it is, shape (y, x).
    fit, other
        The fits.
    """
    if len(fit.theta) != len(other.theta):
        fit, other = (each._replace(theta=each.theta[:FULL], variance=each.variance[:_STEADY]) for each in (fit, other))
    return Fit(*(np.where(where, getattr(fit, name), getattr(other, name)) for name in Fit._fields))


def explained(
    square: NDArray[np.floating[Any]], gradient: NDArray[np.floating[Any]], noise: float
) -> NDArray[np.bool_]:
    """Tell where what a fit leaves may be noise, or the texture's own.

    Parameters
    ----------
    square, gradient
        Mean squares of what is left, and of the texture's gradient.
    noise
        Standard deviation of what may be left by noise.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(square <= np.maximum(noise**2, _EXPLAINED_PX**2 * gradient))


def every_other(fit: Fit) -> Fit:
    """Return a fit at every other row and column.

    Parameters
    ----------
    fit
        The fit, with variances.
    """
    return Fit._make(each[..., ::2, ::2] for each in fit)


def between(found: NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return what was found at every other row and column for the pixels below and at the right, too.

    Parameters
    ----------
    found
        As of `every_other`.
    shape
        Rows and columns of all pixels.
    """
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

    Parameters
    ----------
    coarse, fine
        The fits, with variances.
    sigma_px
        Standard deviation of the windows that are averaged over.
    motion
        Whether velocities are compared, not only disparities.
    among
        Pixels that tell, shape (y, x); all do without.
    most
        A pixel counts by this many times its noise at most.
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

    Parameters
    ----------
    fine, coarse
        The same model in smaller and larger windows, with variances.
    sigma_px, coarse_sigma_px
        Standard deviations of the windows.
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
