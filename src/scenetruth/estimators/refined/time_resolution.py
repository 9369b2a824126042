"""Test of velocities from two or three frames with the frames beyond them.

A velocity and an acceleration fit any positions in three frames, so that neither their residual nor a shorter span
shows whether the motion changes otherwise between them. The frames next to them do: a point that moves as a polynomial
through its positions in all of these frames has another velocity, and the difference is a systematic error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenetruth.estimators.method_settings import LEAST_ACCELERATED, RefinedSettings
from scenetruth.estimators.plane_sweep.motion_search import sweep_motion
from scenetruth.estimators.refined.fit_maps import (
    STEADY_PLACES,
    chosen_fit,
    explained,
    find_discontinuities,
)
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.initialisation import fill_gaps
from scenetruth.estimators.refined.iterations import RefinedState
from scenetruth.estimators.refined.kernels.window_solver import FULL, Fit
from scenetruth.estimators.refined.lattice import sample_step
from scenetruth.estimators.refined.model_tests import at_nodes, enlarged, find_far
from scenetruth.estimators.refined.row_bands import around, mark_mostly, window_weights
from scenetruth.estimators.refined.systematic_error import (
    LARGEST_UNTESTED,
    OF_VELOCITY,
    Quantities,
    SpanGroup,
    SystematicErrors,
    collect_quantities,
    fit_span,
    list_spans,
    mean_change,
)
from scenetruth.schema.variables import MOTION_ACCELERATED_IN_PART

__all__ = ["LARGEST_UNTESTED", "check_time_resolution", "choose_frames_beyond", "derivative_weights", "join_frames"]

_TERMS = 3  # number of terms of the polynomial of a fit: position, velocity and acceleration
# Ratio of the stated error to the difference from the polynomial: of harmonic motions, whose period is P frames, the
# error is 0.7 (P = 20), 1.0 (P = 5) and 1.2 (P = 4) times the stated one.
_MARGIN = 1.4
# Share of the acceleration that is added if a single frame lies beyond: a harmonic motion is in line with it twice in a
# period, when its acceleration is large.
_OF_ACCELERATION = 0.1
_MOST_LOST = 0.2  # fraction of windows around a window that do not fit the frame, above which the motion is searched
# Scales of averaging in window widths: a local deviation shows at the first, a weak one of a whole surface at the last.
_SCALES = (1.0, 4.0)
_MOST = 3.0  # largest change of a window in averages over more than its surroundings, in standard deviations
# Fraction of the windows of a surface that must fit a frame beyond, and side of their surroundings in units of the
# window's σ: a wider side would reach beyond the margins of tiles.
_RESOLVED, _AROUND = 0.5, 8
# Standard deviations of the noise of a fit up to which a motion to a frame beyond may differ from that of the fit.
_BY_NOISE = 3.0
_ROUNDING = 1e-9  # of shares of windows
_SEARCHED_PX = 16.0
_VELOCITY, _STEADY = slice(3, 6), 6  # velocity among the quantities, and number of variances before the acceleration

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


def derivative_weights(fitted: ArrayLike, beyond: ArrayLike, derivative: int = 1) -> Map:
    """Return the weights of deviations at times beyond, whose sum is the error of a derivative at time 0.

    Positions are polynomials, with as many terms beyond those of the fit as there are deviations. The fit is a
    parabola, or a line through two times, by least squares; deviations are relative to the position at time 0.

    >>> derivative_weights([-1.0, 0.0, 1.0], [2.0]).round(3).tolist()
    [-0.167]
    """
    times, later = (np.atleast_1d(np.asarray(each, dtype=np.float64)) for each in (fitted, beyond))
    count = min(len(times), _TERMS)
    powers = np.arange(count, count + len(later))
    of_fit, *_ = np.linalg.lstsq(np.vander(times, count, increasing=True), times[:, None] ** powers)
    # Without the position at time 0, which is common to all times.
    of_fit[0] = 0.0
    deviation = later[:, None] ** powers - np.vander(later, count, increasing=True) @ of_fit
    wanted = math.factorial(derivative) * (powers == derivative)
    if derivative < count:
        wanted = wanted - math.factorial(derivative) * of_fit[derivative]
    return np.asarray(np.linalg.solve(deviation.T, wanted))


def choose_frames_beyond(times: NDArray[np.float64], fitted: NDArray[np.float64]) -> list[int]:
    """Return the indices of the nearest frames before and after the times of a fit, or of two on one side.

    >>> choose_frames_beyond(np.arange(-4.0, 5.0), np.arange(-1.0, 2.0))
    [2, 6]
    >>> choose_frames_beyond(np.arange(-1.0, 5.0), np.arange(-1.0, 2.0))
    [3, 4]
    """
    before, after = np.flatnonzero(times < fitted.min())[::-1], np.flatnonzero(times > fitted.max())
    if len(before) and len(after):
        return [int(before[0]), int(after[0])]
    return [int(n) for n in (*before[:2], *after[:2])]


def join_frames(images: ImageStack, wide: ImageStack) -> ImageStack:
    """Return the images of more frames with the corrections, exclusions and noise of those that were fitted."""
    first, cameras = int(np.searchsorted(wide.times, images.times[0])), len(images.positions)
    moved = wide.moved.copy()
    moved[first * cameras : first * cameras + len(images.moved)] = images.moved
    return replace(
        wide,
        moved=moved,
        left_out=frozenset((first + frame, camera) for frame, camera in images.left_out),
        variance=images.variance,
        noise=images.noise,
        noise_limit=images.noise_limit,
        noise_share=images.noise_share,
        priors=images.priors,
    )


def check_time_resolution(
    refined: RefinedState, near: Mask, images: ImageStack, settings: RefinedSettings
) -> RefinedState:
    """Return the fit with the errors of velocities that two or three frames determine, in its variances.

    Pixels around which most windows fit no frame beyond are marked as ``unresolved``.

    ``near``: Pixels to which smaller windows were fitted.
    ``images``: Images of all frames of the fit, and of frames beyond.
    """
    known = np.asarray(np.isfinite(refined.fit.theta).all(axis=0))
    for part, where in _untested(refined, known, settings):
        beyond = choose_frames_beyond(images.times, part.times)
        if beyond and where.any():
            refined = _check(refined, near, images, part, where, beyond, settings)
    return refined


def _untested(refined: RefinedState, known: Mask, settings: RefinedSettings) -> list[tuple[ImageStack, Mask]]:
    """Return the images of fits to two or three frames, and their pixels."""
    images = refined.images
    if len(images.included().times) <= LARGEST_UNTESTED:
        return [(images.included(), known)] if len(images.included().times) > 1 else []
    spans = list_spans(images)
    counts = np.array([part.count for part in spans])
    nearest = np.argmin(np.abs(counts[:, None, None] - np.nan_to_num(refined.fit.images)), axis=0)
    nearest = np.where(refined.motion == MOTION_ACCELERATED_IN_PART, nearest, 0)
    nearest = nearest if refined.fewer is None else np.where(refined.fewer > 0, refined.fewer, nearest)
    found = [(part.included(), known & (nearest == n)) for n, part in enumerate(spans)]
    return [
        (part, where) for part, where in found if 1 < len(part.times) < len(images.included().times) and where.any()
    ]


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A fit to two or three frames, at the nodes of the lattice."""

    core: Quantities
    acceleration: Map
    """Shape (3, rows, columns)."""
    variance: Map
    """Variance of the acceleration."""


