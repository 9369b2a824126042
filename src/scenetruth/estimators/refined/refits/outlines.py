"""Fits beside outlines: small windows, the neighbours' models, then windows without the pixels of other surfaces."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.bands import NOTHING_HIDDEN, Band, around, bands, window_weights
from scenetruth.estimators.refined.fits import blank_fit, chosen_fit, differ, explained, with_bias
from scenetruth.estimators.refined.images import Images
from scenetruth.estimators.refined.kernels.members import solve_members
from scenetruth.estimators.refined.kernels.solving import Fit, Model
from scenetruth.estimators.refined.kernels.visibility import hide
from scenetruth.estimators.refined.noise import noise_of, textured
from scenetruth.estimators.refined.parameters import fields_of, started
from scenetruth.estimators.refined.refits.jumps import JUMP_PX, jumps, mixed
from scenetruth.estimators.refined.refits.richer import Trial, choose_motion, motions_of, richer_motions
from scenetruth.estimators.refined.refits.selection import Selection
from scenetruth.estimators.refined.rounds import (
    STAGES,
    Refined,
    fit_round,
    kept,
    models_of,
    sound_step,
)
from scenetruth.estimators.refined.seen import Seen, local_gradient
from scenetruth.estimators.refined.settings import RefinedSettings
from scenetruth.estimators.refined.start import filled
from scenetruth.schema.variables import MOTION_PLAIN
from scenetruth.threads import in_threads

__all__ = ["FARTHEST", "Beside", "nothing_beside", "refit_beside_outlines"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

# A surface explains pixels if it leaves this many times the noise at most, or what a shift by so many px would leave.
_NOISES, _SHIFT_PX = 1.3, 0.2
# Standard deviations of the windows that come first and of those in the end, over that of the whole windows.
_SMALL, _FINAL = 0.4, 2 / 3
_LEAST_SIGMA_PX = 1.5
# Points whose disparities differ by less than this at the farthest camera do not hide each other.
_SAME_PX = 0.75
_ROUNDS = 2
# Motion may be as rich as it is in whole windows so many half windows away.
_BESIDE = 2
_PIXELS = 2000
# Of the images so many must show a pixel, of a window so much must be known, and of its texture's middle not be farther
# from the window's than so many standard deviations: at a straight outline it is 0.8.
_LEAST_IMAGES, _LEAST_SHARE, FARTHEST = 0.25, 0.35, 0.9


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
    where = around(_unexplained(refined.seen, noise) | jumps(images, whole), reach) | refined.uneven
    if not where.any() or not np.isfinite(noise):
        return refined, Beside(where, np.zeros_like(where))
    steady = ~where if settings.brightness == "per_image" else None
    selection = Selection(images.few(), whole, where, noise, steady)
    selection.offer(_small_windows(images, start, where, settings))
    for distance in sorted({round(1.6 * sigma), round(sigma), round(sigma / 2), 2, 1} - {0}, reverse=True):
        selection.spread(distance)
    theta = kept(filled(whole, np.asarray(np.isfinite(whole).all(axis=0))), selection.theta)
    found = _refit(images, theta, where, noise, settings)
    found, motion = _refit_richer(images, found, where, refined.motion, noise, settings)
    fit, seen, shares = found.fit, found.seen, found.shares
    # Whole windows suffice where they find the same: their noise is the least.
    fitted = explained(refined.fit.residual[0], refined.fit.residual[1], settings.acceptance * noise)
    where = where & (refined.uneven | ~fitted | differ(refined.fit, fit, sigma / 2, motion=True))
    final = chosen_fit(where, fit, refined.fit)
    own = textured(seen.gradient.astype(np.float64), noise, images.count, images.spline)
    sound = (
        where
        & explained(seen.square, seen.gradient, settings.acceptance * noise)
        & (shares[0] > _LEAST_SHARE)
        & (own | (shares[1] < FARTHEST * _final_sigma(sigma)))
    )
    sound &= ~mixed(images, np.where(where, final.theta, whole))
    motion = np.where(where, motion, refined.motion)
    result = replace(refined, fit=final, curved=refined.curved & ~where, motion=motion)
    return result, Beside(where, sound)


def _unexplained(seen: Seen, noise: float) -> Mask:
    return np.asarray(seen.square > _limit_of(seen.gradient, noise))


def _limit_of(gradient: NDArray[Any], noise: float) -> Map:
    """Return the largest mean square that is left where a pixel is explained."""
    return np.maximum((_NOISES * noise) ** 2, _SHIFT_PX**2 * gradient.astype(np.float64))


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
    state = started(start, accelerated=settings.accelerated)
    steady = model._replace(accelerated=False)
    stages = [(images.within(reach), steady) for reach in STAGES if reach < images.longest]
    fit = None
    for part, each in [*stages, (images, model), (images, model)]:
        (fit,) = fit_round(part, np.where(where, state, np.nan), [each], sigma, gains=gains)
        state = kept(state, fit.theta)
    assert fit is not None
    return fit.theta


@dataclass(frozen=True, eq=False)
class _Refit:
    """Fits to the pixels of the surface in the middle of windows."""

    fit: Fit
    seen: Seen
    """What every pixel shows by itself."""
    shares: Map
    """How much of every window is known, and how far its texture's middle is from its own, shape (2, y, x)."""


