"""Fits beside outlines: small windows, the neighbours' models, then windows without the pixels of other surfaces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.bands import NOTHING_HIDDEN, Band, bands, window_weights
from scenetruth.estimators.refined.images import Images
from scenetruth.estimators.refined.kernels.members import solve_members
from scenetruth.estimators.refined.kernels.solving import Fit, Model
from scenetruth.estimators.refined.kernels.visibility import hide
from scenetruth.estimators.refined.noise import noise_of, textured
from scenetruth.estimators.refined.parameters import carried, fields_of, started
from scenetruth.estimators.refined.rounds import (
    STAGES,
    Refined,
    blank_fit,
    differ,
    fit_round,
    kept,
    models_of,
    sound_step,
)
from scenetruth.estimators.refined.seen import Seen, local_gradient
from scenetruth.estimators.refined.selection import Selection
from scenetruth.estimators.refined.settings import RefinedSettings
from scenetruth.estimators.refined.start import filled
from scenetruth.estimators.threads import in_threads

__all__ = ["FARTHEST", "Beside", "nothing_beside", "refit_beside_outlines"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

# A surface explains pixels if it leaves this many times the noise at most, or what a shift by so many px would leave.
_NOISES, _SHIFT_PX = 1.3, 0.2
# Standard deviations of the windows that come first and of those in the end, over that of the whole windows.
_SMALL, _FINAL = 0.4, 2 / 3
_LEAST_SIGMA_PX = 1.5
# Neighbours whose own parameters move a point by more than this against each other's are of different surfaces.
_JUMP_PX = 0.5
# Points whose disparities differ by less than this at the farthest camera do not hide each other.
_SAME_PX = 0.75
_ROUNDS = 2
_PIXELS = 2000
# Of the images so many must show a pixel, of a window so much must be known, and of its texture's middle not be farther
# from the window's than so many standard deviations: at a straight outline it is 0.8.
_LEAST_IMAGES, _LEAST_SHARE, FARTHEST = 0.25, 0.35, 0.9
# Neighbours on whose other surface a pixel in front may show in part.
_MIXED_BY = ((1, 0), (-1, 0), (0, 1), (0, -1), (2, 0), (-2, 0), (0, 2), (0, -2))
# Beside outlines, estimates are given where a shift by so many px would leave as much.
_EXPLAINED_PX = 0.17


@dataclass(frozen=True, eq=False)
class Beside:
    """What is known beside outlines."""

    where: Mask
    """Pixels whose windows hold an outline, or what one motion does not explain, shape (y, x)."""
    sound: Mask
    """Those of them whose own surface is told."""


def nothing_beside(shape: tuple[int, int]) -> Beside:
    """Return that no pixel is beside an outline.

    Parameters
    ----------
    shape
        Rows and columns.
    """
    return Beside(np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_))


def refit_beside_outlines(
    images: Images,
    start: Map,
    refined: Refined,
    settings: RefinedSettings,
    told: Callable[[int], None] | None = None,
) -> tuple[Refined, Beside]:
    """Fit pixels anew whose windows hold more than one surface.

    Parameters
    ----------
    images
        The images.
    start
        Disparity and velocity that whole windows started from, shape (4, y, x), finite.
    refined
        What whole windows found.
    settings
        Windows, model and brightness.
    told
        Called with the number of steps that are done.
    """
    noise = noise_of(np.sqrt(refined.fit.residual[0]))
    sigma = settings.window_sigma_px
    whole = refined.fit.theta
    reach = window_weights(sigma).shape[2] // 2
    where = _around(_unexplained(refined.seen, noise) | _jumps(images, whole), reach) | refined.uneven
    if not where.any() or not np.isfinite(noise):
        return refined, Beside(where, np.zeros_like(where))
    steady = ~where if settings.brightness == "per_image" else None
    selection = Selection(images.few(), whole, where, noise, steady)
    selection.offer(_small_windows(images, start, where, settings))
    for distance in sorted({round(1.6 * sigma), round(sigma), round(sigma / 2), 2, 1} - {0}, reverse=True):
        selection.spread(distance)
    theta = kept(filled(whole, np.asarray(np.isfinite(whole).all(axis=0))), selection.theta)
    fit, seen, shares = _refit(images, theta, where, noise, settings)
    # Whole windows suffice where they find the same: their noise is the least.
    square, gradient = refined.fit.residual
    fitted = square < np.maximum((settings.acceptance * noise) ** 2, _EXPLAINED_PX**2 * gradient)
    where &= refined.uneven | ~fitted | differ(refined.fit, fit, sigma / 2, motion=True)
    final = _chosen(where, fit, refined.fit)
    explained = seen.square <= np.maximum((settings.acceptance * noise) ** 2, _EXPLAINED_PX**2 * seen.gradient)
    own = textured(seen.gradient.astype(np.float64), noise, images.count, images.spline)
    sound = where & explained & (shares[0] > _LEAST_SHARE) & (own | (shares[1] < FARTHEST * _final_sigma(sigma)))
    sound &= ~_mixed(images, np.where(where, final.theta, whole))
    result = replace(refined, fit=final, curved=refined.curved & ~where)
    return result, Beside(where, sound)


def _chosen(where: Mask, fit: Fit, other: Fit) -> Fit:
    """Return one fit where it is chosen, and another elsewhere."""
    return Fit(*(np.where(where, getattr(fit, name), getattr(other, name)) for name in Fit._fields))


def _unexplained(seen: Seen, noise: float) -> Mask:
    return np.asarray(seen.square > _limit_of(seen.gradient, noise))


def _limit_of(gradient: NDArray[Any], noise: float) -> Map:
    """Return the largest mean square that is left where a pixel is explained."""
    return np.maximum((_NOISES * noise) ** 2, _SHIFT_PX**2 * gradient.astype(np.float64))


def _around(where: Mask, reach: int) -> Mask:
    from scipy.ndimage import maximum_filter

    return np.asarray(maximum_filter(where, 2 * reach + 1))


def _jumps(images: Images, theta: Map) -> Mask:
    """Tell where the surface of a pixel's neighbour is not its own, or unknown."""
    found = np.zeros(images.shape, dtype=np.bool_)
    for right, down in ((1, 0), (0, 1)):
        with np.errstate(invalid="ignore"):
            moved = images.moved_px(fields_of(theta), fields_of(carried(theta, right, down)))
        jump = ~(moved <= _JUMP_PX)
        jump[:down], jump[:, :right] = False, False
        found |= jump
    return found