@dataclass(frozen=True, eq=False)
class _Deviation:
    """Deviation of the motion to a frame beyond from that of a fit, at the nodes of the lattice."""

    time: float
    values: Map
    """Shape (16, rows, columns), times the time; 0 for quantities that do not change with the velocity."""
    noise: Map
    """Variance of the motion to the frame beyond, due to noise."""
    seen: Mask
    """Windows inside the images."""
    fits: Mask
    """Windows that fit the frame."""


def _check(
    refined: RefinedState,
    near: Mask,
    images: ImageStack,
    part: ImageStack,
    where: Mask,
    beyond: list[int],
    settings: RefinedSettings,
) -> RefinedState:
    """Check the pixels of a mask, fitted to the frames of a part."""
    sigma = settings.window_sigma_px
    step, reach = sample_step(sigma), window_weights(sigma).shape[2] // 2
    nodes = slice(None, None, step), slice(None, None, step)
    known = np.asarray(np.isfinite(refined.fit.theta).all(axis=0))
    state = fill_gaps(refined.fit.theta, known)
    whole = where & ~around(find_discontinuities(part, refined.fit.theta) & ~around(~known, 1), reach)
    # Frames beyond that are part of the window did not fit: without a test, the motion is unknown.
    few = len(part.times) <= LARGEST_UNTESTED
    of_window = few and len(part.times) < len(refined.images.included().times)
    if not whole.any():
        return replace(refined, unresolved=_joined(refined.unresolved, where & of_window))
    acceleration, of_noise = np.zeros((3, *images.shape)), np.zeros((3, *whole[nodes].shape))
    if len(part.times) >= LEAST_ACCELERATED:
        acceleration, of_noise = _acceleration(refined, part, state, whole, settings)
    fitted = _Fitted(
        collect_quantities(at_nodes(refined.fit, step), refined.noise_ratio), acceleration[:, *nodes], of_noise
    )
    core = fitted.core
    start = state, acceleration
    found = [_deviation(refined, images, n, start, whole, settings, core) for n in beyond]
    among = whole[nodes]
    square, tested = np.zeros((len(core.values) + 3, *among.shape)), np.zeros_like(among)
    # Both frames come last: they replace the result of one of them that both fit.
    for used in (*([each] for each in found), *([found] if len(found) > 1 else [])):
        own = among & np.logical_and.reduce([each.fits for each in used])
        if own.any():
            errors = _errors(used, fitted, part.times, own, sigma / step)
            square[:, own] = errors[:, own] ** 2
            tested |= own
    pixels = whole & enlarged(tested, step, whole.shape)
    seen = np.logical_or.reduce([each.seen for each in found])
    # Residuals of more frames test the motion by themselves.
    lost = whole & enlarged(among & seen & ~tested, step, whole.shape) & few
    unresolved = _unresolved(whole, pixels, lost, sigma) if (pixels | lost).any() else np.full(whole.shape, of_window)
    refined = replace(refined, unresolved=_joined(refined.unresolved, where & unresolved))
    if not pixels.any():
        return refined
    of_pixels = enlarged(square, step, whole.shape)
    of_elements, of_acceleration = of_pixels[: len(core.values)], of_pixels[len(core.values) :]
    fit = SystematicErrors(of_elements, of_elements, pixels, state[:FULL]).added(refined.fit, near, refined.noise_ratio)
    variance = np.where(where, fit.variance, refined.fit.variance)
    if len(variance) > core.fields:
        variance[core.fields :] += np.where(where, fill_gaps(of_acceleration, pixels) / refined.noise_ratio, 0.0)
    element = np.where(where, fit.element_variance, refined.fit.element_variance)
    return replace(refined, fit=refined.fit._replace(variance=variance, element_variance=element))