def _refit_richer(
    images: Images, found: _Refit, where: Mask, beside: NDArray[np.int8], noise: float, settings: RefinedSettings
) -> tuple[_Refit, NDArray[np.int8]]:
    """Fit the motions of whole windows beside where they differ from the plain one; return the chosen ones, too."""
    known = np.asarray(np.isfinite(found.fit.theta).all(axis=0))
    reach = _BESIDE * (window_weights(settings.window_sigma_px).shape[2] // 2)
    near = {
        motion: where & known & around(beside == motion.number, reach) for motion in richer_motions(images, settings)
    }
    richer = [motion for motion, tried in near.items() if tried.any()]
    if not richer:
        return found, np.full(images.shape, MOTION_PLAIN, dtype=np.int8)
    seen, shares = found.seen, found.shares

    def trials() -> Iterator[Trial]:
        theta = filled(found.fit.theta, known)
        for motion in richer:
            theta = motion.begun(theta)
            made = _refit(motion.images, theta, near[motion], noise, motion.settings)
            theta = np.where(near[motion] & sound_step(theta, made.fit.theta), made.fit.theta, theta)

            def take(other: Mask, made: _Refit = made) -> None:
                nonlocal seen, shares
                seen, shares = seen.chosen(other, made.seen), np.where(other, made.shares, shares)

            yield Trial(made.fit, motion.images is images, take)

    sigma = _final_sigma(settings.window_sigma_px)
    tried = [near[motion] for motion in richer]
    fit, which = choose_motion(found.fit, trials(), tried, sigma, settings.acceptance * noise)
    return _Refit(fit, seen, shares), motions_of(which, richer)


def _refit(images: Images, theta: Map, where: Mask, noise: float, settings: RefinedSettings) -> _Refit:
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
        wanted = np.where(around(where, reach), fields, np.nan)
        for band in bands(images, wanted, sigma, gains=gains, least_share=_LEAST_IMAGES, hidden=hidden):
            seen.put(band)
            inner = np.zeros(images.shape, dtype=np.bool_)
            inner[band.top : band.bottom] = where[band.top : band.bottom]
            shares[:, inner] = _solve(images, band, fields, noise, sigma, model, fit, inner)
            if last:
                _solve(images, band, fields, noise, finer, model, fine, inner)
        theta = np.where(where & sound_step(theta, fit.theta), fit.theta, theta)
    uneven = differ(fit, fine, finer, motion=True)
    return _Refit(chosen_fit(uneven, with_bias(fine, fit, finer, sigma), fit), seen, shares)


def _solve(
    images: Images, band: Band, fields: Map, noise: float, sigma: float, model: Model, fit: Fit, where: Mask
) -> Map:
    """Fit the windows around the pixels of a band, and return what `solve_members` tells of them."""
    pixels = np.argwhere(where)
    found = np.empty((len(pixels), 2))
    limit = _limit_of(local_gradient(band.products), noise)
    products = np.ascontiguousarray(band.products.transpose(1, 2, 0))
    reach = np.array([images.farthest, images.longest, images.aside, JUMP_PX])
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