def _mixed(images: Images, theta: Map) -> Mask:
    """Tell which pixels lie in front within 2 px of a jump: the outline's blur carries the nearer surface too far."""
    found = np.zeros(images.shape, dtype=np.bool_)
    for right, down in _MIXED_BY:
        beside = fields_of(carried(theta, right, down))
        with np.errstate(invalid="ignore"):
            found |= (images.moved_px(fields_of(theta), beside) > _JUMP_PX) & (np.abs(theta[0]) > np.abs(beside[0]))
    return found


def _final_sigma(sigma: float) -> float:
    return max(_LEAST_SIGMA_PX, _FINAL * sigma)


def _plain(images: Images, settings: RefinedSettings) -> Model:
    """Return the model of small windows: no curvature."""
    return models_of(images, settings)[0]


def _small_windows(images: Images, start: Map, where: Mask, settings: RefinedSettings) -> Map:
    """Fit small windows with one velocity each, frames in stages."""
    model = _plain(images, settings)
    model = model._replace(gradient=0) if model.surface > 0 else model
    sigma, gains = max(_LEAST_SIGMA_PX, _SMALL * settings.window_sigma_px), settings.brightness == "per_image"
    state = started(start, accelerated=settings.acceleration)
    steady = model._replace(accelerated=False)
    stages = [(images.within(reach), steady) for reach in STAGES if reach < images.longest]
    fit = None
    for part, each in [*stages, (images, model), (images, model)]:
        (fit,) = fit_round(part, np.where(where, state, np.nan), [each], sigma, gains=gains)
        state = kept(state, fit.theta)
    assert fit is not None
    return fit.theta


def _refit(images: Images, theta: Map, where: Mask, noise: float, settings: RefinedSettings) -> tuple[Fit, Seen, Map]:
    """Fit windows to pixels of the surface in their middle; return what pixels show, too, and shares and middles."""
    sigma, finer = (max(_LEAST_SIGMA_PX, share * settings.window_sigma_px) for share in (_FINAL, _SMALL))
    gains = settings.brightness == "per_image"
    shares = np.full((2, *images.shape), np.nan)
    seen, model = Seen.blank(images.shape), _plain(images, settings)
    reach = 3 * (window_weights(sigma).shape[2] // 2)
    fit = fine = blank_fit(theta, variances=True)
    for number in range(_ROUNDS):
        fields = np.ascontiguousarray(fields_of(theta))
        hidden = _hidden(images, fields)
        last = number == _ROUNDS - 1
        fit, fine = (blank_fit(theta, variances=last) for _ in range(2))
        wanted = np.where(_around(where, reach), fields, np.nan)
        for band in bands(images, wanted, sigma, gains=gains, least_share=_LEAST_IMAGES, hidden=hidden):
            seen.put(band)
            inner = np.zeros(images.shape, dtype=np.bool_)
            inner[band.top : band.bottom] = where[band.top : band.bottom]
            shares[:, inner] = _solve(images, band, fields, noise, sigma, model, fit, inner)
            if last:
                _solve(images, band, fields, noise, finer, model, fine, inner)
        theta = np.where(where & sound_step(theta, fit.theta), fit.theta, theta)
    uneven = differ(fit, fine, finer, motion=True)
    return _chosen(uneven, fine, fit), seen, shares


def _solve(
    images: Images, band: Band, fields: Map, noise: float, sigma: float, model: Model, fit: Fit, where: Mask
) -> Map:
    """Fit the windows around the pixels of a band, and return what `solve_members` tells of them."""
    pixels = np.argwhere(where)
    found = np.empty((len(pixels), 2))
    limit = _limit_of(local_gradient(band.products), noise)
    products = np.ascontiguousarray(band.products.transpose(1, 2, 0))
    reach = np.array([images.farthest, images.longest, images.aside, _JUMP_PX])
    fixed = products, limit, fields, reach, window_weights(sigma), model, images.view(), band.first, fit
    solve = partial(solve_members, *fixed, pixels, found)
    in_threads(solve, [(n, min(n + _PIXELS, len(pixels))) for n in range(0, len(pixels), _PIXELS)])
    return found.T


def _hidden(images: Images, fields: Map) -> NDArray[np.uint8]:
    """Tell in which images which pixels are hidden: with more than one camera."""
    if images.farthest == 0.0:
        return NOTHING_HIDDEN
    view = images.view()
    hidden = np.empty((-(-len(view.s) // 8), *images.shape), dtype=np.uint8)
    in_threads(partial(hide, view, fields, _SAME_PX / images.farthest, hidden), range(len(hidden)))
    return hidden