def _joined(before: Mask | None, found: Mask) -> Mask:
    return found if before is None else before | found


def _errors(used: Sequence[_Deviation], fitted: _Fitted, times: NDArray[np.float64], among: Mask, sigma: float) -> Map:
    """Return the errors of the quantities, and of the acceleration, that deviations beyond the fit show, (19, y, x)."""
    beyond = np.array([each.time for each in used])
    symmetric = len(used) > 1 and bool(np.isclose(beyond.sum(), 0.0) and np.isclose(times.sum(), 0.0))
    parts = []
    for derivative, chosen in ((1, slice(None)), (2, _VELOCITY)):
        weights = derivative_weights(times, beyond, derivative) * (derivative < len(times))
        of_fit = fitted.core.variances[chosen]
        of_acceleration = np.zeros_like(of_fit)
        of_acceleration[_VELOCITY if derivative == 1 else slice(None)] = fitted.variance

        def term(places: list[int], weights: Map = weights, chosen: slice = chosen, *own: Map) -> tuple[Map, Map]:
            """Return a weighted sum of deviations, and its variance due to noise."""
            total = np.sum([weights[n] * used[n].values[chosen] for n in places], axis=0)
            noise = np.sum([weights[n] ** 2 * used[n].noise[chosen] for n in places], axis=0)
            for power, variance in enumerate(own, 1):
                common = float(np.sum([weights[n] * beyond[n] ** power / power for n in places]))
                noise += common**2 * variance
            return total, noise

        # Of a symmetric fit, only the part of the same symmetry is an error; otherwise zeros of the sum would hide it.
        places = [list(range(len(used)))] if symmetric else [[n] for n in range(len(used))]
        terms = [term(each, weights, chosen, of_fit, of_acceleration) for each in places]
        squares = [np.max([_square_at_scale(*each, among, n, sigma) for n in _SCALES], axis=0) for each in terms]
        parts.append(np.sum(np.sqrt(squares), axis=0))
    if len(used) == 1:
        parts[0][_VELOCITY] += _OF_ACCELERATION * np.abs(fitted.acceleration)
    return _MARGIN * np.concatenate(parts)


def _square_at_scale(change: Map, noise: Map, among: Mask, scale: float, sigma: float) -> Map:
    """Return the square of the systematic change at a scale, over which changes of single windows do not spread."""
    if scale > 1.0:
        with np.errstate(invalid="ignore"):
            most = _MOST * np.sqrt(noise)
            change = np.clip(change, -most, most)
    return mean_change(change, noise, among, scale * sigma, 1.0 / (1.0 + (2.0 * scale) ** 2))[0]


def _unresolved(whole: Mask, tested: Mask, lost: Mask, sigma: float) -> Mask:
    """Return the pixels around which most windows of the same surface do not fit the frames beyond.

    Pixels that no frame beyond tests have the result of the nearest one.
    """
    from scipy.ndimage import distance_transform_edt, find_objects, label, uniform_filter

    size, bad, untested = _AROUND * round(sigma) + 1, np.zeros_like(whole), ~(tested | lost)
    surfaces, _ = label(whole)
    for number, box in enumerate(find_objects(surfaces), 1):
        own = surfaces[box] == number
        if not (lost[box] & own).any():
            continue
        fitting, failing = (
            uniform_filter((each[box] & own).astype(np.float64), size, mode="constant") for each in (tested, lost)
        )
        bad[box] |= own & (failing > _RESOLVED * (fitting + failing) + _ROUNDING)
    nearest = distance_transform_edt(untested, return_distances=False, return_indices=True)
    return np.asarray(bad[nearest[0], nearest[1]])


