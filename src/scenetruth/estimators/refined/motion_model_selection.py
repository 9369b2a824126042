"""Selection of the motion model: further motion parameters where the images require them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.method_settings import LEAST_ACCELERATED, RefinedSettings
from scenetruth.estimators.refined.fit_maps import (
    CURVATURES,
    accelerated,
    chosen_fit,
    differ,
    explained,
    extract_fields,
    find_discontinuities,
)
from scenetruth.estimators.refined.growth_comparison import compare_growth
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.initialisation import fill_gaps
from scenetruth.estimators.refined.iterations import (
    STAGES,
    FinalIteration,
    RefinedState,
    fit_final,
    fit_round,
    fit_surface,
    is_valid_step,
    select_models,
)
from scenetruth.estimators.refined.kernels.neighbours import find_jumps
from scenetruth.estimators.refined.kernels.smoothing import gaussian_mean
from scenetruth.estimators.refined.kernels.window_solver import EVERY_VARIANCE, Fit
from scenetruth.estimators.refined.kernels.window_sums import NO_MODEL
from scenetruth.estimators.refined.lattice import sample_step
from scenetruth.estimators.refined.model_tests import (
    Alternative,
    Linearisation,
    at_nodes,
    enlarged,
    find_far,
    large_areas,
)
from scenetruth.estimators.refined.row_bands import around, mark_mostly, window_weights
from scenetruth.estimators.refined.systematic_error import list_alternatives
from scenetruth.estimators.refined.velocity_curvature import smooth_velocity
from scenetruth.schema.variables import MOTION_ACCELERATED, MOTION_ACCELERATED_IN_PART, MOTION_AFFINE, MOTION_PLAIN
from scenetruth.threads import bands, in_threads

__all__ = [
    "MotionModelCandidate",
    "MotionModelTrial",
    "choose_motion_model",
    "encode_motion_models",
    "find_remainders",
    "list_motion_models",
    "refit_motion_models",
]

# Changes are averaged over this multiple of the window's standard deviation, because regions of another motion are
# larger than a window; this avoids selection by chance.
_WIDER = 2.0
_MOST = 9.0  # largest squared change of a pixel, in multiples of its noise, so that single pixels do not decide
_OTHER_NOISE = 1.02  # ratio by which the residual of a subset of the images may exceed that of all images by chance
_MUCH_LESS = 0.5  # ratio of mean square residuals, after to before
_SETTLED_PX = 0.1  # largest displacement of points in the last iteration, over all images
# Largest number of iterations of a plane before others are tried; fraction of the pixels that may not converge, and
# side of the surroundings in which they are counted, in units of the window's σ.
_ROUNDS, _MOST_FAR, _AROUND = 4, 0.02, 8
_FINAL_ROUNDS = 3  # largest number of last iterations
_NEARLY_ALL = 0.75  # fraction of the surroundings: a straight border between two motions has half, its corner 0.75
_ACCELERATIONS = 2  # number of frame spans tested for an acceleration
_RAMP_PX = 1.0  # displacement by which a surface fails to continue over half a window, twice that of a discontinuity
_AFFINE = 3  # velocity gradient of a `Model` with all six components
_MARGIN = 2.5  # distance of warped pixels from the windows' centres in half-widths: gains have windows of their own
_VARIANCES = 6  # disparity, slopes, q_X, q_Y and q_Z

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class MotionModelCandidate:
    """A motion model with more parameters than the plain one."""

    images: ImageStack
    """Images of the fit, possibly of fewer frames, because the acceleration may vary."""
    settings: RefinedSettings
    number: int
    """Value of the model in ``motion_model``."""

    def begun(self, theta: Map) -> Map:
        """Return initial parameters, shape (15 or 18, y, x)."""
        return accelerated(theta) if self.settings.accelerated else theta


def list_motion_models(images: ImageStack, settings: RefinedSettings) -> list[MotionModelCandidate]:
    """Return the motion models to try in addition to the plain one, the simplest first."""
    found: list[MotionModelCandidate] = []
    if len(images.times) == 1:
        return found
    if settings.motion == "auto":
        settings = settings.model_copy(update={"motion": "affine"})
        if len(images.positions) > 1 and settings.surface != "constant":
            found.append(MotionModelCandidate(images, settings, MOTION_AFFINE))
    if settings.acceleration == "auto":
        settings = settings.model_copy(update={"acceleration": True})
        parts = [images, *(images.within(reach) for reach in reversed(STAGES) if reach < images.longest)]
        for part in parts:
            if part.frames >= LEAST_ACCELERATED:
                number = MOTION_ACCELERATED if part is images else MOTION_ACCELERATED_IN_PART
                found.append(MotionModelCandidate(part, settings, number))
    return found


class MotionModelTrial(NamedTuple):
    """Fit of a model of `list_motion_models`."""

    fit: Fit
    all_images: bool
    """Whether it was fitted to all images."""
    take: Callable[[Mask], None]
    """Called with the pixels where the fit is selected."""
    growth: Mask | None = None
    """Where its growth differs significantly; None if growth is not compared."""


def choose_motion_model(
    plain: Fit, trials: Iterable[MotionModelTrial], where: Sequence[Mask], sigma_px: float, noise: float, step: int = 1,
    *, noise_ratio: float = 1.0,
) -> tuple[Fit, NDArray[np.int8]]:  # fmt: skip
    """Return, at every pixel, the last fit that explains the images better and changes the selection, and its number.

    ``where``: Pixels (y, x) at which each fit may be selected. The plain fit has the number 0, the trials from 1 on.
    ``step``: Distance of the pixels of which means are taken; more than 1 for full windows, which vary smoothly.
    ``noise_ratio``: Variance of the parameters by noise relative to that which the fits state.
    """
    which = np.zeros(plain.theta.shape[1:], dtype=np.int8)
    fit, number = plain, 0
    # `zip` and `enumerate` would keep a trial while the next one is fitted.
    for trial in trials:
        tried, number = where[number], number + 1
        pair = at_nodes(fit, step), at_nodes(trial.fit, step)
        among, sigma = tried[::step, ::step], _WIDER * sigma_px / step
        other = tried & explained(trial.fit.residual[0], trial.fit.residual[1], noise)
        other &= np.isfinite(trial.fit.theta[0]) & np.isfinite(trial.fit.variance[0])
        differs = differ(*pair, sigma, motion=True, among=among, most=_MOST, noise_ratio=noise_ratio)
        other &= enlarged(differs, step, tried.shape)
        less = _leaves_less(pair[0], trial._replace(fit=pair[1]), other[::step, ::step], sigma, noise)
        other &= enlarged(less, step, tried.shape)
        if trial.growth is not None:
            # Anisotropic growth hardly changes the residual.
            other |= trial.growth & tried & explained(trial.fit.residual[0], trial.fit.residual[1], noise)
        fit = chosen_fit(other, trial.fit, fit)
        which[other] = number
        trial.take(other)
        del trial, pair
    return fit, which


def _leaves_less(fit: Fit, trial: MotionModelTrial, among: Mask, sigma_px: float, noise: float) -> Mask:
    """Return where a trial reduces the windowed residual, to the noise level or to less than half of its square."""
    before, after = (gaussian_mean(np.where(among, each.residual[0], 0.0), sigma_px) for each in (fit, trial.fit))
    less = after < (1.0 if trial.all_images else _OTHER_NOISE) * before
    return np.asarray(less & ((trial.fit.residual[0] <= noise**2) | (after < _MUCH_LESS * before)))


def refit_motion_models(refined: RefinedState, settings: RefinedSettings) -> RefinedState:
    """Fit pixels again whose motion has more parameters than the plain one."""
    images = refined.images
    sigma, richer = settings.window_sigma_px, list_motion_models(images, settings)
    known = np.asarray(np.isfinite(refined.fit.theta).all(axis=0))
    if not richer or not known.any():
        return refined
    reach = window_weights(sigma).shape[2] // 2
    # Windows with more than one surface have an apparent change of motion.
    whole = known & ~around(find_discontinuities(images, refined.fit.theta), reach)
    state = fill_gaps(refined.fit.theta, known)
    # At the edges of the images, windows contain a single surface, but fewer pixels.
    growing = known & ~around(find_discontinuities(images, state), reach)
    single = growing & ~around(_find_ramps(images, state, reach), reach)
    smooth = smooth_velocity(refined.fit, single, sigma)
    # Apparent curvature may have been motion.
    state[CURVATURES] = 0.0
    gains = settings.photometric_model == "per_image"
    at = Linearisation(images, state, known, refined.curved, gains, sample_step(sigma), smooth)
    refined, tests = _test_motion_models(refined, at, richer, settings, (whole, growing))
    tried = _list_tried([test.promising for test in tests], richer)
    if not any(where.any() for where in tried):
        return refined
    # Small changes of growth follow from the linear fit; an acceleration is compared with a converged fit.
    bent = [test.promising if test.motion.settings.accelerated else test.far for test in tests]
    near = around(np.logical_or.reduce(bent), round(_MARGIN * reach))
    if near.any():
        tried, state, smooth = _iterate(refined, at, richer, tests, (whole, single), near)
    left = [n for n, where in enumerate(tried) if where.any()]
    richer, tried = [richer[n] for n in left], [tried[n] for n in left]
    seen, uneven, curved = refined.seen, refined.uneven, refined.curved

    def trials(theta: Map) -> Iterator[MotionModelTrial]:
        for motion, where in zip(richer, tried, strict=True):
            models, theta = select_models(motion.images, motion.settings), motion.begun(theta)
            begun = np.where(around(where, round(_MARGIN * reach)), theta, np.nan)
            affine = smooth if models[0].gradient == _AFFINE else None
            first, bent, chosen = fit_surface(motion.images, begun, models, settings, where, affine)
            begun = np.where(where & is_valid_step(theta, first), first, begun)
            last, left, size = None, where, _AROUND * round(sigma) + 1
            settled, far = np.zeros((2, *where.shape), dtype=np.bool_)
            for _ in range(_FINAL_ROUNDS):
                of_left = np.where(left, chosen, NO_MODEL).astype(np.int8)
                now = fit_final(motion.images, begun, models, settings, of_left, affine)
                theta = np.where(left & is_valid_step(theta, now.fit.theta), now.fit.theta, theta)
                with np.errstate(invalid="ignore"):
                    moved = images.moved_px(extract_fields(begun), extract_fields(now.fit.theta))
                    settled, far = np.where(left, (moved < _SETTLED_PX, moved >= _SETTLED_PX), (settled, far))
                last = now if last is None else last.replaced(left, now)
                left = mark_mostly(far, where, size, _MOST_FAR)
                if not left.any():
                    break
                begun = np.where(around(left, round(_MARGIN * reach)), theta, np.nan)
            assert last is not None

            def take(other: Mask, last: FinalIteration = last, bent: Mask = bent) -> None:
                nonlocal seen, uneven, curved
                seen = seen.chosen(other, last.seen)
                uneven, curved = np.where(other, last.uneven, uneven), np.where(other, bent, curved)

            # Fits without variance are not selected.
            fit = last.fit._replace(variance=np.where(settled, last.fit.variance, np.nan))
            growth = None
            if _compares_growth(refined.fit, motion):
                growth = compare_growth(refined.fit, fit, sigma, where, images.transfer).significant
            trial = [MotionModelTrial(fit, motion.images is images, take, growth)]
            # A trial is released before the next one is fitted: each holds all maps of a fit.
            del fit, last, now, take
            yield trial.pop()

    noise = settings.max_residual_ratio * images.residual_noise(refined.fit.residual[0], of_plain=True)
    fit, which = choose_motion_model(
        refined.fit, trials(state), tried, sigma, noise, at.step, noise_ratio=images.noise_ratio
    )
    accelerated_ones = [number for number, motion in enumerate(richer, 1) if motion.settings.accelerated]
    lost = find_remainders(which, accelerated_ones, known, sigma)
    return replace(
        refined,
        fit=fit,
        curved=curved,
        seen=seen,
        uneven=uneven,
        motion=encode_motion_models(which, richer),
        unresolved=lost if lost.any() else refined.unresolved,
    )


def find_remainders(which: NDArray[np.int8], numbers: Sequence[int], known: Mask, sigma_px: float) -> Mask:
    """Return pixels with a simpler model than nearly all of their surroundings within a window, which have another.

    The fit of that model has not converged there, or chance decided the test. ``which``: Number of the model.
    ``numbers``: Those of the models that are compared.
    """
    lost, all_known = np.zeros(which.shape, dtype=np.bool_), gaussian_mean(known.astype(np.float64), sigma_px)
    for number in numbers:
        chosen = known & (which >= number)
        share = gaussian_mean(chosen.astype(np.float64), sigma_px)
        lost |= known & ~chosen & (share > _NEARLY_ALL * all_known)
    return lost


def encode_motion_models(which: NDArray[np.int8], richer: list[MotionModelCandidate]) -> NDArray[np.int8]:
    """Return the values of ``motion_model`` for the selection of `choose_motion_model`, shape (y, x)."""
    return np.array([MOTION_PLAIN, *(motion.number for motion in richer)], dtype=np.int8)[which]


def _find_ramps(images: ImageStack, theta: Map, distance: int) -> Mask:
    """Return where a surface leads to another one without a step, because windows show both."""
    found, theta = np.zeros(images.shape, dtype=np.bool_), np.ascontiguousarray(theta)
    for offset in ((distance, 0), (0, distance)):
        fixed = theta, images.arms(len(extract_fields(theta))), offset, _RAMP_PX, found
        in_threads(partial(find_jumps, *fixed), bands(len(found)))
    return found


def _compares_growth(plain: Fit, motion: MotionModelCandidate) -> bool:
    """Return whether a model differs from the plain one in growth only; constant surfaces have none."""
    return motion.number == MOTION_AFFINE and plain.element.shape[1:] == plain.theta.shape[1:]


class _MotionModelTest(NamedTuple):
    """Result of the linear fit of a motion model."""

    motion: MotionModelCandidate
    fit: Fit
    """At the nodes of the lattice."""
    promising: Mask
    """Pixels where the model should be tried."""
    far: Mask
    """Those of them where the step to it is not linear."""


def _test_motion_models(
    refined: RefinedState,
    at: Linearisation,
    richer: list[MotionModelCandidate],
    settings: RefinedSettings,
    among: tuple[Mask, Mask],
) -> tuple[RefinedState, list[_MotionModelTest]]:
    """Return the tests of all velocity gradients and of the first accelerations.

    The state gets the bias of the plain growth that noise may hide, and the linear fits for the systematic errors of
    plain pixels. ``among``: Pixels whose windows show one surface, without and with those at the edges of the images.
    """
    nodes = slice(None, None, at.step), slice(None, None, at.step)
    compared = [motion for motion in richer if not motion.settings.accelerated]
    compared += [motion for motion in richer if motion.settings.accelerated][:_ACCELERATIONS]
    alternatives = [_alternative(refined, motion) for motion in compared]
    fits = at.fits([*alternatives, *list_alternatives(refined.images, settings)])
    refined = replace(refined, linear_fits=tuple(fits[len(compared) :]))
    present = simpler = at_nodes(refined.fit, at.step)
    sigma, state = settings.window_sigma_px / at.step, at.state[:, *nodes]
    tests = []
    for motion, fit in zip(compared, fits, strict=False):
        # Smaller windows determine whether an acceleration over fewer frames applies; one over all frames makes them
        # differ.
        suited = among[0] & ~refined.uneven if motion.number == MOTION_ACCELERATED_IN_PART else among[0]
        bent = find_far(motion.images, state, fit)
        changed = _changed(simpler, fit, suited[nodes], sigma, refined.images.noise_ratio)
        found = suited & enlarged(changed, at.step, suited.shape)
        if _compares_growth(refined.fit, motion):
            growth = compare_growth(present, fit, sigma, among[1][nodes], motion.images.transfer)
            found |= among[1] & enlarged(growth.significant, at.step, suited.shape)
            refined = replace(refined, growth_bias=enlarged(growth.bias, at.step, suited.shape))
        if not motion.settings.accelerated:
            simpler = fit
        tests.append(_MotionModelTest(motion, fit, found, found & enlarged(bent, at.step, suited.shape)))
    return refined, tests


def _alternative(refined: RefinedState, motion: MotionModelCandidate) -> Alternative:
    models, settings = select_models(motion.images, motion.settings), motion.settings
    variances = EVERY_VARIANCE if _compares_growth(refined.fit, motion) else _VARIANCES
    return Alternative(motion.images, models, settings.window_sigma_px, variances, models[0].gradient == _AFFINE)


def _list_tried(promising: list[Mask], richer: list[MotionModelCandidate]) -> list[Mask]:
    """Return where each motion model should be tried, from tests of the velocity gradients and first accelerations.

    Over all frames, jerk is not acceleration, and over fewer frames a small acceleration is below the noise: these
    models are tried wherever either span indicates an acceleration.
    """
    accelerations = sum(motion.settings.accelerated for motion in richer)
    gradients, found = promising[: len(richer) - accelerations], promising[len(richer) - accelerations :]
    return [*gradients, *found[:1], *[np.logical_or.reduce(found)] * (accelerations - 1)]


def _iterate(
    refined: RefinedState,
    at: Linearisation,
    richer: list[MotionModelCandidate],
    tests: list[_MotionModelTest],
    among: tuple[Mask, Mask],
    near: Mask,
) -> tuple[list[Mask], Map, Map]:
    """Fit the models again in the mask ``near``; return where to try each model, the parameters and smooth velocity.

    ``among``: Pixels whose windows show one surface according to the plain fit, and those that have a smooth velocity.
    """
    whole, single = among
    reach = window_weights(richer[0].settings.window_sigma_px).shape[2] // 2
    smooth = at.smooth if at.smooth is not None else np.full((3, *refined.images.shape), np.nan)
    noise = refined.images.residual_noise(refined.fit.residual[0], of_plain=True)
    noise *= richer[0].settings.max_residual_ratio
    nodes = slice(None, None, at.step), slice(None, None, at.step)
    sigma = richer[0].settings.window_sigma_px / at.step
    simpler, theta, promising = at_nodes(refined.fit, at.step), at.state, []
    accelerating = any(test.promising.any() for test in tests if test.motion.settings.accelerated)
    for motion, fit, found, _ in tests:
        bent = motion.settings.accelerated
        if bent and not accelerating:
            promising.append(found)
            continue
        # A plain fit that is far off has the smooth velocity of its errors.
        again, theta = _iterated(refined, motion, theta, at.smooth if bent else None, near)
        if not bent and motion.number == MOTION_AFFINE:
            clear = at.where & near & explained(again.residual[0], again.residual[1], noise)
            whole = whole | (clear & ~around(find_discontinuities(motion.images, theta), reach))
            smooth = np.where(
                near, smooth_velocity(again, (single | whole) & near, motion.settings.window_sigma_px), smooth
            )
        again = at_nodes(again, at.step)
        suited = whole & near & ~refined.uneven if motion.number == MOTION_ACCELERATED_IN_PART else whole & near
        changed = suited & enlarged(
            _changed(simpler, again, suited[nodes], sigma, refined.images.noise_ratio), at.step, suited.shape
        )
        promising.append(changed if bent else found | changed)
        simpler = simpler if bent else chosen_fit(near[nodes], again, fit)
    return _list_tried(promising, richer), theta, smooth


def _iterated(
    refined: RefinedState, motion: MotionModelCandidate, theta: Map, smooth: Map | None, where: Mask
) -> tuple[Fit, Map]:
    """Fit a motion model in a mask, at every other row and column; return the fit and the parameters of all pixels."""
    models, theta = select_models(motion.images, motion.settings), motion.begun(theta)
    sigma, gains = motion.settings.window_sigma_px, motion.settings.photometric_model == "per_image"
    fitted = partial(fit_round, motion.images, models=models, sigma_px=sigma, gains=gains, coarse=True)
    margin, left = round(_MARGIN * (window_weights(sigma).shape[2] // 2)), where
    # A plane first: apparent curvature may be motion. The residual is pure noise only if both are fitted.
    for _ in range(_ROUNDS):
        chosen = np.where(left, 0, NO_MODEL).astype(np.int8)
        plane = fitted(np.where(around(left, margin), theta, np.nan), chosen=chosen)[0]
        sound = left & is_valid_step(theta, plane.theta)
        with np.errstate(invalid="ignore"):
            moved = motion.images.moved_px(extract_fields(theta), extract_fields(plane.theta)) > _SETTLED_PX
        theta = np.where(sound, plane.theta, theta)
        left = mark_mostly(moved, sound, _AROUND * round(sigma) + 1, _MOST_FAR)
        if not left.any():
            break
    near = around(where, margin)
    affine = smooth if models[0].gradient == _AFFINE else None
    chosen = np.where(where, refined.curved, NO_MODEL).astype(np.int8)
    fit = fitted(np.where(near, theta, np.nan), chosen=chosen, variances=_VARIANCES, smooth=affine)[0]
    return fit, np.where(is_valid_step(theta, fit.theta), fit.theta, theta)


def _changed(plain: Fit, other: Fit, among: Mask, sigma: float, noise_ratio: float) -> Mask:
    """Return the nodes near which a fit differs from another over areas as large as a window of sigma nodes."""
    found = differ(plain, other, _WIDER * sigma, motion=True, among=among, most=_MOST, noise_ratio=noise_ratio)
    return among & large_areas(found, sigma)
