"""Refit at discontinuities: small windows, model selection by photo-consistency, windows without other surfaces."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined.fit_maps import (
    DISCONTINUITY_PX,
    blank_fit,
    carried,
    chosen_fit,
    differ,
    explained,
    extract_fields,
    find_discontinuities,
    find_mixed_pixels,
    initial_parameters,
    with_bias,
)
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.initialisation import fill_gaps
from scenetruth.estimators.refined.iterations import (
    STAGES,
    RefinedState,
    fill_invalid_parameters,
    fit_round,
    is_valid_step,
    select_models,
)
from scenetruth.estimators.refined.kernels.photo_consistency import SIDES, hide, judge_rows
from scenetruth.estimators.refined.kernels.warp import ImageView, image_parts, warp_rows
from scenetruth.estimators.refined.kernels.window_solver import Fit, Model
from scenetruth.estimators.refined.kernels.window_sums import solve_members
from scenetruth.estimators.refined.motion_model_selection import (
    MotionModelTrial,
    choose_motion_model,
    encode_motion_models,
    list_motion_models,
)
from scenetruth.estimators.refined.noise_estimation import estimate_noise, spline_transfer, textured
from scenetruth.estimators.refined.row_bands import (
    NO_OCCLUSION,
    PixelEvidence,
    RowBand,
    around,
    bands,
    local_means,
    pieces,
    window_weights,
)
from scenetruth.schema.variables import MOTION_PLAIN
from scenetruth.threads import in_threads

__all__ = [
    "BLOCK_PX",
    "FARTHEST",
    "DiscontinuityContext",
    "GainOffset",
    "HypothesisSelection",
    "empty_discontinuity_context",
    "estimate_gain_offset",
    "is_supported",
    "is_surrounded",
    "refit_discontinuities",
    "uniform_gain_offset",
]


BLOCK_PX = 32
"""Side length of a block in px."""
_LEAST_BLOCK_PIXELS = 64  # smallest number of pixels of a block


class GainOffset(NamedTuple):
    """Block-wise conversion of an image to the intensity of the mean image: (grey value - offset) / gain."""

    gain: NDArray[np.float32]
    """Gains, shape (n, rows of blocks, columns of blocks)."""
    offset: NDArray[np.float32]
    """Offsets in grey values, of the same shape."""


def uniform_gain_offset(count: int) -> GainOffset:
    """Return gain 1 and offset 0 for all images."""
    return GainOffset(np.ones((count, 1, 1), dtype=np.float32), np.zeros((count, 1, 1), dtype=np.float32))


def estimate_gain_offset(
    coefficients: NDArray[np.float32] | list[NDArray[np.float32]],
    view: ImageView,
    fields: NDArray[np.float64],
    bad: NDArray[np.uint8] | list[NDArray[np.uint8]],
    good: NDArray[np.bool_],
) -> GainOffset:
    """Estimate gains and offsets of the images relative to their mean by regression in blocks over ``good`` pixels."""
    count, (_, height, width) = (
        len(view.s),
        coefficients[0].shape if isinstance(coefficients, list) else coefficients.shape,
    )
    down, across = -(-height // BLOCK_PX), -(-width // BLOCK_PX)
    gain = np.full((count, down, across), np.nan, dtype=np.float32)
    offset = np.full_like(gain, np.nan)
    asked = np.where(good, fields, np.nan)
    # Excluded images have no intensity.
    parts = [(len(part), flags) for part, flags in image_parts(coefficients, bad)]
    used = np.concatenate(
        [~flags.all(axis=(1, 2)) if len(flags) else np.ones(size, dtype=np.bool_) for size, flags in parts]
    )
    some_bad = any(len(flags) for _, flags in parts)

    def regress(block: int) -> None:
        first = block * BLOCK_PX
        rows = min(BLOCK_PX, height - first)
        warped = np.empty((count, rows, width), dtype=np.float32)
        gradient = np.empty((2, rows, width), dtype=np.float32)
        warp_rows(coefficients, view, asked, NO_OCCLUSION, bad, first, warped, gradient, (0, rows))
        for column in range(across):
            part = warped[:, :, column * BLOCK_PX : (column + 1) * BLOCK_PX].reshape(count, -1).astype(np.float64)
            found = _in_block(part[used], some_bad=some_bad)
            if found is not None:
                gain[used, block, column], offset[used, block, column] = found

    in_threads(regress, range(down))
    gain[~used], offset[~used] = 1.0, 0.0
    known = np.isfinite(gain).all(axis=0) & (gain > 0.1).all(axis=0)
    if not known.any():
        return uniform_gain_offset(count)
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return GainOffset(*(np.ascontiguousarray(values[:, nearest[0], nearest[1]]) for values in (gain, offset)))


def _in_block(values: NDArray[np.float64], *, some_bad: bool) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return gains and offsets of images relative to their mean, from grey values (n, pixels), NaN where invalid."""
    known = np.isfinite(values)
    # Pixels visible in all images have a common texture; with defective pixels, every image has its own valid pixels.
    values = values[:, known.mean(axis=0) >= 0.5 if some_bad else known.all(axis=0)]
    known = np.isfinite(values)
    counts = known.sum(axis=1)
    if counts.min(initial=values.shape[1]) < _LEAST_BLOCK_PIXELS:
        return None
    means = np.where(known, values, 0.0).sum(axis=1) / counts
    around = np.where(known, values - means[:, None], 0.0)
    texture = around.sum(axis=0) / known.sum(axis=0)
    # Over the valid pixels of each image.
    middle = known @ texture / counts
    squares = known @ texture**2 - counts * middle**2
    if squares.min(initial=np.inf) <= 0:
        return None
    gain = (around @ texture) / squares
    return gain, means - gain * (middle + means.mean())


