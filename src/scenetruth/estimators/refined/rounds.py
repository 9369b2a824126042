"""Rounds of warping all images and fitting all windows, until nothing moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.bad.images import strangers
from scenetruth.estimators.refined.bands import bands, pieces, window_weights
from scenetruth.estimators.refined.cameras.corrections import Cameras
from scenetruth.estimators.refined.cameras.shifts import Shifts
from scenetruth.estimators.refined.fits import blank_fit, differ
from scenetruth.estimators.refined.images import Images
from scenetruth.estimators.refined.kernels.solving import EVERY_VARIANCE, Fit, Model
from scenetruth.estimators.refined.kernels.windows import EVERY_MODEL, NO_MODEL, solve_rows
from scenetruth.estimators.refined.noise import noise_of, spline_transfer, textured
from scenetruth.estimators.refined.parameters import STEADY_PLACES, fields_of, fill_between, started
from scenetruth.estimators.refined.seen import Seen, local_means
from scenetruth.estimators.refined.settings import LEAST_ACCELERATED, RefinedSettings
from scenetruth.estimators.refined.start import filled
from scenetruth.estimators.refined.variance import GreyVariance, variance_of
from scenetruth.schema.variables import MOTION_PLAIN
from scenetruth.threads import in_threads

__all__ = [
    "STAGES",
    "Refined",
    "fit_final",
    "fit_round",
    "kept",
    "models_of",
    "refine",
    "sound_step",
]

# Windows of which less is known have no estimate.
_LEAST_SHARE = 0.5
# Frames before and after that take part in the first rounds.
STAGES = (1, 2)
# Share of the pixels that must stand still at the end: at outlines, some never do.
_STILL_SHARE = 0.9
# Smaller windows that tell whether whole ones suffice, over these.
_FINER = 0.5
# Windows whose residual is beyond this many times the noise are not asked whether they stand still.
_FITTED = 1.5
# Rounds with all pixels.
_WHOLE_ROUNDS = 2

Map = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Refined:
    """What the rounds end with."""

    fit: Fit
    """The fit around every pixel; NaN where there is none."""
    curved: NDArray[np.bool_]
    """Where the surface is of second order, shape (y, x)."""
    rounds: int
    """How many rounds it took."""
    seen: Seen
    """What every pixel shows by itself."""
    uneven: NDArray[np.bool_]
    """Where smaller windows find another disparity or velocity: the surface is not what the model takes it for."""
    motion: NDArray[np.int8]
    """Which motion was fitted, as of ``motion_model``."""
    images: Images
    """The images, where they turned out to be."""
    cameras: Cameras | None
    """How far they are from where they should be, if that was asked for."""


def refine(images: Images, start: Map, settings: RefinedSettings, told: Callable[[int], None] | None = None) -> Refined:
    """Fit surface and motion around every pixel.

    The first rounds take the nearest frames only, and a motion without gradient, so that the start need not be good.

    Parameters
    ----------
    images
        The images.
    start
        Disparity and velocity to start from, shape (4, y, x), finite.
    settings
        Window, model and rounds.
    told
        Called with the number of rounds that are done.
    """
    models, sigma, gains = models_of(images, settings), settings.window_sigma_px, settings.brightness == "per_image"
    plain = models[0]._replace(gradient=0) if models[0].surface > 0 else models[0]
    steady = plain._replace(accelerated=False)
    cameras = None if settings.corrections is None else Cameras(settings.corrections, images)
    span = float(np.abs(images.times).max())
    stages = [(reach, steady) for reach in STAGES if reach < span]
    state = started(start, accelerated=settings.accelerated)
    done, left = 0, settings.rounds - _WHOLE_ROUNDS
    left_out: frozenset[tuple[int, int]] = frozenset()
    settled = cameras is None
    for reach, model in [*stages, (span, plain), *[(span, models[0])] * left]:
        if done >= left:
            break
        part = images.within(reach)
        if done <= len(stages):
            left_out = strangers(images, fields_of(state), sigma, part)
        part = part.without(left_out)
        shifts = None if cameras is None or settled else Shifts.blank(images.shape, len(part.view().s))
        told_by = Seen.blank(images.shape) if settings.noise == "estimated" and model is models[0] else None
        (fit,) = fit_round(part, state, [model], sigma, gains=gains, shifts=shifts, seen=told_by, coarse=True)
        if told_by is not None:
            images = replace(images, variance=_estimated_variance(images, told_by))
        before, state = state, kept(state, fit.theta)
        if cameras is not None and shifts is not None:
            moved = cameras.update(shifts, before[STEADY_PLACES], part)
            images = replace(images, moved=cameras.values)
            # What images cannot tell would move on for ever, by little, and all surfaces with it.
            settled = reach == span and moved < settings.tolerance_px
        done += 1
        if told is not None:
            told(done)
        if model is models[0] and settled and _still(before, state, fit, images, settings.tolerance_px):
            break
    images = images.without(strangers(images, fields_of(state), sigma, images))
    # All pixels move from what every other row has found, and where the order changes: another round follows.
    theta, curved, chosen = fit_surface(images, state, models, settings)
    state = kept(state, theta)
    done += 1
    if told is not None:
        told(done)
    last = fit_final(images, state, models, settings, chosen)
    if told is not None:
        told(done + 1)
    motion = np.full(images.shape, MOTION_PLAIN, dtype=np.int8)
    return Refined(last.fit, curved, done + 1, last.seen, last.uneven, motion, images, cameras)


def fit_surface(
    images: Images, state: Map, models: list[Model], settings: RefinedSettings, where: NDArray[np.bool_] | None = None
) -> tuple[Map, NDArray[np.bool_], NDArray[np.int8]]:
    """Fit the models, and choose one for every pixel.

    Parameters
    ----------
    images, state, models
        As of `fit_round`.
    settings
        Window and brightness.
    where
        Pixels to be fitted, shape (y, x); without, all are.

    Returns
    -------
    theta
        Parameters of the chosen model.
    curved
        Where it has a surface of second order, shape (y, x).
    chosen
        Which one it is; where none is fitted, `NO_MODEL`.
    """
    sigma, gains = settings.window_sigma_px, settings.brightness == "per_image"
    wanted = np.ones(images.shape, dtype=np.bool_) if where is None else where
    every = np.where(wanted, EVERY_MODEL, NO_MODEL).astype(np.int8)
    fits = fit_round(images, state, models, sigma, gains=gains, variances=len(models) - 1, chosen=every)
    if len(models) == 1:
        curved, theta = np.full(images.shape, models[0].surface == _CURVED), fits[0].theta
        return theta, curved, np.where(wanted, 0, NO_MODEL).astype(np.int8)
    plane, bent = fits
    curved = differ(plane, bent, sigma)
    return np.where(curved, bent.theta, plane.theta), curved, np.where(wanted, curved, NO_MODEL).astype(np.int8)


@dataclass(frozen=True, eq=False)
class Final:
    """What the last round ends with."""

    fit: Fit
    """The fit around every pixel, with all variances."""
    seen: Seen
    """What every pixel shows by itself."""
    uneven: NDArray[np.bool_]
    """As of `Refined`."""


def fit_final(
    images: Images, state: Map, models: list[Model], settings: RefinedSettings, chosen: NDArray[np.int8]
) -> Final:
    """Warp all images and fit the chosen models, with all that is told of them.

    Parameters
    ----------
    images, state, models, chosen
        As of `fit_round`.
    settings
        Window and brightness.
    """
    seen, finer = Seen.blank(images.shape), blank_fit(state, variances=True)
    small = _FINER * settings.window_sigma_px
    gains = settings.brightness == "per_image"
    final = partial(fit_round, images, state, models, settings.window_sigma_px, gains=gains, chosen=chosen)
    fit, *_ = final(variances=EVERY_VARIANCE, finer=(small, finer), seen=seen)
    return Final(fit, seen, differ(fit, finer, small, motion=True))


_CONSTANT, _PLANE, _CURVED = 1, 3, 6
_SURFACES = {"constant": [_CONSTANT], "plane": [_PLANE], "curved": [_CURVED], "auto": [_PLANE, _CURVED]}
_GRADIENTS = {"auto": 2, "translation": 0, "rigid": 1, "growing": 2, "affine": 3}


def models_of(images: Images, settings: RefinedSettings) -> list[Model]:
    """Return the models to choose from, the simplest first, as far as cameras and frames can tell."""
    moves = len(images.times) > 1
    accelerated = settings.accelerated and len(images.times) >= LEAST_ACCELERATED
    if len(images.positions) == 1:
        return [Model(0, 2, 3 if settings.motion != "translation" else 0, accelerated)]
    gradient = _GRADIENTS[settings.motion] if moves else 0
    # Without slopes, a surface has no tangents that could turn.
    if settings.surface == "constant" and 0 < gradient < _GRADIENTS["affine"]:
        gradient = 0
    return [Model(surface, 3 if moves else 0, gradient, accelerated) for surface in _SURFACES[settings.surface]]


def fit_round(
    images: Images,
    state: Map,
    models: list[Model],
    sigma_px: float,
    *,
    gains: bool,
    variances: int = 0,
    chosen: NDArray[np.int8] | None = None,
    finer: tuple[float, Fit] | None = None,
    seen: Seen | None = None,
    shifts: Shifts | None = None,
    coarse: bool = False,
) -> list[Fit]:
    """Warp all images by what is known of every pixel, and fit each model anew, or the one that is chosen.

    Parameters
    ----------
    images
        The images.
    state
        Parameters of all pixels, shape (15 or 18, y, x); pixels where they are NaN are left out.
    models
        The models, two at most.
    sigma_px
        Standard deviation of the windows.
    gains
        Whether every image has a gain and an offset of its own.
    variances
        How many variances are wanted, as of `solve_rows`.
    chosen
        Which model fits every pixel, or `EVERY_MODEL`, or `NO_MODEL`; without, every model all.
    finer
        Windows of another standard deviation, and what the chosen models find in them, with the variance of
        disparity: is written, if given.
    seen
        Is written, if given.
    shifts
        Is added to, if given.
    coarse
        Whether every other row is left out, and windows are fitted around every other pixel of the others only; between
        them, parameters are those of the pixel above or at the left.
    """
    view, windows = images.view(), window_weights(sigma_px)
    chosen = np.full(images.shape, EVERY_MODEL, dtype=np.int8) if chosen is None else chosen.copy()
    if (chosen == EVERY_MODEL).any():
        fits = [blank_fit(state, variances=variances > 0) for _ in models]
    else:
        fits = [blank_fit(state, variances=variances > 0)] * len(models)
    fields, least_share = fields_of(state), _LEAST_SHARE
    if coarse:
        fields[:, 1::2] = np.nan
        least_share /= 2
        chosen[1::2], chosen[:, 1::2] = NO_MODEL, NO_MODEL
    for band in bands(images, fields, sigma_px, gains=gains, shifts=shifts):
        # Always two, so that the kernel is compiled once.
        pair = (
            (models[0], models[-1]),
            len(models),
            view,
            images.channels,
            band.first,
            least_share,
            (fits[0], fits[-1]),
        )
        solve = partial(solve_rows, band.products, windows, *pair, chosen, variances)
        in_threads(solve, pieces(band.top - band.first, band.bottom - band.first))
        if finer is not None:
            pair = (
                (models[0], models[-1]),
                len(models),
                view,
                images.channels,
                band.first,
                least_share,
                (finer[1],) * 2,
            )
            solve = partial(solve_rows, band.products, window_weights(finer[0]), *pair, chosen, 6)
            in_threads(solve, pieces(band.top - band.first, band.bottom - band.first))
        if seen is not None:
            seen.put(band)
    if coarse:
        for fit in fits:
            fill_between(fit.theta)
    return fits


def sound_step(state: Map, theta: Map) -> NDArray[np.bool_]:
    """Tell where new parameters are known, and disparity neither changes its sign nor by half.

    Parameters
    ----------
    state, theta
        Parameters before and after, shape (15 or 18, y, x).
    """
    with np.errstate(invalid="ignore"):
        sound = np.isfinite(theta).all(axis=0) & (theta[0] * state[0] > 0)
        return np.asarray(sound & (np.abs(theta[0] - state[0]) < 0.5 * np.abs(state[0])))


def kept(state: Map, theta: Map) -> Map:
    """Return parameters that are known everywhere: a fit's where its step is sound, else those of the nearest pixel.

    Parameters
    ----------
    state, theta
        Parameters before and after, shape (15 or 18, y, x).
    """
    sound = sound_step(state, theta)
    return filled(theta, sound) if sound.any() else state


def _estimated_variance(images: Images, seen: Seen) -> GreyVariance:
    """Return how noise depends on the grey value, as what pixels show by themselves tells."""
    grey = local_means(
        np.mean([images.grey(*images.reference(), channel) for channel in range(images.channels)], axis=0)
    )
    return variance_of(grey, seen.square * images.variance.at(grey))


def _still(before: Map, after: Map, fit: Fit, images: Images, tolerance_px: float) -> bool:
    """Tell whether almost no pixel that is fitted well moved by more than a tolerance in any image."""
    moved = images.moved_px(fields_of(before), fields_of(after))
    left = np.sqrt(fit.residual[0]) / spline_transfer(images.spline)
    with np.errstate(invalid="ignore"):
        fitted = textured(fit.residual[1], noise_of(left), images.count, images.spline) & (
            left < _FITTED * noise_of(left)
        )
    return not fitted.any() or bool(np.mean(moved[fitted] < tolerance_px) >= _STILL_SHARE)