def _acceleration(
    refined: RefinedState, part: ImageStack, state: Map, where: Mask, settings: RefinedSettings
) -> tuple[Map, Map]:
    """Return the acceleration over the frames of a part, 0 where the fit fails, and its variance at the nodes."""
    step = sample_step(settings.window_sigma_px)
    if len(state) > FULL:
        return state[FULL:], refined.noise_ratio * refined.fit.variance[_STEADY:, ::step, ::step]
    group = SpanGroup(where, settings.model_copy(update={"acceleration": True}), 0)
    _, fit = fit_span(refined, group, part, state, where, (), settings.window_sigma_px)
    found = np.isfinite(fit.theta).all(axis=0)
    values = enlarged(np.where(found, fit.theta[FULL:], 0.0), step, where.shape)
    return np.where(where, values, 0.0), refined.noise_ratio * fit.variance[_STEADY:]


def _deviation(
    refined: RefinedState,
    images: ImageStack,
    frame: int,
    start: tuple[Map, Map],
    where: Mask,
    settings: RefinedSettings,
    core: Quantities,
) -> _Deviation:
    """Fit the motion from the estimated frame to a frame beyond, and compare it with that of the fit."""
    sigma, step = settings.window_sigma_px, sample_step(settings.window_sigma_px)
    nodes = slice(None, None, step), slice(None, None, step)
    pair, time = images.pair(frame), float(images.times[frame])
    group = SpanGroup(where, settings.model_copy(update={"acceleration": False}), 0)
    state, acceleration = start
    steady: Map = state[:FULL].copy()
    steady[STEADY_PLACES[1:]] += 0.5 * time * acceleration
    noise = settings.max_residual_ratio * refined.images.residual_noise(refined.fit.residual[0])
    among = where[nodes]

    def fitted(begun: Map) -> tuple[Fit, Mask]:
        theta, fit = fit_span(refined, group, pair, begun, where, (), sigma)
        # Where textures are weak, noise alone moves single windows far away.
        close = ~find_far(pair, theta[:, *nodes], fit, _BY_NOISE)
        return fit, among & close & explained(fit.residual[0], fit.residual[1], noise)

    fit, fits = fitted(steady)
    seen = among & np.isfinite(fit.residual[0])
    lost = mark_mostly(seen & ~fits, seen, _AROUND * round(sigma / step) + 1, _MOST_LOST) & ~fits
    if lost.any():
        begun = _searched(pair, time, steady, lost, step)
        other, other_fits = fitted(begun)
        with np.errstate(invalid="ignore"):
            better = other_fits & (~fits | (other.residual[0] < fit.residual[0]))
        fit, fits, seen = chosen_fit(better, other, fit), fits | other_fits, seen | np.isfinite(other.residual[0])
    made = collect_quantities(fit, refined.noise_ratio)
    change = np.where(OF_VELOCITY[:, None, None] == 1, made.values - core.values, 0.0)
    change[_VELOCITY] -= 0.5 * time * acceleration[:, *nodes]
    return _Deviation(time, time * change, time**2 * made.variances, seen, fits)


def _searched(pair: ImageStack, time: float, steady: Map, lost: Mask, step: int) -> Map:
    """Return parameters with the motion to the other frame of an exhaustive search, for the nodes of a mask."""
    frame, camera = pair.reference()
    other = 1 - frame
    cameras = [n for n, s in enumerate(pair.positions) if s[1] == pair.positions[camera, 1]]
    views = np.stack([[pair.grey(other, n, channel) for n in cameras] for channel in range(pair.channels)]).astype(
        np.float32
    )
    reference = np.stack([pair.grey(frame, camera, channel) for channel in range(pair.channels)]).astype(np.float32)
    several = len(cameras) > 1
    found = sweep_motion(
        reference,
        [views],
        [np.sign(time)],
        pair.positions[cameras, 0],
        steady[0] if several else None,
        pair.focal,
        pair.centre,
        farthest=_SEARCHED_PX,
    )
    if not found.known.any():
        return steady
    begun = steady.copy()
    velocity = fill_gaps(found.velocity, found.known) / abs(time)
    replaced = enlarged(lost, step, steady.shape[1:])
    for place, values in zip(STEADY_PLACES[1:], velocity, strict=True):
        begun[place] = np.where(replaced, values, begun[place])
        begun[place + 1 : place + 3, replaced] = 0.0
    return begun
