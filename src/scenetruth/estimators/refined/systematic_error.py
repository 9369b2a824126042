"""Systematic errors of the fits: changes with shorter spans of frames and with smaller windows, beyond noise.

A steady or uniformly accelerated motion over all frames, and a surface of first or second order in a window, are
approximations. Their errors are powers of the span and of the window width, so that they follow from the change
between two spans or widths (Richardson extrapolation). They are added to the variances; where they are large,
fewer frames are fitted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.method_settings import LEAST_ACCELERATED, RefinedSettings
from scenetruth.estimators.refined.fit_maps import (
    STEADY_PLACES,
    accelerated,
    chosen_fit,
    explained,
    extract_fields,
    find_discontinuities,
)
from scenetruth.estimators.refined.growth_comparison import compare_growth
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.initialisation import fill_gaps
from scenetruth.estimators.refined.iterations import RefinedState, fit_final, fit_round, is_valid_step, select_models
from scenetruth.estimators.refined.kernels.window_solver import EVERY_VARIANCE, FULL, TOLD, Fit
from scenetruth.estimators.refined.kernels.window_sums import NO_MODEL
from scenetruth.estimators.refined.lattice import sample_step
from scenetruth.estimators.refined.model_tests import (
    Alternative,
    Linearisation,
    at_nodes,
    enlarged,
    find_far,
    large_areas,
    of_nearest_node,
)
from scenetruth.estimators.refined.row_bands import around, mark_mostly, window_weights
from scenetruth.estimators.refined.surface_changes import fit_linear_changes
from scenetruth.schema.variables import MOTION_ACCELERATED, MOTION_ACCELERATED_IN_PART, MOTION_PLAIN

__all__ = [
    "LARGEST_UNTESTED",
    "OF_VELOCITY",
    "Quantities",
    "SpanGroup",
    "SystematicErrors",
    "add_contradiction",
    "change_at_scales",
    "collect_quantities",
    "estimate_systematic_errors",
    "extrapolation_share",
    "find_likely_changes",
    "fit_span",
    "list_alternatives",
    "list_spans",
    "mean_change",
    "polynomial_bias",
    "sees_second_camera",
]

# A mean change is significant from this number of its standard deviations: 1.2 % of the areas exceed it by chance.
_SIGNIFICANT = 2.5
# Standard deviation of the mean change from which still fewer frames are tried.
_LARGE = 5.0
# Distance in window widths over which such a change of velocity may be hidden by noise on the same surface.
_SPREAD = 8
# Changes are averaged over this multiple of the window's standard deviation: motions and surfaces change over larger
# distances than a window, and the noise of the mean decreases.
_WIDER = 2.0
_FINER = 0.5  # relative width of the smaller windows
_MOST_SHARE = 4.0  # largest extrapolation: biases of nearly equal spans differ by noise alone
_SETTLED_PX = 0.05  # displacement of points below which a fit to fewer frames has converged
_MOST_FAR = 0.02  # fraction of the windows that may be farther away: at discontinuities, some never converge
_AROUND = 8  # side of the surroundings in which they are counted, in units of the window's σ
_ROUNDS = 4  # largest number of iterations of a fit to fewer frames
# Sum of the variances of disparity and velocity, relative to noise, that fewer frames must reduce by this ratio: the
# selection follows noise where both are alike.
_BETTER = 0.8
# A fit to all frames whose residual is below this multiple of the noise explains them; velocities of fewer frames that
# differ from it by more than this many px per frame contradict it.
_EXPLAINED, _CONTRADICTION_PX = 1.3, 0.1
_STATED = 10  # quantities of the surface element with a systematic error: all but the direction of growth
_STEADY = int(np.count_nonzero(TOLD < FULL))
_VELOCITY = 3  # first variance of the velocity

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


def list_spans(images: ImageStack) -> list[ImageStack]:
    """Return the images of all frames, and of ever shorter spans, halved until the adjacent frames remain."""
    spans = [images]
    reach = images.longest
    while reach > 1.0:
        reach = float(math.ceil(reach / 2))
        part = images.within(reach)
        if 1 < len(part.times) < len(spans[-1].times):
            spans.append(part)
    return spans


def polynomial_bias(times: NDArray[np.float64], power: int, *, accelerated: bool) -> NDArray[np.float64]:
    """Return the errors of position and velocity at time 0 that a term t^n / n! of the position causes."""
    design = np.stack([times**k / math.factorial(k) for k in range(3 if accelerated else 2)], axis=1)
    found, *_ = np.linalg.lstsq(design, times**power / math.factorial(power), rcond=None)
    return np.asarray(found[:2])


def extrapolation_share(
    longer: NDArray[np.float64], shorter: NDArray[np.float64], *, accelerated: bool
) -> NDArray[np.float64]:
    """Return the bias of the longer span relative to the change between both, for position and velocity.

    The two lowest powers of time that the model does not contain are considered, and the larger share is returned.
    """
    first = 3 if accelerated else 2
    shares = np.ones(2)
    for power in (first, first + 1):
        long, short = (polynomial_bias(times, power, accelerated=accelerated) for times in (longer, shorter))
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(np.abs(long - short) > 1e-6, np.abs(long / (long - short)), 1.0)
        shares = np.maximum(shares, np.minimum(share, _MOST_SHARE))
    return shares


class Quantities(NamedTuple):
    """Values and variances of all quantities with a standard deviation, on a grid."""

    values: Map
    variances: Map
    fields: int
    """Number of parameters of the fit; quantities of the surface element follow."""


def collect_quantities(fit: Fit, noise_ratio: float = 1.0) -> Quantities:
    """Return all quantities of a fit that have a standard deviation, except the acceleration.

    ``noise_ratio``: Variance by noise relative to that which the fit states.
    """
    values = np.concatenate([fit.theta[TOLD[:_STEADY]], fit.element[:_STATED]])
    variances = np.concatenate([fit.variance[:_STEADY], fit.element_variance[:_STATED]])
    return Quantities(values, noise_ratio * variances.astype(np.float64), _STEADY)


OF_VELOCITY = np.array([0, 0, 0, 1, 1, 1, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1], dtype=np.intp)
"""Whether a quantity changes with the velocity, in the order of `collect_quantities`."""


@dataclass(frozen=True, eq=False)
class SystematicErrors:
    """Squares of the systematic errors of the quantities of a fit, shape (16, y, x)."""

    square: NDArray[np.floating[Any]]
    """At every pixel, of the fit that was selected."""
    of_span: NDArray[np.floating[Any]]
    """Those due to the span of frames alone, before fewer frames were selected."""
    whole: Mask
    """Pixels whose windows contain a single surface; at all others the errors are 0."""
    theta: Map
    """Parameters of the fits, shape (15, y, x)."""

    def added(self, fit: Fit, near: Mask, noise_ratio: float = 1.0) -> Fit:
        """Return a fit with the errors in its variances, which maps multiply by ``noise_ratio``.

        In the mask ``near``, smaller windows of all frames were fitted to the central surface: they have the errors of
        the frames at the nearest pixel of the same surface.
        """
        square = np.where(near, 0.0, self.square)
        left = (near | ~self.whole) & np.isfinite(fit.theta).all(axis=0)
        if left.any() and self.whole.any():
            square[:, left] = self._of_nearest_surface(fit.theta, left, near)
        variance, element = fit.variance.copy(), fit.element_variance.copy()
        variance[:_STEADY] += square[:_STEADY] / noise_ratio
        element[:_STATED] += (square[_STEADY:] / noise_ratio).astype(np.float32)
        return fit._replace(variance=variance, element_variance=element)

    def _of_nearest_surface(self, theta: Map, left: Mask, near: Mask) -> Map:
        """Return the errors at pixels from the connected area whose plane continues to them best, shape (16, n)."""
        from scipy.ndimage import distance_transform_edt, label

        areas, _ = label(self.whole)
        sizes = np.bincount(areas.ravel())
        sizes[0] = 0
        rows, columns = np.nonzero(left)
        closest = np.full(rows.size, np.inf)
        found = np.zeros((len(self.square), rows.size))
        for area in np.argsort(sizes)[::-1][:_AREAS]:
            if sizes[area] == 0:
                break
            at = distance_transform_edt(areas != area, return_distances=False, return_indices=True)[:, rows, columns]
            down, right = rows - at[0], columns - at[1]
            own = self.theta[:, at[0], at[1]]
            off = np.abs(own[0] + own[1] * right + own[2] * down - theta[0, rows, columns])
            # Of equal planes the nearer area: a pixel of distance counts as much as its share of the disparity.
            off += _PER_PIXEL * np.abs(own[0]) * np.hypot(down, right)
            better = off < closest
            closest = np.where(better, off, closest)
            beside = np.where(near[rows, columns], self.of_span[:, at[0], at[1]], self.square[:, at[0], at[1]])
            found = np.where(better, beside, found)
        return found


def sees_second_camera(images: ImageStack, theta: Map, sigma_px: float) -> Mask:
    """Return where at least half of the window is inside the image of the second of two cameras, else everywhere.

    One camera does not determine the disparity, and the few pixels at the edge of a window that a second one sees do so
    by extrapolation only. Of three cameras, two remain.
    """
    from scipy.ndimage import gaussian_filter

    height, width = images.shape
    left, top, right_end, bottom = images.sampled_bounds
    if len(images.positions) != 2:
        return np.ones(images.shape, dtype=np.bool_)
    y, x = np.mgrid[:height, :width].astype(np.float64)
    right, down = images.positions[np.argmax(np.abs(images.positions).sum(axis=1))]
    with np.errstate(invalid="ignore"):
        at = (x, y), (x - theta[0] * right, y - theta[0] * down)
        own, inside = ((at_x >= left) & (at_x <= right_end) & (at_y >= top) & (at_y <= bottom) for at_x, at_y in at)
    known = np.isfinite(theta[0]) & own
    share = [gaussian_filter(each.astype(np.float64), sigma_px) for each in (inside & known, known)]
    return np.asarray(share[0] >= _LEAST_OF_SECOND * share[1])


_LEAST_OF_SECOND = 0.5
LARGEST_UNTESTED = 3
"""Largest number of frames that test no motion by themselves."""
# Number of connected areas, the largest first, and share of the disparity by which a pixel of distance counts.
_AREAS, _PER_PIXEL = 12, 1e-4


def estimate_systematic_errors(
    refined: RefinedState, settings: RefinedSettings
) -> tuple[RefinedState, SystematicErrors]:
    """Fit shorter spans of frames and smaller windows; return the fit with the smallest total error, and its errors."""
    images, fit = refined.images, refined.fit
    known = np.asarray(np.isfinite(fit.theta).all(axis=0))
    count = _STEADY + _STATED
    if not known.any():
        nothing = np.zeros((count, *images.shape))
        return refined, SystematicErrors(nothing, nothing, known, fit.theta[:FULL])
    sigma = settings.window_sigma_px
    reach = window_weights(sigma).shape[2] // 2
    spans, step = list_spans(images), sample_step(sigma)
    # Windows with several surfaces are fitted again. Next to invalid pixels there is no other surface, and over all
    # frames motions of the same surface by different models are far apart.
    apart = find_discontinuities(spans[-1], fit.theta) & ~around(~known, 1)
    whole = known & ~around(apart, reach) & ~refined.uneven
    state = fill_gaps(fit.theta, known)
    square, of_span = (np.zeros((count, *images.shape), dtype=np.float32) for _ in range(2))
    result, windows = refined, []
    fewer = np.zeros(images.shape, dtype=np.int8)
    for group in _groups(refined, settings, spans, whole):
        begun, linear = _linear_fits(refined, group, spans, state, sigma)
        windows.append((group.where, _window_errors(refined, group, linear[0], sigma)))
        found = _span_errors(refined, group, spans, begun, linear[1:], settings)
        result, which = _with_fewer_frames(result, group, found, spans, settings)
        fewer = np.where(group.where, which, fewer).astype(np.int8)
        for k, each in enumerate(found.squares):
            where = which == k
            square[:, where] = of_nearest_node(each, step, where)
        of_span[:, group.where] = of_nearest_node(found.of_fit, step, group.where)
    for where, each in windows:
        square[:, where] += of_nearest_node(each, step, where)
    result = replace(result, fewer=fewer if fewer.any() else None)
    return result, SystematicErrors(square, of_span, whole, state[:FULL])


@dataclass(frozen=True, eq=False)
class SpanGroup:
    """Pixels with the same motion model and span of frames."""

    where: Mask
    settings: RefinedSettings
    span: int
    """Index of the span of the present fit."""
    plain: bool = False

    def suited(self, part: ImageStack) -> RefinedSettings:
        """Return the settings for a fit to fewer frames, which may determine no acceleration."""
        bent = self.settings.accelerated and len(part.times) >= LEAST_ACCELERATED
        return self.settings.model_copy(update={"acceleration": bent})


def _groups(refined: RefinedState, settings: RefinedSettings, spans: list[ImageStack], whole: Mask) -> list[SpanGroup]:
    """Return the pixels of each motion model and span."""
    affine = settings.model_copy(update={"motion": "affine"}) if settings.motion == "auto" else settings
    counts = np.array([part.count for part in spans])
    nearest = np.argmin(np.abs(counts[:, None, None] - np.nan_to_num(refined.fit.images)), axis=0)
    found: list[SpanGroup] = []
    for number in np.unique(refined.motion[whole]):
        bent = number in (MOTION_ACCELERATED, MOTION_ACCELERATED_IN_PART)
        own = (settings if number == MOTION_PLAIN else affine).model_copy(
            update={"acceleration": bent or settings.accelerated}
        )
        where = whole & (refined.motion == number)
        if number != MOTION_ACCELERATED_IN_PART:
            found.append(SpanGroup(where, own, 0, plain=number == MOTION_PLAIN))
            continue
        parts = {span: where & (nearest == span) for span in range(1, len(spans))}
        found += [SpanGroup(part, own, span) for span, part in parts.items() if part.any()]
    return found


def list_alternatives(images: ImageStack, settings: RefinedSettings) -> list[Alternative]:
    """Return smaller windows and the next shorter span of frames, for pixels of the plain motion model."""
    where = np.zeros(images.shape, dtype=np.bool_)
    return _alternatives(SpanGroup(where, settings, 0), list_spans(images), settings.window_sigma_px)


def _alternatives(group: SpanGroup, spans: list[ImageStack], sigma: float) -> list[Alternative]:
    """Return smaller windows of the present frames, and shorter spans of frames down to the next one."""
    part, small = spans[group.span], _small(sigma)
    found = [Alternative(part, select_models(part, group.suited(part)), small, EVERY_VARIANCE)]
    return found + [_of_span(group, each, sigma) for each in spans[1 : group.span + 2]]


def _of_span(group: SpanGroup, part: ImageStack, sigma: float) -> Alternative:
    return Alternative(part, select_models(part, group.suited(part)), sigma, EVERY_VARIANCE)


def _linearisation(
    refined: RefinedState, group: SpanGroup, images: ImageStack, state: Map, where: Mask, sigma: float
) -> Linearisation:
    gains = group.settings.photometric_model == "per_image"
    return Linearisation(images, state, where, refined.curved, gains, sample_step(sigma))


def _linear_fits(
    refined: RefinedState, group: SpanGroup, spans: list[ImageStack], state: Map, sigma: float
) -> tuple[Map, Sequence[Fit]]:
    """Return the parameters of a group of pixels, and the fits of its alternatives."""
    part = spans[group.span]
    if group.suited(part).accelerated and len(state) == FULL:
        # The selected fits have no acceleration.
        state = _converged(refined, part, state, group.where, group.suited(part), sigma)
    elif group.plain and refined.linear_fits:
        return state, refined.linear_fits
    # The longest span of the alternatives.
    images = spans[min(group.span, 1)]
    at = _linearisation(refined, group, images, state, group.where, sigma)
    return state, at.fits(_alternatives(group, spans, sigma))


def mean_change(
    change: Map,
    noise: Map,
    among: Mask,
    sigma: float,
    correlated: float,
    *,
    scatter: bool = True,
    least: float = _SIGNIFICANT,
) -> tuple[Map, Map, Map]:
    """Return the squares of the systematic change, its significance, and the noise of the mean, for maps (n, y, x).

    The mean change over a wide area is compared with its noise, and so is its mean square, in which changes of both
    signs do not cancel. The noise is correlated over a window: the variance of its mean over a Gaussian of S is
    σ² / (σ² + S²) of that of a pixel, and its mean square has 1 + 2 S² / σ² degrees of freedom.

    ``correlated``: Variance of the mean relative to that of a pixel.
    ``scatter``: Whether the mean square is compared, too.
    ``least``: Standard deviations from which on a mean change is significant.
    """
    from scipy.ndimage import gaussian_filter

    wide = _WIDER * sigma
    freedom = 1.0 + 2.0 * _WIDER**2
    square, ratio = np.zeros_like(change), np.zeros_like(change)
    mean_noise = np.full_like(change, np.inf)
    for n, (each, of_noise) in enumerate(zip(change, noise, strict=True)):
        used = among & np.isfinite(each) & np.isfinite(of_noise) & (of_noise > 0)
        if not used.any():
            continue
        # By inverse variances, in units of which the squares are.
        weight = np.where(used, 1.0 / np.where(used, of_noise, 1.0), 0.0)
        share = np.maximum(gaussian_filter(used.astype(np.float64), wide, mode="constant"), 1e-3)
        total = np.maximum(gaussian_filter(weight, wide, mode="constant"), 1e-300)
        value = np.where(used, each, 0.0)
        mean = gaussian_filter(weight * value, wide, mode="constant") / total
        usual = share / total
        of_square = usual * gaussian_filter(weight * value**2, wide, mode="constant") / share
        # Fewer pixels, more noise.
        by_chance = usual * np.minimum(correlated / np.minimum(share, 1.0), 1.0)
        significant = mean**2 > least**2 * by_chance
        limit = usual * (1.0 + _SIGNIFICANT * np.sqrt(2.0 / np.maximum(freedom * share, 1.0)))
        scattered = (of_square > limit) & scatter
        square[n] = np.maximum(np.where(significant, mean**2, 0.0), np.where(scattered, of_square - usual, 0.0))
        ratio[n] = np.sqrt(np.maximum(mean**2 / np.maximum(by_chance, 1e-300), np.where(scattered, 1.0, 0.0)))
        mean_noise[n] = by_chance
    return square, ratio, mean_noise


def _noise_of_change(coarse: Quantities, fine: Quantities) -> Map:
    """Return the variance of the change between an efficient fit and one of fewer data, due to noise."""
    return np.maximum(fine.variances - coarse.variances, 0.5 * fine.variances)


def _small(sigma: float) -> float:
    """Return the width of the smaller windows."""
    return max(1.0, _FINER * sigma)


def _window_errors(refined: RefinedState, group: SpanGroup, smaller: Fit, sigma: float) -> Map:
    """Return the squares of the errors of all quantities due to the width of the windows, at the nodes."""
    step, small = sample_step(sigma), _small(sigma)
    share = sigma**2 / (sigma**2 - small**2) if small < sigma else 0.0
    fine, full = (collect_quantities(each, refined.noise_ratio) for each in (smaller, at_nodes(refined.fit, step)))
    among = group.where[::step, ::step]
    noise = _noise_of_change(full, fine)
    change, plane = fine.values - full.values, among & ~refined.curved[::step, ::step]
    square, *_ = change_at_scales(change, noise, among, sigma / step, _OF_WINDOWS)
    likely = find_likely_changes(change, noise, plane, sigma / step, _OF_WINDOWS)
    return share**2 * np.where(OF_VELOCITY[:, None, None] == 0, np.maximum(square, likely), square)


# Variance of the mean change between windows of σ and σ / 2 over a Gaussian of 2 σ, relative to that of a pixel: both
# contain the same noise, so that little remains of it; the value allows for textures of uneven contrast.
_OF_WINDOWS = 0.05
_OF_SPANS = 1.0 / (1.0 + _WIDER**2)
_COARSER = (2.0, 4.0)  # scales of averaging that show weak changes of a whole surface, in units of the usual one
_MOST = 3.0  # largest change of a pixel in their averages, in standard deviations


@dataclass(frozen=True, eq=False)
class _SpanErrors:
    """Fits of a group to each span of frames, at the nodes of the lattice."""

    squares: list[Map]
    """Squares of the systematic errors of each span, shape (16, rows, columns)."""
    variances: list[Map]
    """Their noise."""
    thetas: list[Map]
    """Parameters near each fit, at every pixel."""
    of_fit: Map
    """Squares of the systematic errors of the present fit."""
    worth: Mask
    """Where they exceed noise by far."""


def _span_errors(
    refined: RefinedState,
    group: SpanGroup,
    spans: list[ImageStack],
    state: Map,
    linear: Sequence[Fit],
    settings: RefinedSettings,
) -> _SpanErrors:
    """Fit shorter spans of frames as long as their results change by much more than noise."""
    from scipy.ndimage import binary_dilation

    sigma, step = settings.window_sigma_px, sample_step(settings.window_sigma_px)
    nodes = slice(None, None, step), slice(None, None, step)
    among = group.where[nodes]
    present = collect_quantities(at_nodes(refined.fit, step), refined.noise_ratio)
    quantities, thetas, where = [present], [state], group.where
    errors: list[Map] = [np.zeros_like(present.values)]
    times = [part.times for part in spans]
    theta, worth = state, np.zeros(among.shape, dtype=np.bool_)
    doubtful = _near_unexplained(refined, settings)[nodes] & among
    for number, part in enumerate(spans[1:]):
        theta, made = fit_span(refined, group, part, theta, where, linear[number : number + 1], sigma)
        latest = collect_quantities(made, refined.noise_ratio)
        before, n = quantities[-1], len(quantities)
        # The present fit may be that of this span.
        quantities.append(latest)
        thetas.append(theta)
        change, noise = latest.values - before.values, _noise_of_change(before, latest)
        square, ratio, of_mean = change_at_scales(change, noise, among & where[nodes], sigma / step, _OF_SPANS)
        bent = group.suited(part).accelerated
        square = _with_hidden_changes(square, ratio, of_mean)
        near_change = binary_dilation(
            ratio[_VELOCITY:_STEADY].max(axis=0) > _LARGE, iterations=_SPREAD * round(sigma / step), mask=among
        )
        if (doubtful | near_change).any():
            # Any change may be that of the motion, in addition to noise.
            mean, *_ = mean_change(change, noise, among & where[nodes], sigma / step, _OF_SPANS, least=0.0)
            hidden = (doubtful | near_change) & (OF_VELOCITY == 1)[:, None, None] & np.isfinite(of_mean)
            square = np.where(hidden, np.maximum(square, mean + of_mean), square)
        square, unsteady = _with_linear_changes(square, change, noise, among & where[nodes], sigma / step)
        share = extrapolation_share(times[n - 1], times[n], accelerated=bent)[OF_VELOCITY][:, None, None]
        errors[-1] = share**2 * square
        # Few frames are tested with those beyond: changes from fits that explain nothing are unlike their errors.
        tested = len(part.times) <= LARGEST_UNTESTED and settings.acceleration == "auto"
        of_latest = np.maximum(share - 1.0, 0.0) ** 2 * square
        errors.append(0.0 * of_latest if tested else of_latest)
        # The error of longer spans is the change to the shortest, and its own.
        for k in range(n - 1):
            change, noise = latest.values - quantities[k].values, _noise_of_change(quantities[k], latest)
            square, *_ = change_at_scales(change, noise, among & where[nodes], sigma / step, _OF_SPANS)
            square, _ = _with_linear_changes(square, change, noise, among & where[nodes], sigma / step)
            errors[k] = np.maximum(errors[k], square + np.where(unsteady, of_latest, errors[-1]))
        large = (ratio[[0, *range(_VELOCITY, _STEADY)]].max(axis=0) > _LARGE) | (n < group.span + 1)
        worth |= large & (n >= group.span + 1)
        where = group.where & enlarged((large | unsteady) & among, step, refined.images.shape)
        if not where.any():
            break
    of_fit = errors[min(group.span, len(errors) - 1)]
    return _SpanErrors(errors, [each.variances for each in quantities], thetas, of_fit, worth & among)


def change_at_scales(change: Map, noise: Map, among: Mask, sigma: float, correlated: float) -> tuple[Map, Map, Map]:
    """Return as `mean_change` the largest systematic change and significance over all scales, and the first noise.

    Of a surface that moves or is curved as a whole, noise hides less of the mean change, the larger the area. Large
    changes of single pixels do not spread over it.
    """
    square, ratio, of_mean = mean_change(change, noise, among, sigma, correlated)
    with np.errstate(invalid="ignore"):
        most = _MOST * np.sqrt(noise)
        clipped = np.clip(change, -most, most)
    for scale in _COARSER:
        less = correlated * (1.0 + _WIDER**2) / (1.0 + (scale * _WIDER) ** 2)
        coarse = mean_change(clipped, noise, among, scale * sigma, less, scatter=False)
        square, ratio = np.maximum(square, coarse[0]), np.maximum(ratio, coarse[1])
    return square, ratio, of_mean


def find_likely_changes(change: Map, noise: Map, among: Mask, sigma: float, correlated: float) -> Map:
    """Return the squares of mean changes, the largest of all scales, also if they are not significant."""
    # Surfaces are rarely planes: where noise hides their curvature, errors of planes exceed noise on average.
    found = np.zeros_like(change)
    for scale in (1.0, *_COARSER):
        less = correlated * (1.0 + _WIDER**2) / (1.0 + (scale * _WIDER) ** 2)
        found = np.maximum(found, mean_change(change, noise, among, scale * sigma, less, scatter=False, least=0.0)[0])
    return found


def _with_hidden_changes(square: Map, ratio: Map, of_mean: Map) -> Map:
    """Return squares of systematic changes, at least those that noise may hide where the velocity is unsteady.

    The direction of an unsteady motion is unknown: components whose change is below the noise of the shorter span may
    have errors that are large in comparison with the noise of the longer one.
    """
    unsteady = ratio[_VELOCITY:_STEADY].max(axis=0) > _SIGNIFICANT
    hidden = unsteady & (OF_VELOCITY == 1)[:, None, None] & np.isfinite(of_mean)
    return np.where(hidden, np.maximum(square, of_mean), square)


def _near_unexplained(refined: RefinedState, settings: RefinedSettings) -> Mask:
    """Return where the motion may be unsteady because windows of the same surface nearby do not fit it."""
    fit, sigma = refined.fit, settings.window_sigma_px
    known = np.isfinite(fit.theta[0])
    noise = settings.max_residual_ratio * refined.images.residual_noise(fit.residual[0])
    lost = known & ~explained(fit.residual[0], fit.residual[1], noise)
    reach = window_weights(sigma).shape[2] // 2
    lost &= ~around(find_discontinuities(refined.images, fit.theta) & ~around(~known, 1), reach)
    step = sample_step(sigma)
    return around(enlarged(large_areas(lost[::step, ::step], sigma / step), step, lost.shape), 2 * reach)


def _with_linear_changes(square: Map, change: Map, noise: Map, among: Mask, sigma: float) -> tuple[Map, Mask]:
    """Return squares of systematic changes, at least those of the linear change of a surface; and where it is unsteady.

    Where the velocity of a surface changes, no quantity of its motion is steady within noise.
    """
    linear = fit_linear_changes(change, noise, among, sigma)
    unsteady = linear.significant[_VELOCITY:_STEADY].any(axis=0)
    counts = linear.significant | (unsteady & (OF_VELOCITY == 1)[:, None, None])
    return np.where(counts, np.maximum(square, linear.square), square), np.asarray(unsteady)


def fit_span(
    refined: RefinedState,
    group: SpanGroup,
    part: ImageStack,
    theta: Map,
    where: Mask,
    linear: Sequence[Fit],
    sigma: float,
) -> tuple[Map, Fit]:
    """Return parameters near the fit of a span at all pixels, and the fit at the nodes.

    ``linear``: Fit at the present parameters, if it is solved already.
    """
    own, alternative, step = group.suited(part), _of_span(group, part, sigma), sample_step(sigma)
    theta = theta if own.accelerated else theta[:FULL]
    fits = linear or _linearisation(refined, group, part, theta, where, sigma).fits([alternative])
    nodes = slice(None, None, step), slice(None, None, step)
    # Single windows are far away by noise alone.
    far = large_areas(where[nodes] & find_far(part, theta[:, *nodes], fits[0]), sigma / step)
    if not far.any():
        return theta, fits[0]
    reach = window_weights(sigma).shape[2] // 2
    near = where & around(enlarged(far, step, where.shape), reach)
    theta = _converged(refined, part, theta, near, own, sigma)
    (again,) = _linearisation(refined, group, part, theta, near, sigma).fits([alternative])
    return theta, chosen_fit(near[nodes], again, fits[0])


def _converged(
    refined: RefinedState, part: ImageStack, theta: Map, where: Mask, settings: RefinedSettings, sigma: float
) -> Map:
    """Return parameters from which one iteration over fewer frames converges."""
    gains, models = settings.photometric_model == "per_image", select_models(part, settings)[:1]
    theta = accelerated(theta) if settings.accelerated else theta[:FULL]
    reach, left = window_weights(sigma).shape[2] // 2, where
    for _ in range(_ROUNDS):
        wide = around(left, reach)
        (fit,) = fit_round(part, np.where(wide, theta, np.nan), models, sigma, gains=gains, coarse=True)
        sound = wide & is_valid_step(theta, fit.theta)
        with np.errstate(invalid="ignore"):
            moved = part.moved_px(extract_fields(theta), extract_fields(fit.theta)) > _SETTLED_PX
        theta = np.where(sound, fit.theta, theta)
        left = mark_mostly(moved, sound & left, _AROUND * round(sigma) + 1, _MOST_FAR)
        if not left.any():
            break
    return theta


def add_contradiction(full: Fit, fit: Fit, where: Mask, transfer: float) -> Fit:
    """Return a fit to fewer frames, with its difference in the variances of velocity where both fits are explained.

    An unsteady motion leaves residuals over all frames. If there are none, but velocities differ by more than a tenth
    of a pixel per frame, the texture does not determine them.

    ``full``: Fit to all frames.
    ``transfer``: Ratio of the noise after interpolation to that before, whose square the variances include.
    """
    places = STEADY_PLACES[1:]
    change = fit.theta[places] - full.theta[places]
    with np.errstate(invalid="ignore"):
        moved = np.abs(fit.theta[0]) * np.hypot(change[0], change[1])
        contradicted = where & (moved > _CONTRADICTION_PX)
    variance = fit.variance.copy()
    added = (transfer * change) ** 2
    variance[3:6] = np.where(contradicted, variance[3:6] + added, variance[3:6])
    return fit._replace(variance=variance)


def _growth_bias(
    refined: RefinedState, group: SpanGroup, part: ImageStack, theta: Map, where: Mask, settings: RefinedSettings
) -> Map | None:
    """Return the bias of plain growth, in a mask that which noise of fewer frames may hide."""
    if refined.growth_bias is None or not group.plain or not where.any():
        return refined.growth_bias
    sigma, step = settings.window_sigma_px, sample_step(settings.window_sigma_px)
    both = (group.settings, group.settings.model_copy(update={"motion": "affine"}))
    affine = SpanGroup(group.where, both[1], 0)
    alternatives = [_of_span(each, part, sigma) for each in (group, affine)]
    plain, free = _linearisation(refined, group, part, theta, where, sigma).fits(alternatives)
    found = compare_growth(plain, free, sigma / step, where[::step, ::step], part.transfer)
    return np.where(where, enlarged(found.bias, step, where.shape), refined.growth_bias)


def _with_fewer_frames(
    refined: RefinedState, group: SpanGroup, found: _SpanErrors, spans: list[ImageStack], settings: RefinedSettings
) -> tuple[RefinedState, NDArray[np.intp]]:
    """Fit the span with the smallest total error at every pixel of a group; return the fit and the spans."""
    shape = refined.images.shape
    which = np.where(group.where, min(group.span, len(found.squares) - 1), -1)
    # A fixed motion applies to all frames.
    if settings.acceleration != "auto":
        return refined, which
    places = [0, *range(_VELOCITY, _STEADY)]
    usual = found.variances[0][places]
    totals = []
    for square, variance in zip(found.squares, found.variances, strict=True):
        total = ((variance + square)[places] / np.maximum(usual, 1e-300)).sum(axis=0)
        totals.append(np.where(np.isfinite(total), total, np.inf))
    step = sample_step(settings.window_sigma_px)
    at = which[::step, ::step]
    present = np.take_along_axis(np.stack(totals), np.maximum(at, 0)[None], axis=0)[0]
    best = np.argmin(totals, axis=0)
    better = found.worth & (np.min(totals, axis=0) < _BETTER * present)
    changed = group.where & enlarged(better, step, shape)
    best = enlarged(best, step, shape)
    usual_residual = refined.images.residual_noise(refined.fit.residual[0])
    with np.errstate(invalid="ignore"):
        all_fit = refined.fit.residual[0] <= (_EXPLAINED * usual_residual) ** 2
    result = refined
    for k, part in enumerate(spans[: len(totals)]):
        where = changed & (best == k) & (which != k)
        if k == 0 or not where.any():
            continue
        own = group.suited(part)
        models = select_models(part, own)
        chosen = np.where(where, refined.curved if len(models) > 1 else 0, NO_MODEL).astype(np.int8)
        theta = accelerated(found.thetas[k]) if own.accelerated else found.thetas[k]
        begun = np.where(around(where, 2 * (window_weights(settings.window_sigma_px).shape[2] // 2)), theta, np.nan)
        last = fit_final(part, begun, models, own, chosen)
        sound = where & is_valid_step(theta, last.fit.theta)
        chosen_last = add_contradiction(refined.fit, last.fit, sound & all_fit, part.transfer)
        result = replace(
            result,
            fit=chosen_fit(sound, chosen_last, result.fit),
            seen=result.seen.chosen(sound, last.seen),
            uneven=np.where(sound, last.uneven, result.uneven),
            growth_bias=_growth_bias(result, group, part, theta, sound, settings),
        )
        which = np.where(sound, k, which)
    return result, which
