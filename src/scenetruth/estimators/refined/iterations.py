"""Iterations: all images are warped, and all windows fitted, until convergence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.method_settings import LEAST_ACCELERATED, RefinedSettings
from scenetruth.estimators.refined.fit_maps import (
    STEADY_PLACES,
    blank_fit,
    chosen_fit,
    differ,
    every_nth,
    extract_fields,
    initial_parameters,
    nearest_node,
)
from scenetruth.estimators.refined.image_consistency import find_inconsistent_images
from scenetruth.estimators.refined.image_stack import ImageStack, without_aliases
from scenetruth.estimators.refined.initialisation import fill_gaps
from scenetruth.estimators.refined.kernels.window_solver import EVERY_VARIANCE, FULL, Fit, Model
from scenetruth.estimators.refined.kernels.window_sums import EVERY_MODEL, NO_MODEL
from scenetruth.estimators.refined.lattice import COARSE_STEP, WindowLattice, WindowNodes, lattice_step
from scenetruth.estimators.refined.noise_estimation import (
    GreyVariance,
    estimate_noise,
    estimate_variance,
    spline_transfer,
)
from scenetruth.estimators.refined.pose_corrections import PoseCorrections, ShiftObservations
from scenetruth.estimators.refined.row_bands import PixelEvidence, bands, local_means
from scenetruth.estimators.refined.velocity_curvature import add_velocity, remove_slopes, remove_velocity
from scenetruth.schema.variables import MOTION_PLAIN

__all__ = [
    "STAGES",
    "RefinedState",
    "fill_invalid_parameters",
    "fit_final",
    "fit_round",
    "is_valid_step",
    "refine",
    "select_models",
]

_LEAST_SHARE = 0.5  # smallest valid fraction of a window
STAGES = (1, 2)  # numbers of adjacent frames used in the first iterations
_STILL_SHARE = 0.9  # fraction of the pixels that must have converged: at discontinuities, some never do
_FINER = 0.5  # relative width of the smaller windows that test whether full windows suffice
_FITTED = 1.5  # windows with a residual above this multiple of the noise are excluded from the convergence test
_STEADY_VARIANCES = 6  # number of variances of the smaller windows: disparity, slopes and velocity
# Number of cameras whose residual in one frame limits the noise, and ratio: residuals over frames include changes of
# light and small unsteady motion.
_LEAST_STILL, _NOISE_MARGIN = 3, 1.5
_FULL_ITERATIONS = 2  # iterations with all pixels
# Change, in tolerances, from which on these two iterations suffice: each leaves less than a third of a change.
_DRAFT_TOLERANCE = 10.0

Map = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RefinedState:
    """Result of the iterations."""

    fit: Fit
    """Fit around every pixel; NaN where invalid."""
    curved: NDArray[np.bool_]
    """Where the surface is of second order, shape (y, x)."""
    rounds: int
    seen: PixelEvidence
    """Residual and gradient of every pixel by itself."""
    uneven: NDArray[np.bool_]
    """Where smaller windows have another disparity or velocity: the model does not apply."""
    motion: NDArray[np.int8]
    """Motion model of the fit, as in ``motion_model``."""
    images: ImageStack
    """Images with their estimated corrections."""
    cameras: PoseCorrections | None
    growth_bias: Map | None = None
    """Mean square bias of rotation and growth rates of the plain motion model, shape (4, y, x); None if not tested."""
    linear_fits: tuple[Fit, ...] = ()
    """Fits of fewer frames and smaller windows to pixels of the plain motion model; empty if there are none."""
    fewer: NDArray[np.int8] | None = None
    """Index of the span of frames of the fit in `list_spans`, shape (y, x); None: all frames everywhere."""
    unresolved: NDArray[np.bool_] | None = None
    """Where two or three frames do not resolve the motion; None if it is tested nowhere."""
    light_edges: Map | None = None
    """Squared errors of q_X and q_Y at edges of light, shape (2, y, x); None if there are none."""
    alias_residual: Map | None = None
    """Part of the mean square residual that aliases of demosaicing cause, their powers along x and y, and the variances
    that they cause, shape (7, y, x), see `measure_alias_residual`; None if they are not separated from noise.
    """
    coupling: Map | float = 1.0
    """As from `measure_noise_coupling`."""

    @property
    def noise_residual(self) -> Map:
        """Mean square residual of the windows without that by aliases, shape (y, x)."""
        return without_aliases(self.fit.residual[0], self.alias_residual)

    @property
    def noise_ratio(self) -> float:
        """Variance by noise relative to that which the fit states: median over the pixels; 1 for images as recorded."""
        if self.alias_residual is None:
            return self.images.noise_ratio
        return self._noise_ratio(self.coupling)

    @property
    def largest_noise_ratio(self) -> float:
        """Ratio as `noise_ratio` for noise of low frequencies, which fits in small windows are compared with."""
        return self.images.noise_ratio if self.alias_residual is None else self._noise_ratio(1.0)

    def _noise_ratio(self, coupling: Map | float) -> float:
        transfers = self.images.transfers_of(self.fit.residual[0], self.alias_residual, coupling)
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = float(np.nanmedian((spline_transfer(self.images.spline) / transfers) ** 2))
        return ratio if np.isfinite(ratio) else 1.0


def refine(
    images: ImageStack, start: Map, settings: RefinedSettings, report: Callable[[int], None] | None = None
) -> RefinedState:
    """Fit surface and motion around every pixel, from finite disparity and velocity, shape (4, y, x).

    The first iterations use only the nearest frames and a motion without gradient, for a larger convergence range.
    """
    models, sigma, gains = (
        select_models(images, settings),
        settings.window_sigma_px,
        settings.photometric_model == "per_image",
    )
    plain = models[0]._replace(gradient=0) if models[0].surface > 0 else models[0]
    steady = plain._replace(accelerated=False)
    cameras = None if images.priors is None else PoseCorrections(images.priors, images)
    span = float(np.abs(images.times).max())
    # The step from the adjacent frames to the fourth is as large as that from the second to the eighth.
    stages = [(reach, steady) for reach in STAGES if reach == 1 < span or 1 < reach < span / 2]
    state = initial_parameters(start, accelerated=settings.accelerated)
    done, left = 0, settings.max_iterations - _FULL_ITERATIONS
    left_out: frozenset[tuple[int, int]] = frozenset()
    settled = cameras is None
    for reach, model in [*stages, (span, plain), *[(span, models[0])] * left]:
        if done >= left:
            break
        part = images.within(reach)
        if done <= len(stages):
            left_out = find_inconsistent_images(images, extract_fields(state), sigma, part)
        part = part.without(left_out)
        shifts = None if cameras is None or settled else ShiftObservations.blank(images.shape, len(part.view().s))
        varying = settings.noise == "estimated" and images.noise is None and model is models[0]
        # Residuals by aliases follow the contrast, which may increase with the grey value where noise does not.
        varying = varying and images.demosaiced is None
        evidence = PixelEvidence.blank(images.shape) if varying else None
        (fit,) = fit_round(
            part, state, [model], sigma, gains=gains, shifts=shifts, seen=evidence, coarse=True, draft=True
        )
        if evidence is not None:
            images = replace(images, variance=_estimated_variance(images, evidence))
        before, state = state, fill_invalid_parameters(state, fit.theta)
        if cameras is not None and shifts is not None:
            moved = cameras.update(shifts, before[STEADY_PLACES], part)
            images = replace(images, moved=cameras.values)
            # Undetermined corrections would drift slowly without limit, together with all surfaces.
            settled = reach == span and moved < settings.tolerance_px
        done += 1
        if report is not None:
            report(done)
        if (
            model is models[0]
            and settled
            and _still(before, state, fit, images, _DRAFT_TOLERANCE * settings.tolerance_px)
        ):
            break
    images = images.without(find_inconsistent_images(images, extract_fields(state), sigma, images))
    images = replace(images, noise_limit=_limit_noise(images, state, settings))
    # All pixels start from the results of every other row, and the order of the surface may change: another iteration.
    theta, curved, chosen = fit_surface(images, state, models, settings)
    state = fill_invalid_parameters(state, theta)
    done += 1
    if report is not None:
        report(done)
    last = fit_final(images, state, models, settings, chosen)
    if report is not None:
        report(done + 1)
    motion = np.full(images.shape, MOTION_PLAIN, dtype=np.int8)
    return RefinedState(last.fit, curved, done + 1, last.seen, last.uneven, motion, images, cameras)


def _limit_noise(images: ImageStack, state: Map, settings: RefinedSettings) -> float:
    """Return the largest plausible residual of windows that fit well: that of the cameras of one frame, with a margin.

    If the motion of most of the image is no candidate, residuals over all frames are no measure of the noise. A given
    noise is limited already.
    """
    if images.noise is not None:
        return images.noise_limit
    still = images.within(0.0)
    if still.count < _LEAST_STILL or len(images.times) == 1:
        return np.inf
    models = select_models(still, settings.model_copy(update={"acceleration": False}))
    gains = settings.photometric_model == "per_image"
    begun = state[:FULL]
    (fit, *_) = fit_round(still, begun, models[:1], settings.window_sigma_px, gains=gains, coarse=True, draft=True)
    found = estimate_noise(np.sqrt(fit.residual[0]))
    return _NOISE_MARGIN * found if np.isfinite(found) and found > 0 else np.inf


def fit_surface(
    images: ImageStack,
    state: Map,
    models: list[Model],
    settings: RefinedSettings,
    where: NDArray[np.bool_] | None = None,
    smooth: Map | None = None,
) -> tuple[Map, NDArray[np.bool_], NDArray[np.int8]]:
    """Fit the models and select one for every pixel; return parameters, where the surface is curved, and index."""
    sigma, gains = settings.window_sigma_px, settings.photometric_model == "per_image"
    wanted = np.ones(images.shape, dtype=np.bool_) if where is None else where
    every = np.where(wanted, EVERY_MODEL, NO_MODEL).astype(np.int8)
    fitted = partial(fit_round, images, state, models, sigma, gains=gains, chosen=every, smooth=smooth)
    fits = fitted(variances=len(models) - 1, draft=True)
    if len(models) == 1:
        curved, theta = np.full(images.shape, models[0].surface == _CURVED), fits[0].theta
        return theta, curved, np.where(wanted, 0, NO_MODEL).astype(np.int8)
    plane, bent = fits
    curved = differ(plane, bent, sigma, noise_ratio=images.noise_ratio)
    return np.where(curved, bent.theta, plane.theta), curved, np.where(wanted, curved, NO_MODEL).astype(np.int8)


@dataclass(frozen=True, eq=False)
class FinalIteration:
    """Result of the last iteration."""

    fit: Fit
    """Fit around every pixel, with all variances."""
    seen: PixelEvidence
    """Residual and gradient of every pixel by itself."""
    uneven: NDArray[np.bool_]
    """As in `RefinedState`."""

    def replaced(self, where: NDArray[np.bool_], other: FinalIteration) -> FinalIteration:
        """Return the result of another iteration in a mask, else this one."""
        fit, uneven = chosen_fit(where, other.fit, self.fit), np.where(where, other.uneven, self.uneven)
        return FinalIteration(fit, self.seen.chosen(where, other.seen), uneven)


def fit_final(
    images: ImageStack,
    state: Map,
    models: list[Model],
    settings: RefinedSettings,
    chosen: NDArray[np.int8],
    smooth: Map | None = None,
) -> FinalIteration:
    """Warp all images and fit the selected models, with all output quantities."""
    small = _FINER * settings.window_sigma_px
    step = max(1, int(small))
    begun = np.ascontiguousarray(state[:, ::step, ::step])
    seen, finer = PixelEvidence.blank(images.shape), blank_fit(begun, variances=True, element=False)
    gains = settings.photometric_model == "per_image"
    final = partial(fit_round, images, state, models, settings.window_sigma_px, gains=gains, chosen=chosen)
    fit, *_ = final(variances=EVERY_VARIANCE, finer=(small, step, finer), seen=seen, smooth=smooth)
    # The test averages over a window: smaller windows at a distance of their standard deviation suffice.
    uneven = differ(every_nth(fit, step), finer, small / step, motion=True, noise_ratio=images.noise_ratio)
    return FinalIteration(fit, seen, nearest_node(uneven, step, images.shape))


_CONSTANT, _PLANE, _CURVED = 1, 3, 6
_SURFACES = {"constant": [_CONSTANT], "plane": [_PLANE], "curved": [_CURVED], "auto": [_PLANE, _CURVED]}
_GRADIENTS = {"auto": 2, "translation": 0, "rigid": 1, "growing": 2, "affine": 3}


def select_models(images: ImageStack, settings: RefinedSettings) -> list[Model]:
    """Return the candidate models, the simplest first, as far as cameras and frames determine them."""
    moves = len(images.times) > 1
    accelerated = settings.accelerated and len(images.times) >= LEAST_ACCELERATED
    if len(images.positions) == 1:
        return [Model(0, 2, 3 if settings.motion != "translation" else 0, accelerated)]
    gradient = _GRADIENTS[settings.motion] if moves else 0
    # Without slopes, a surface has no tangents that could rotate.
    if settings.surface == "constant" and 0 < gradient < _GRADIENTS["affine"]:
        gradient = 0
    return [Model(surface, 3 if moves else 0, gradient, accelerated) for surface in _SURFACES[settings.surface]]


def fit_round(
    images: ImageStack,
    state: Map,
    models: list[Model],
    sigma_px: float,
    *,
    gains: bool,
    variances: int = 0,
    chosen: NDArray[np.int8] | None = None,
    finer: tuple[float, int, Fit] | None = None,
    seen: PixelEvidence | None = None,
    shifts: ShiftObservations | None = None,
    coarse: bool = False,
    draft: bool = False,
    smooth: Map | None = None,
) -> list[Fit]:
    """Warp all images by the current parameters, NaN to skip a pixel, and fit each model, or the selected model.

    ``finer``: Standard deviation of smaller windows, their distance, and the fit in them.
    ``coarse``: Whether only every other row is warped, and windows are fitted at every other pixel of these.
    ``draft``: Whether parameters of a coarse fit are start values only: fewer rows and windows suffice.
    ``smooth``: Velocity that is removed before affine models are fitted, as in `smooth_velocity`.
    """
    chosen = np.full(images.shape, EVERY_MODEL, dtype=np.int8) if chosen is None else chosen
    chosen = np.where(np.isnan(state[0]), NO_MODEL, chosen).astype(np.int8)
    begun = state if smooth is None else remove_slopes(state, smooth)
    if (chosen == EVERY_MODEL).any():
        fits = [blank_fit(begun, variances=variances > 0, element=variances == EVERY_VARIANCE) for _ in models]
    else:
        fits = [blank_fit(begun, variances=variances > 0, element=variances == EVERY_VARIANCE)] * len(models)
    fields, least_share = extract_fields(state), _LEAST_SHARE
    if coarse:
        # Blocks of the pose corrections require every other row.
        every = max(COARSE_STEP, lattice_step(sigma_px) if draft and shifts is None else 0)
        fields[:, np.arange(fields.shape[1]) % every != 0] = np.nan
        least_share /= every
    lattice = partial(WindowLattice, images, models, sigma_px, fits, chosen)
    windows: list[WindowLattice | WindowNodes] = [
        lattice(least_share=least_share, variances=variances, coarse=coarse, draft=draft)
    ]
    if finer is not None:
        small, step, nodes = finer
        of_nodes = partial(WindowNodes, images, models, small, nodes, np.ascontiguousarray(chosen[::step, ::step]))
        windows.append(of_nodes(step=step, least_share=least_share, variances=_STEADY_VARIANCES))
    behind = max(each.behind for each in windows)
    for band in bands(images, fields, sigma_px, gains=gains, shifts=shifts, behind=behind):
        if smooth is not None:
            remove_velocity(band.products, band.first, smooth)
        for each in windows:
            each.put(band)
        if seen is not None:
            seen.put(band)
    if smooth is not None:
        for fit in {id(fit): fit for fit in fits}.values():
            add_velocity(fit, smooth, images, chosen > NO_MODEL)
        if finer is not None:
            nodes.theta[STEADY_PLACES[1:]] += np.nan_to_num(smooth[:, ::step, ::step])
    return fits


def is_valid_step(state: Map, theta: Map) -> NDArray[np.bool_]:
    """Return where new parameters are finite, and the disparity changes neither its sign nor by half or more."""
    with np.errstate(invalid="ignore"):
        sound = np.isfinite(theta).all(axis=0) & (theta[0] * state[0] > 0)
        return np.asarray(sound & (np.abs(theta[0] - state[0]) < 0.5 * np.abs(state[0])))


def fill_invalid_parameters(state: Map, theta: Map) -> Map:
    """Return parameters without gaps: those of a fit where its step is valid, else those of the nearest valid pixel."""
    sound = is_valid_step(state, theta)
    return fill_gaps(theta, sound) if sound.any() else state


def _estimated_variance(images: ImageStack, seen: PixelEvidence) -> GreyVariance:
    """Return the noise variance as a function of the grey value, from the residuals of single pixels."""
    grey = local_means(images.reference_grey())
    return estimate_variance(grey, seen.square * images.variance.at(grey))


def _still(before: Map, after: Map, fit: Fit, images: ImageStack, tolerance_px: float) -> bool:
    """Return whether 90 % of the well-fitted pixels moved by less than a tolerance in all images."""
    moved = images.moved_px(extract_fields(before), extract_fields(after))
    left = np.sqrt(fit.residual[0]) / images.transfer
    noise = images.residual_noise(fit.residual[0]) / images.transfer
    with np.errstate(invalid="ignore"):
        fitted = images.is_textured(fit.residual[1], noise)
        fitted &= left < _FITTED * noise
    return not fitted.any() or bool(np.mean(moved[fitted] < tolerance_px) >= _STILL_SHARE)