Map = NDArray[np.float64]

_SIDE_COST = 1.05  # ratio by which the images of one side must agree better than all images
_LEAST_JUDGED_SHARE = 0.3  # smallest fraction of the neighbourhood of a pixel with a valid cost
_SAME_MODEL_PX = 1e-3  # models that displace a point by less than this in all images have the same residual
_DIFFERENT_PX = 0.5  # models that displace a point by more than this in any image belong to different surfaces


class HypothesisSelection:
    """Selection of the best model of every pixel by photo-consistency, where ``where`` (y, x) is set.

    ``theta``: Initial parameters, shape (15 or 18, y, x).
    ``noise``: Standard deviation of the residual due to noise alone.
    ``steady``: Pixels from which image intensities are estimated, shape (y, x); None for equal intensities.
    """

    def __init__(
        self,
        images: ImageStack,
        theta: Map,
        where: NDArray[np.bool_],
        noise: float,
        steady: NDArray[np.bool_] | None = None,
    ) -> None:
        self._images, self._where, self._square = images, where, noise**2
        self._stacks = [images.stack(channel) for channel in range(images.channels)]
        self._bad = images.bad_stack()
        view, fields = images.view(), np.ascontiguousarray(extract_fields(theta))
        self._brightness = [
            uniform_gain_offset(len(view.s))
            if steady is None
            else estimate_gain_offset(stack, view, fields, self._bad, steady)
            for stack in self._stacks
        ]
        self.theta = theta.copy()
        self._sides = self._variances(np.where(where, fields, np.nan))
        self.cost = self._cost(self._sides)
        """Residual of the selected model, in squares of the noise."""
        self.rival = np.full(images.shape, np.inf, dtype=np.float32)
        """Smallest residual of any other model that belongs to another surface."""

    def offer(self, theta: Map) -> None:
        """Select models where they explain the images better; parameters are (15 or 18, y, x), NaN where invalid."""
        fields = extract_fields(theta)
        with np.errstate(invalid="ignore"):
            moved = self._images.moved_px(extract_fields(self.theta), fields)
            other = ~(moved <= _DIFFERENT_PX)
            # Models that agree with those selected have the same residual.
            new = self._where & ~(moved <= _SAME_MODEL_PX)
            if not new.any():
                return
            sides = np.where(new, self._variances(np.where(new, fields, np.nan)), self._sides)
            cost = self._cost(sides)
            # The margin covers the effect of noise: of equivalent models, the earlier one remains.
            better = cost < self.cost - 0.03
        worse = np.where(better, self.cost, cost)
        self.rival[other] = np.minimum(self.rival, worse)[other]
        self.theta[:, better] = theta[:, better]
        self.cost[better] = cost[better]
        self._sides[:, better] = sides[:, better]

    def spread(self, distance: int) -> None:
        """Try the models of the eight pixels at a distance, at every pixel."""
        for down in (-distance, 0, distance):
            for right in (-distance, 0, distance):
                if right or down:
                    self.offer(carried(self.theta, right, down))

    def _variances(self, fields: Map) -> NDArray[np.float32]:
        """Return the variances of the images of `SIDES` for fields, NaN where not wanted."""
        sides = np.empty((SIDES, *self._images.shape), dtype=np.float32)
        fields = np.ascontiguousarray(fields)
        if len(self._stacks) == 1:
            self._judge(0, fields, sides)
            return sides
        total = np.zeros_like(sides)
        for channel in range(len(self._stacks)):
            self._judge(channel, fields, sides)
            total += sides / len(self._stacks)
        return total

    def _judge(self, channel: int, fields: Map, out: NDArray[np.float32]) -> None:
        stack, brightness = self._stacks[channel], self._brightness[channel]
        judge = partial(judge_rows, stack, self._images.view(), fields, self._bad, *brightness, BLOCK_PX, out)
        in_threads(judge, pieces(0, self._images.shape[0]))

    def _cost(self, sides: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the residual over every pixel and its neighbours, in squares of the noise."""
        best = np.full(self._images.shape, np.inf, dtype=np.float32)
        for side in range(SIDES):
            known = np.isfinite(sides[side])
            share = local_means(known.astype(np.float32))
            mean = local_means(np.where(known, sides[side], np.float32(0.0))) / np.maximum(share, _LEAST_JUDGED_SHARE)
            cost = np.where(share > _LEAST_JUDGED_SHARE, mean, np.inf) * (1.0 if side == 0 else _SIDE_COST)
            best = np.minimum(best, cost / self._square)
        return best


Mask = NDArray[np.bool_]

# Largest residual of a pixel explained by a surface: this multiple of the noise, or the effect of this shift in px.
_NOISES, _SHIFT_PX = 1.3, 0.2
# Standard deviations of the initial and of the final windows, relative to that of the full windows.
_SMALL, _FINAL = 0.4, 2 / 3
_LEAST_SIGMA_PX = 1.5
# Points whose disparities differ by less than this at the farthest camera do not occlude each other.
_SAME_PX = 0.75
_ROUNDS = 2
# Distance, in half-widths of the full window, over which richer motion models are tried.
_REACH_HALF_WINDOWS = 2
_PIXELS = 2000
# Smallest fraction of the images in which a pixel is visible; smallest valid fraction of a window; and largest distance
# of the texture centroid from the window centre in standard deviations: at a straight outline it is 0.8.
_LEAST_IMAGES, _LEAST_SHARE, FARTHEST = 0.25, 0.25, 0.9
# Distance in px from an outline within which the pixels of the nearer surface are not part of any window: blur extends
# the surface by one pixel, and its grey values are a mixture up to two pixels inside.
_BLENDED_PX = 3

# Windows with two surfaces fit a steep one between them, and leave a residual. Near outlines: largest tangent of the
# tilt; and largest product of it and the residual, relative to noise, if the residual exceeds this ratio.
_STEEPEST, _STEEP, _RESIDUAL_OF_STEEP = 3.0, 2.5, 1.5

# Distance in px at which texture must lie in each of several directions, and its smallest mean square gradient relative
# to the largest one there: at this distance from an outline, 3 % of its square remains in a neighbourhood.
_ON_ALL_SIDES_PX, _DIRECTIONS, _OF_STRONGEST, _CUT = 3.0, 8, 0.03, 2.0

# Distance in px of the neighbours that support a pixel, smallest fraction of them, and largest difference of their
# disparities, in px for images without noise, and in standard deviations: windows that overlap by most of their pixels
# share their noise, so that this is three standard deviations of the difference.
_NEIGHBOURS_PX, _SUPPORT, _ALIKE_PX, _ALIKE_STD = 3, 1 / 3, 5e-3, 2.0


@dataclass(frozen=True, eq=False)
class DiscontinuityContext:
    """Pixels near discontinuities."""

    where: Mask
    """Pixels whose windows contain a discontinuity, or a residual that one motion does not explain, shape (y, x)."""
    sound: Mask
    """Those of them with a valid fit of their own surface."""


def empty_discontinuity_context(shape: tuple[int, int]) -> DiscontinuityContext:
    """Return a context without pixels near discontinuities."""
    return DiscontinuityContext(np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_))


def refit_discontinuities(
    images: ImageStack,
    start: Map,
    refined: RefinedState,
    settings: RefinedSettings,
    report: Callable[[int], None] | None = None,
) -> tuple[RefinedState, DiscontinuityContext]:
    """Fit pixels again whose windows contain several surfaces, from disparity and velocity of shape (4, y, x)."""
    noise = estimate_noise(np.sqrt(refined.fit.residual[0]))
    sigma = settings.window_sigma_px
    whole = refined.fit.theta
    reach = window_weights(sigma).shape[2] // 2
    where = around(_unexplained(refined.seen, noise) | find_discontinuities(images, whole), reach) | refined.uneven
    # Windows without texture determine no surface.
    contrast = noise / spline_transfer(images.spline)
    where &= textured(refined.fit.residual[1], contrast, images.count, images.spline) | np.isnan(whole[0])
    if not where.any() or not np.isfinite(noise):
        return refined, DiscontinuityContext(where, np.zeros_like(where))
    steady = ~where if settings.photometric_model == "per_image" else None
    selection = HypothesisSelection(images.few(), whole, where, noise, steady)
    selection.offer(_small_windows(images, start, where, settings))
    for distance in sorted({round(1.6 * sigma), round(sigma), round(sigma / 2), 2, 1} - {0}, reverse=True):
        selection.spread(distance)
    theta = fill_invalid_parameters(fill_gaps(whole, np.asarray(np.isfinite(whole).all(axis=0))), selection.theta)
    found = _refit(images, theta, where, noise, settings)
    found, motion = _refit_motion_models(images, found, where, refined.motion, noise, settings)
    fit, seen, shares = found.fit, found.seen, found.shares
    # Full windows are kept where their result is the same, because their noise is the smallest.
    # Strong gradients of an outline would explain any residual of a weak texture next to it.
    with np.errstate(invalid="ignore"):
        fitted = refined.fit.residual[0] <= (settings.max_residual_ratio * noise) ** 2
    surrounded = is_surrounded(refined.seen.gradient.astype(np.float64), _final_sigma(sigma))
    where = where & (refined.uneven | ~fitted | differ(refined.fit, fit, sigma / 2, motion=True))
    final = chosen_fit(where, fit, refined.fit)
    own = textured(seen.gradient.astype(np.float64), noise, images.count, images.spline)
    sound = (
        where
        & explained(seen.square, seen.gradient, settings.max_residual_ratio * noise)
        & (shares[0] > _LEAST_SHARE)
        & (own | (shares[1] < FARTHEST * _final_sigma(sigma)))
        & surrounded
    )
    sound &= ~find_mixed_pixels(images, np.where(where, final.theta, whole), seen.gradient)
    sound &= ~(around(where & ~sound, round(sigma)) & _is_steep(final.theta, images.focal, seen.square / noise**2))
    if images.farthest > 0.0:
        sound &= is_supported(final, sound | (~where & np.isfinite(final.theta[0])))
    lit = where & _unevenly_lit(images, np.where(where, final.theta, whole), seen, noise, sigma)
    final = _add_light_bias(images, final, lit, noise)
    motion = np.where(where, motion, refined.motion)
    where |= ~surrounded
    result = replace(refined, fit=final, curved=refined.curved & ~where, motion=motion)
    return result, DiscontinuityContext(where, sound)


def _is_steep(theta: Map, focal: float, square: NDArray[Any]) -> Mask:
    """Return where a surface is seen at a grazing angle, or tilted with a residual.

    ``square``: Mean square residual of every pixel relative to noise.
    """
    with np.errstate(invalid="ignore"):
        tilt, ratio = focal * np.hypot(theta[1], theta[2]) / np.abs(theta[0]), np.sqrt(square)
        return np.asarray(np.where(ratio > _RESIDUAL_OF_STEEP, tilt * ratio > _STEEP, tilt > _STEEPEST))


def _unevenly_lit(images: ImageStack, theta: Map, seen: PixelEvidence, noise: float, sigma: float) -> Mask:
    """Return the pixels whose windows contain unexplained residuals that no discontinuity causes, as moving shadows."""
    left = _unexplained(seen, noise) & np.isfinite(seen.square)
    left &= ~around(find_discontinuities(images, theta), _BLENDED_PX)
    return around(left, window_weights(_final_sigma(sigma)).shape[2])


def _add_light_bias(images: ImageStack, fit: Fit, where: Mask, noise: float) -> Fit:
    """Return a fit with the error of velocities that changes of light within the windows cause, in its variances.

    One gain and one offset for a window leave residuals, which displace the texture by at most their ratio to its
    gradient; a velocity is that displacement over the root mean square of the times.
    """
    if images.longest == 0.0:
        return fit
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = np.maximum(fit.residual[0] - noise**2, 0.0) / fit.residual[1]
        error = shift / (fit.theta[0] ** 2 * np.mean(images.times**2))
    variance = fit.variance.copy()
    variance[3:5] += np.where(where & np.isfinite(error), error, 0.0)
    return fit._replace(variance=variance)


def _unexplained(seen: PixelEvidence, noise: float) -> Mask:
    return np.asarray(seen.square > _compute_residual_limit(seen.gradient, noise))


def _compute_residual_limit(gradient: NDArray[Any], noise: float) -> Map:
    """Return the largest mean square residual of a pixel that is explained."""
    return np.maximum((_NOISES * noise) ** 2, _SHIFT_PX**2 * gradient.astype(np.float64))


def is_surrounded(gradient: Map, sigma: float) -> Mask:
    """Return where texture lies on all sides of a pixel; beyond an outline before a blank surface, it lies on one side.

    In each direction, either the adjacent texture or that of a window farther away must not be much weaker than the
    strongest one: the blank parts of a texture, as the inside of printed squares, are smaller.

    ``gradient``: Mean square texture gradient of the neighbourhood of every pixel, shape (y, x).
    ``sigma``: Standard deviation of the window, which lies beyond the adjacent texture.
    """
    from scipy.ndimage import gaussian_filter, maximum_filter, shift

    wide = gaussian_filter(gradient, sigma, truncate=_CUT)
    far = _ON_ALL_SIDES_PX + _CUT * sigma
    limits = [
        _OF_STRONGEST * maximum_filter(values, 2 * round(distance) + 1)
        for values, distance in ((gradient, _ON_ALL_SIDES_PX), (wide, far))
    ]
    found = np.ones(gradient.shape, dtype=np.bool_)
    for angle in np.arange(_DIRECTIONS) * 2.0 * np.pi / _DIRECTIONS:
        direction = np.array([np.sin(angle), np.cos(angle)])
        close, distant = (
            shift(values, np.rint(distance * direction), order=0, mode="nearest")
            for values, distance in ((gradient, _ON_ALL_SIDES_PX), (wide, far))
        )
        found &= (close > limits[0]) | (distant > limits[1])
    return found


def is_supported(fit: Fit, sound: Mask) -> Mask:
    """Return where enough of the neighbours have the same disparity within their noise, extrapolated along slopes.

    At a straight outline half of the neighbours belong to the surface of a pixel, at a right angle a quarter and the
    pixels along both sides: a third. Pixels whose windows mix two surfaces have disparities of their own.
    """
    found = np.zeros(sound.shape)
    values = np.where(sound, fit.theta[:3], np.nan)
    variance = fit.variance[0]
    height, width = sound.shape
    reach = _NEIGHBOURS_PX
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            if down == 0 == right:
                continue
            rows, columns = (
                (slice(max(step, 0), size + min(step, 0)), slice(max(-step, 0), size + min(-step, 0)))
                for step, size in ((down, height), (right, width))
            )
            here, there = (rows[0], columns[0]), (rows[1], columns[1])
            d, d_x, d_y = values[:, there[0], there[1]]
            with np.errstate(invalid="ignore"):
                off = d + d_x * right + d_y * down - fit.theta[0][here]
                limit = _ALIKE_STD**2 * np.minimum(variance[here], variance[there]) + _ALIKE_PX**2
                found[here] += off**2 <= limit
    return np.asarray(found >= _SUPPORT * ((2 * reach + 1) ** 2 - 1))


def _final_sigma(sigma: float) -> float:
    return max(_LEAST_SIGMA_PX, _FINAL * sigma)


def _plain(images: ImageStack, settings: RefinedSettings) -> Model:
    """Return the model of small windows, without curvature."""
    return select_models(images, settings)[0]


def _small_windows(images: ImageStack, start: Map, where: Mask, settings: RefinedSettings) -> Map:
    """Fit small windows with a single velocity each, with frames added in stages."""
    model = _plain(images, settings)
    model = model._replace(gradient=0) if model.surface > 0 else model
    sigma, gains = max(_LEAST_SIGMA_PX, _SMALL * settings.window_sigma_px), settings.photometric_model == "per_image"
    state = initial_parameters(start, accelerated=settings.accelerated)
    steady = model._replace(accelerated=False)
    stages = [(images.within(reach), steady) for reach in STAGES if reach < images.longest]
    fit = None
    for part, each in [*stages, (images, model), (images, model)]:
        (fit,) = fit_round(part, np.where(where, state, np.nan), [each], sigma, gains=gains)
        state = fill_invalid_parameters(state, fit.theta)
    assert fit is not None
    return fit.theta


@dataclass(frozen=True, eq=False)
class _Refit:
    """Fits to the pixels of the central surface of each window."""

    fit: Fit
    seen: PixelEvidence
    """Residual and gradient of every pixel by itself."""
    shares: Map
    """Valid fraction of every window, and distance of the texture centroid from its centre, shape (2, y, x)."""


def _refit_motion_models(
    images: ImageStack, found: _Refit, where: Mask, beside: NDArray[np.int8], noise: float, settings: RefinedSettings
) -> tuple[_Refit, NDArray[np.int8]]:
    """Fit the motion models of nearby full windows where they are not the plain one; return the fit and the models."""
    known = np.asarray(np.isfinite(found.fit.theta).all(axis=0))
    reach = _REACH_HALF_WINDOWS * (window_weights(settings.window_sigma_px).shape[2] // 2)
    near = {
        motion: where & known & around(beside == motion.number, reach)
        for motion in list_motion_models(images, settings)
    }
    richer = [motion for motion, tried in near.items() if tried.any()]
    if not richer:
        return found, np.full(images.shape, MOTION_PLAIN, dtype=np.int8)
    seen, shares = found.seen, found.shares

    def trials() -> Iterator[MotionModelTrial]:
        theta = fill_gaps(found.fit.theta, known)
        for motion in richer:
            theta = motion.begun(theta)
            made = _refit(motion.images, theta, near[motion], noise, motion.settings)
            theta = np.where(near[motion] & is_valid_step(theta, made.fit.theta), made.fit.theta, theta)

            def take(other: Mask, made: _Refit = made) -> None:
                nonlocal seen, shares
                seen, shares = seen.chosen(other, made.seen), np.where(other, made.shares, shares)

            yield MotionModelTrial(made.fit, motion.images is images, take)

    sigma = _final_sigma(settings.window_sigma_px)
    tried = [near[motion] for motion in richer]
    fit, which = choose_motion_model(found.fit, trials(), tried, sigma, settings.max_residual_ratio * noise)
    return _Refit(fit, seen, shares), encode_motion_models(which, richer)


def _refit(images: ImageStack, theta: Map, where: Mask, noise: float, settings: RefinedSettings) -> _Refit:
    sigma, finer = (max(_LEAST_SIGMA_PX, share * settings.window_sigma_px) for share in (_FINAL, _SMALL))
    gains = settings.photometric_model == "per_image"
    shares = np.full((2, *images.shape), np.nan)
    seen, model = PixelEvidence.blank(images.shape), _plain(images, settings)
    reach = 3 * (window_weights(sigma).shape[2] // 2)
    fit = fine = blank_fit(theta, variances=True)
    for number in range(_ROUNDS):
        fields = np.ascontiguousarray(extract_fields(theta))
        hidden = _hidden(images, fields)
        if hidden.size:
            hidden[:, find_mixed_pixels(images, theta, distance=_BLENDED_PX)] = 255
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
        theta = np.where(where & is_valid_step(theta, fit.theta), fit.theta, theta)
    uneven = differ(fit, fine, finer, motion=True)
    return _Refit(chosen_fit(uneven, with_bias(fine, fit, finer, sigma), fit), seen, shares)


def _solve(
    images: ImageStack, band: RowBand, fields: Map, noise: float, sigma: float, model: Model, fit: Fit, where: Mask
) -> Map:
    """Fit the windows around the pixels of a band, and return the output of `solve_members`."""
    pixels = np.argwhere(where)
    found = np.empty((len(pixels), 2))
    limit = _compute_residual_limit(band.gradient, noise)
    reach = np.array([images.farthest, images.longest, images.aside, DISCONTINUITY_PX])
    fixed = band.by_pixel, limit, fields, reach, window_weights(sigma), model, images.view(), band.first, fit
    solve = partial(solve_members, *fixed, pixels, found)
    in_threads(solve, [(n, min(n + _PIXELS, len(pixels))) for n in range(0, len(pixels), _PIXELS)])
    return found.T


def _hidden(images: ImageStack, fields: Map) -> NDArray[np.uint8]:
    """Return the images in which each pixel is occluded, as bits; empty for one camera."""
    if images.farthest == 0.0:
        return NO_OCCLUSION
    view = images.view()
    hidden = np.empty((-(-len(view.s) // 8), *images.shape), dtype=np.uint8)
    in_threads(partial(hide, view, fields, _SAME_PX / images.farthest, hidden), range(len(hidden)))
    return hidden
