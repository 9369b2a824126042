"""Refit at discontinuities: small windows, model selection by photo-consistency, windows without other surfaces."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined.fit_maps import (
    DISCONTINUITY_PX,
    STEADY_PLACES,
    VARIANCES,
    blank_fit,
    chosen_fit,
    differ,
    explained,
    extract_fields,
    find_discontinuities,
    find_mixed_pixels,
    initial_parameters,
    with_bias,
)
from scenetruth.estimators.refined.hypothesis_selection import HypothesisSelection, list_arms, split_pixels
from scenetruth.estimators.refined.image_stack import ImageStack, without_aliases
from scenetruth.estimators.refined.initialisation import fill_gaps
from scenetruth.estimators.refined.iterations import (
    STAGES,
    RefinedState,
    fill_invalid_parameters,
    fit_round,
    is_valid_step,
    select_models,
)
from scenetruth.estimators.refined.kernels.member_lattice import interpolate_members, is_node
from scenetruth.estimators.refined.kernels.photo_consistency import (
    hide,
)
from scenetruth.estimators.refined.kernels.window_solver import Fit, Model
from scenetruth.estimators.refined.kernels.window_sums import solve_members
from scenetruth.estimators.refined.motion_model_selection import (
    MotionModelTrial,
    choose_motion_model,
    encode_motion_models,
    list_motion_models,
)
from scenetruth.estimators.refined.row_bands import (
    NO_OCCLUSION,
    PixelEvidence,
    RowBand,
    around,
    bands,
    window_weights,
)
from scenetruth.schema.variables import MOTION_PLAIN
from scenetruth.threads import in_threads

__all__ = [
    "FARTHEST",
    "DiscontinuityContext",
    "continues_on_both_sides",
    "empty_discontinuity_context",
    "fill_beyond_images",
    "find_hidden",
    "is_supported",
    "is_surrounded",
    "refit_discontinuities",
]


Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Largest residual of a pixel explained by a surface: this multiple of the noise, or the effect of this shift in px.
_NOISES, _SHIFT_PX = 1.3, 0.2
# Standard deviations of the initial and of the final windows, relative to that of the full windows.
_SMALL, _FINAL = 0.4, 2 / 3
_LEAST_SIGMA_PX = 1.5
# Points whose disparities differ by less than this at the farthest camera do not occlude each other.
_SAME_PX = 0.75
# Distances over which models are tried at other pixels, in standard deviations of the full window.
_DISTANCES = (1.6, 1.0, 0.5, 1 / 6)
_ROUNDS = 2
# Distance from the corner of the images up to which half of a window is outside, in standard deviations.
_OF_CORNER = 0.6
# Largest displacement between the models of adjacent pixels that belong to one surface, and between fits to its pixels
# that vary smoothly, in px.
_ONE_SURFACE_PX, _SMOOTH_PX = 0.25, 0.05
# Distance, in half-widths of the full window, over which richer motion models are tried.
_REACH_HALF_WINDOWS = 2
_PIXELS = 1000
# Distance from the pixels up to which images are warped, in half-widths of the window; smallest standard deviation of
# windows that are interpolated.
_MARGIN, _LEAST_LATTICE_SIGMA_PX = 2.0, 2.0
# Smallest fraction of the images in which a pixel is visible; smallest valid fraction of a window; and largest distance
# of the texture centroid from the window centre in standard deviations: at a straight outline it is 0.8.
_LEAST_IMAGES, _LEAST_SHARE, FARTHEST = 0.25, 0.25, 0.9
# Distance in px from an outline within which the pixels of the nearer surface are not part of any window: blur extends
# the surface by one pixel, and its grey values are a mixture up to two pixels inside.
_BLENDED_PX = 3

# Windows with two surfaces fit a steep one between them, and leave a residual. Near outlines: largest tangent of the
# tilt; and largest product of it and the residual, relative to noise, if the residual exceeds this ratio.
_STEEPEST, _STEEP, _RESIDUAL_OF_STEEP = 3.0, 2.5, 1.5
# Ratio of the residuals of full and smaller windows from which on the latter explain the images better.
_REDUCED = 1.2
# Mean square residual by aliases, relative to noise, from which on only steps show other surfaces.
_ALIASED = 0.1
# Half-width of a strip along an outline, standard deviation of its surroundings relative to that of the window, and
# largest fraction of these that strips take: a straight one takes 0.11 of three windows of 6 px.
_STRIP_PX, _AREA, _LARGEST_DENSITY = 2, 3.0, 0.4
# A steep surface that is observed continues on both sides: distance in standard deviations of the full window, and
# largest difference from the extrapolated disparity, relative to the change that the slope predicts.
_CONTINUED_AT, _CONTINUED = 1.5, 0.3

# Distance in px at which texture must lie in each of several directions, and its smallest mean square gradient relative
# to the largest one there: at this distance from an outline, 3 % of its square remains in a neighbourhood.
_ON_ALL_SIDES_PX, _DIRECTIONS, _OF_STRONGEST, _CUT = 3.0, 8, 0.03, 2.0
# Largest ratio of the mean square gradient of noise to its mean, in a neighbourhood and in a window.
_OF_NOISE = 2.0, 1.3

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
    noise = images.residual_noise(refined.noise_residual)
    by_aliases = 0.0 if refined.alias_residual is None else refined.alias_residual[0]
    total = _with_aliases(noise, by_aliases)
    sigma = settings.window_sigma_px
    whole = refined.fit.theta
    reach = window_weights(sigma).shape[2] // 2
    shown = fill_beyond_images(images, whole, math.ceil(_OF_CORNER * sigma))
    # Full windows of these pixels lie outside, smaller windows do not; those around them contain a single surface.
    beyond = np.isnan(whole[0]) & np.isfinite(shown[0])
    outlines = find_discontinuities(images, shown)
    doubtful = (_unexplained(refined.seen, noise, by_aliases) & ~beyond) | outlines
    where = around(doubtful, reach) | beyond | refined.uneven
    # Windows without texture determine no surface.
    contrast = noise / images.transfer
    where &= images.is_textured(refined.fit.residual[1], contrast) | np.isnan(whole[0])
    if not where.any() or not np.isfinite(noise):
        return refined, DiscontinuityContext(where, np.zeros_like(where))
    steady = ~where if settings.photometric_model == "per_image" else None
    selection = HypothesisSelection(images.few(), whole, where, total, steady)
    selection.offer(_small_windows(images, start, where, settings))
    for distance in sorted({round(share * sigma) for share in _DISTANCES} - {0}, reverse=True):
        selection.spread(distance)
    theta = fill_invalid_parameters(fill_gaps(whole, np.asarray(np.isfinite(whole).all(axis=0))), selection.theta)
    del selection
    found = _refit(images, theta, where, noise, by_aliases, settings, refined.noise_ratio)
    found, motion = _refit_motion_models(images, found, refined.motion, noise, by_aliases, settings)
    fit, seen, shares = found.pixels.spread(found.fit), found.seen, found.shares
    square = without_aliases(seen.square, refined.alias_residual)
    # Full windows are kept where their result is the same, because their noise is the smallest.
    # Strong gradients of an outline would explain any residual of a weak texture next to it.
    with np.errstate(invalid="ignore"):
        fitted = refined.noise_residual <= (settings.max_residual_ratio * noise) ** 2
        # Without a discontinuity within reach, residuals that smaller windows leave, too, have other causes, as texture
        # finer than the pixels.
        other = refined.fit.residual[0] <= _REDUCED**2 * fit.residual[0]
        fitted |= other & ~around(outlines, reach)
    by_noise = images.noise_gradient(noise, of_residual=True)
    surrounded = is_surrounded(refined.seen.gradient.astype(np.float64), _final_sigma(sigma), by_noise)
    where = where & (
        refined.uneven
        | ~fitted
        | differ(refined.fit, fit, sigma / 2, motion=True, noise_ratio=refined.largest_noise_ratio)
    )
    # Small windows of aliased images differ from full windows without any other surface.
    steps = _find_outlines(images, np.where(where & np.isfinite(fit.theta[0]), fit.theta, shown), sigma)
    where &= (by_aliases <= _ALIASED * noise**2) | around(outlines | steps, reach) | beyond
    final = chosen_fit(where, fit, refined.fit)
    own = images.is_textured(seen.gradient.astype(np.float64), noise, of_residual=True)
    sound = (
        where
        & explained(square, seen.gradient, settings.max_residual_ratio * noise)
        & (shares[0] > _LEAST_SHARE)
        & (own | (shares[1] < FARTHEST * _final_sigma(sigma)))
        & surrounded
    )
    sound &= ~find_mixed_pixels(images, np.where(where, final.theta, whole), seen.gradient)
    between = _is_steep(final.theta, images.focal, square / noise**2) & ~continues_on_both_sides(final.theta, sigma)
    sound &= ~(around(where & ~sound, round(sigma)) & between)
    if images.farthest > 0.0:
        sound &= is_supported(final, sound | (~where & np.isfinite(final.theta[0])))
    lit = where & _unevenly_lit(images, np.where(where, final.theta, whole), seen, (noise, by_aliases), sigma)
    final = _add_light_bias(images, final, lit, noise**2 + by_aliases)
    final = _add_contradicted_motion(final, refined, beyond & where & (motion == MOTION_PLAIN), images)
    motion = np.where(where, motion, refined.motion)
    where |= ~surrounded
    result = replace(refined, fit=final, curved=refined.curved & ~where, motion=motion)
    return result, DiscontinuityContext(where, sound)


def fill_beyond_images(images: ImageStack, theta: Map, distance: int) -> Map:
    """Return parameters with those of the nearest valid pixel where most images end, as far as they have no lens.

    Next to these invalid pixels there is no other surface.

    ``distance``: Largest distance in px of an invalid pixel from those that fewer than half of the images show: in the
      corners, half of a window is outside.
    """
    valid = np.asarray(np.isfinite(theta).all(axis=0))
    if images.lens is not None or valid.all() or not valid.any():
        return theta
    filled, view = fill_gaps(theta, valid), images.view()
    d, q_x, q_y, q_z = extract_fields(filled)[:4]
    y, x = np.mgrid[: images.shape[0], : images.shape[1]].astype(np.float64)
    x, y = x - images.centre[0], y - images.centre[1]
    left, top, right, bottom = images.sampled_bounds
    shown = np.zeros(images.shape)
    for s, s_y, t in zip(view.s, view.s_y, view.t, strict=True):
        scale = 1.0 / (1.0 + t * d * q_z / images.focal)
        at_x = (x + d * (t * q_x - s)) * scale + images.centre[0]
        at_y = (y + d * (t * q_y - s_y)) * scale + images.centre[1]
        shown += (at_x >= left) & (at_x <= right) & (at_y >= top) & (at_y <= bottom)
    beyond = shown < 0.5 * len(view.s)
    return np.where(~valid & around(beyond, distance), filled, theta)


def _find_outlines(images: ImageStack, theta: Map, sigma: float) -> Mask:
    """Return discontinuities along lines; where they fill an area, fits to aliased images scatter."""
    from scipy.ndimage import gaussian_filter

    found = find_discontinuities(images, theta)
    density = gaussian_filter(around(found, _STRIP_PX).astype(np.float64), _AREA * sigma)
    return np.asarray(found & (density < _LARGEST_DENSITY))


def _is_steep(theta: Map, focal: float, square: NDArray[Any]) -> Mask:
    """Return where a surface is seen at a grazing angle, or tilted with a residual.

    ``square``: Mean square residual of every pixel relative to noise.
    """
    with np.errstate(invalid="ignore"):
        tilt, ratio = focal * np.hypot(theta[1], theta[2]) / np.abs(theta[0]), np.sqrt(square)
        return np.asarray(np.where(ratio > _RESIDUAL_OF_STEEP, tilt * ratio > _STEEP, tilt > _STEEPEST))


def continues_on_both_sides(theta: Map, sigma: float) -> Mask:
    """Return where the disparity changes along its slope on both sides as the fit predicts; not at the image border.

    Between two surfaces in one window, the slope ends within the window.
    """
    slope = np.hypot(theta[1], theta[2])
    at = np.indices(slope.shape)
    found = np.ones(slope.shape, dtype=np.bool_)
    with np.errstate(invalid="ignore", divide="ignore"):
        direction = np.nan_to_num(_CONTINUED_AT * sigma * np.stack([theta[2], theta[1]]) / slope)
        for sign in (-1.0, 1.0):
            there = at + np.rint(sign * direction).astype(np.intp)
            inside = np.all([(n >= 0) & (n < size) for n, size in zip(there, slope.shape, strict=True)], axis=0)
            there = np.where(inside, there, at)
            change = theta[1] * (there[1] - at[1]) + theta[2] * (there[0] - at[0])
            off = theta[0][there[0], there[1]] - theta[0] - change
            found &= inside & (np.abs(off) <= _CONTINUED * np.abs(change))
    return found


def _unevenly_lit(
    images: ImageStack, theta: Map, seen: PixelEvidence, noise: tuple[float, Map | float], sigma: float
) -> Mask:
    """Return the pixels whose windows contain unexplained residuals that no discontinuity causes, as moving shadows.

    ``noise``: Standard deviation of the noise, and mean square residual by aliases.
    """
    left = _unexplained(seen, *noise) & np.isfinite(seen.square)
    left &= ~around(find_discontinuities(images, theta), _BLENDED_PX)
    return around(left, window_weights(_final_sigma(sigma)).shape[2])


def _add_light_bias(images: ImageStack, fit: Fit, where: Mask, square: Map | float) -> Fit:
    """Return a fit with the error of velocities that changes of light within the windows cause, in its variances.

    One gain and one offset for a window leave residuals, which displace the texture by at most their ratio to its
    gradient; a velocity is that displacement over the root mean square of the times.

    ``square``: Mean square residual by noise and aliases.
    """
    if images.longest == 0.0:
        return fit
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = np.maximum(fit.residual[0] - square, 0.0) / fit.residual[1]
        error = shift / (fit.theta[0] ** 2 * np.mean(images.times**2))
    variance = fit.variance.copy()
    variance[3:5] += np.where(where & np.isfinite(error), error, 0.0)
    return fit._replace(variance=variance)


def _add_contradicted_motion(fit: Fit, refined: RefinedState, where: Mask, images: ImageStack) -> Fit:
    """Return a fit with the difference of its velocities from those of the nearest full window, in its variances.

    At the edges of the images, windows are one-sided, so that a velocity gradient that the plain model does not contain
    displaces their velocities. Its variances are enlarged where the nearest full window has another model.

    ``where``: Pixels of the plain model beyond which the images end.
    """
    from scipy.ndimage import distance_transform_edt

    valid = np.isfinite(refined.fit.theta).all(axis=0)
    if not where.any() or not valid.any():
        return fit
    rows, columns = np.nonzero(where)
    at = distance_transform_edt(~valid, return_distances=False, return_indices=True)[:, rows, columns]
    own, down, right = refined.fit.theta[:, at[0], at[1]], rows - at[0], columns - at[1]
    other = refined.motion[at[0], at[1]] != MOTION_PLAIN
    variance = fit.variance.copy()
    for k, place in enumerate(STEADY_PLACES[1:]):
        change = own[place] + own[place + 1] * right + own[place + 2] * down - fit.theta[place, rows, columns]
        added = np.where(other, (images.transfer * change) ** 2, 0.0)
        variance[3 + k, rows, columns] += added
    return fit._replace(variance=variance)


def _unexplained(seen: PixelEvidence, noise: float, by_aliases: Map | float) -> Mask:
    return np.asarray(seen.square > _compute_residual_limit(seen.gradient, noise, by_aliases))


def _compute_residual_limit(gradient: NDArray[Any], noise: float, by_aliases: Map | float) -> Map:
    """Return the largest mean square residual of a pixel that is explained, in addition to that by aliases."""
    return np.maximum((_NOISES * noise) ** 2, _SHIFT_PX**2 * gradient.astype(np.float64)) + by_aliases


def is_surrounded(gradient: Map, sigma: float, by_noise: float = 0.0) -> Mask:
    """Return where texture lies on all sides of a pixel; beyond an outline before a blank surface, it lies on one side.

    In each direction, either the adjacent texture or that of a window farther away must not be much weaker than the
    strongest one: the blank parts of a texture, as the inside of printed squares, are smaller.

    ``gradient``: Mean square texture gradient of the neighbourhood of every pixel, shape (y, x).
    ``sigma``: Standard deviation of the window, which lies beyond the adjacent texture.
    ``by_noise``: Mean square gradient that noise causes.
    """
    from scipy.ndimage import gaussian_filter, maximum_filter, shift

    wide = gaussian_filter(gradient, sigma, truncate=_CUT)
    far = _ON_ALL_SIDES_PX + _CUT * sigma
    limits = [
        _OF_STRONGEST * maximum_filter(values, 2 * round(distance) + 1)
        for values, distance in ((gradient - by_noise, _ON_ALL_SIDES_PX), (wide - by_noise, far))
    ]
    # Noise varies, more among the neighbours of a pixel than in a window.
    gradient, wide = (values - factor * by_noise for values, factor in zip((gradient, wide), _OF_NOISE, strict=True))
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
    """Fit small windows at every other row and column with a single velocity each, with frames added in stages."""
    model = _plain(images, settings)
    model = model._replace(gradient=0) if model.surface > 0 else model
    sigma, gains = max(_LEAST_SIGMA_PX, _SMALL * settings.window_sigma_px), settings.photometric_model == "per_image"
    state = initial_parameters(start, accelerated=settings.accelerated)
    steady = model._replace(accelerated=False)
    stages = [(images.within(reach), steady) for reach in STAGES if reach < images.longest]
    fit = None
    for part, each in [*stages, (images.few(), model)]:
        (fit,) = fit_round(part, np.where(where, state, np.nan), [each], sigma, gains=gains, coarse=True)
        state = fill_invalid_parameters(state, fit.theta)
    assert fit is not None
    return fit.theta


@dataclass(frozen=True, eq=False)
class _Pixels:
    """Pixels of a mask, whose fits are maps of a single row."""

    where: Mask
    at: NDArray[np.int64]
    """Rows and columns, shape (n, 2)."""
    box: tuple[slice, slice]
    """Rows and columns around the pixels, with a margin for means over windows."""

    @classmethod
    def of(cls, where: Mask, margin: int) -> _Pixels:
        """Return the pixels of a mask."""
        at = np.ascontiguousarray(np.argwhere(where))
        box = []
        for axis, size in enumerate(where.shape):
            first, last = (int(at[:, axis].min()), int(at[:, axis].max())) if len(at) else (0, 0)
            box.append(slice(max(first - margin, 0), min(last + margin + 1, size)))
        return cls(where, at, (box[0], box[1]))

    def taken(self, maps: NDArray[Any]) -> NDArray[Any]:
        """Return the values of maps (n, y, x) or (y, x) at the pixels."""
        return np.ascontiguousarray(maps[..., self.where][..., None, :])

    def spread(self, fit: Fit, box: tuple[slice, slice] | None = None) -> Fit:
        """Return a fit as maps of the image, or of its rows and columns in a box, NaN at all other pixels."""
        return Fit._make(self._maps(values, box) for values in fit)

    def compared(self, fit: Fit) -> Fit:
        """Return disparity and velocity of a fit, with their variances, as maps of the box; others have no meaning."""
        shape = self.where[self.box].shape
        theta, variance = np.empty((len(fit.theta), *shape)), np.empty((len(fit.variance), *shape))
        for place, number in zip(STEADY_PLACES, VARIANCES, strict=True):
            theta[place] = self._maps(fit.theta[place], self.box)
            variance[number] = self._maps(fit.variance[number], self.box)
        return fit._replace(theta=theta, variance=variance)

    def _maps(self, values: NDArray[Any], box: tuple[slice, slice] | None) -> NDArray[Any]:
        where = self.where if box is None else self.where[box]
        out = np.full((*values.shape[:-2], *where.shape), np.nan, dtype=values.dtype)
        inside: Any = slice(None)
        if box is not None:
            (rows, columns), (down, right) = self.at.T, box
            inside = (rows >= down.start) & (rows < down.stop) & (columns >= right.start) & (columns < right.stop)
        out[..., where] = values[..., 0, inside]
        return out


@dataclass(frozen=True, eq=False)
class _Refit:
    """Fits to the pixels of the central surface of each window."""

    pixels: _Pixels
    fit: Fit
    """Fits of the pixels, as maps of a single row."""
    theta: Map
    """Parameters without gaps, at all pixels of the image."""
    seen: PixelEvidence
    """Residual and gradient of every pixel by itself."""
    shares: Map
    """Valid fraction of every window, and distance of the texture centroid from its centre, shape (2, y, x)."""
    noise_ratio: float
    """As in `RefinedState`."""


def _refit_motion_models(
    images: ImageStack,
    found: _Refit,
    beside: NDArray[np.int8],
    noise: float,
    by_aliases: Map | float,
    settings: RefinedSettings,
) -> tuple[_Refit, NDArray[np.int8]]:
    """Fit the motion models of nearby full windows where they are not the plain one; return the fit and the models."""
    known = np.zeros(images.shape, dtype=np.bool_)
    known[found.pixels.where] = np.isfinite(found.fit.theta).all(axis=(0, 1))
    reach = _REACH_HALF_WINDOWS * (window_weights(settings.window_sigma_px).shape[2] // 2)
    near = {motion: known & around(beside == motion.number, reach) for motion in list_motion_models(images, settings)}
    richer = [motion for motion, tried in near.items() if tried.any()]
    which = np.zeros(images.shape, dtype=np.int8)
    if not richer:
        return found, encode_motion_models(which, richer)
    sigma = _final_sigma(settings.window_sigma_px)
    # Differences are averaged over twice the window.
    tried = _Pixels.of(np.logical_or.reduce([near[motion] for motion in richer]), math.ceil(8 * sigma))
    box, seen, shares = tried.box, found.seen, found.shares

    def trials() -> Iterator[MotionModelTrial]:
        theta = found.theta
        for motion in richer:
            made = _refit(
                motion.images, motion.begun(theta), near[motion], noise, by_aliases, motion.settings, found.noise_ratio
            )
            theta = made.theta

            def take(other: Mask, made: _Refit = made) -> None:
                nonlocal seen, shares
                taken = np.zeros(images.shape, dtype=np.bool_)
                taken[box] = other
                seen, shares = seen.chosen(taken, made.seen), np.where(taken, made.shares, shares)

            yield MotionModelTrial(made.pixels.spread(made.fit, box), motion.images is images, take)

    plain, among = found.pixels.spread(found.fit, box), [near[motion][box] for motion in richer]
    limit = settings.max_residual_ratio * _with_aliases(noise, by_aliases)
    fit, which[box] = choose_motion_model(plain, trials(), among, sigma, limit, noise_ratio=found.noise_ratio)
    changed = tried.where[found.pixels.where]
    for values, chosen in zip(found.fit, fit, strict=True):
        np.asarray(values)[..., 0, changed] = np.asarray(chosen)[..., tried.where[box]]
    return replace(found, seen=seen, shares=shares), encode_motion_models(which, richer)


def _refit(
    images: ImageStack,
    theta: Map,
    where: Mask,
    noise: float,
    by_aliases: Map | float,
    settings: RefinedSettings,
    noise_ratio: float,
) -> _Refit:
    """Fit the pixels of a mask from parameters (15 or 18, y, x), which are updated in place."""
    sigma, finer = (max(_LEAST_SIGMA_PX, share * settings.window_sigma_px) for share in (_FINAL, _SMALL))
    gains, model = settings.photometric_model == "per_image", _plain(images, settings)
    pixels = _Pixels.of(where, math.ceil(4 * sigma))
    shares, seen = np.full((2, *images.shape), np.nan), PixelEvidence.blank(images.shape)
    # Windows of the gains extend beyond the windows of the fit.
    near = around(where, math.ceil(_MARGIN * (window_weights(sigma).shape[2] // 2)))
    # Fewer images suffice for the first step.
    first = images if model.accelerated else images.few()
    fit = fine = blank_fit(np.zeros((len(theta), 1, 0)), variances=True)
    for number, taken in enumerate((first, images)):
        last = number == _ROUNDS - 1
        begun, fields = pixels.taken(theta), np.ascontiguousarray(extract_fields(theta))
        fit, fine = (blank_fit(begun, variances=last, element=last) for _ in range(2))
        of_windows = np.full((len(pixels.at), 2), np.nan)
        windows = [_Windows(sigma, fit, of_windows)]
        windows += [_Windows(finer, fine, np.empty_like(of_windows))] if last else []
        hidden = find_hidden(taken, fields, near)
        if hidden.size:
            hidden[:, find_mixed_pixels(taken, theta, distance=_BLENDED_PX)] = 255
        wanted = np.where(near, fields, np.nan)
        for band in bands(taken, wanted, sigma, gains=gains, least_share=_LEAST_IMAGES, hidden=hidden):
            for each in windows:
                _solve(taken, band, fields, _limit_of(band, noise, by_aliases), model, pixels, begun, each)
            if last:
                seen.put(band)
        shares[:, where] = of_windows.T
        theta[:, where] = np.where(is_valid_step(begun, fit.theta), fit.theta, begun)[:, 0]
    pair = pixels.compared(fine), pixels.compared(fit)
    inner = where[pixels.box]
    uneven = differ(pair[1], pair[0], finer, motion=True, noise_ratio=noise_ratio)[inner][None]
    biased = with_bias(*pair, finer, sigma, noise_ratio).variance
    for number in VARIANCES:
        fine.variance[number] = biased[number, inner]
    return _Refit(pixels, chosen_fit(uneven, fine, fit), theta, seen, shares, noise_ratio)


def _with_aliases(noise: float, by_aliases: Map | float) -> float:
    """Return the standard deviation of residuals by noise and aliases, over all pixels."""
    return noise if isinstance(by_aliases, float) else math.hypot(noise, math.sqrt(float(np.mean(by_aliases))))


def _limit_of(band: RowBand, noise: float, by_aliases: Map | float) -> Map:
    """Return the largest mean square residual of the pixels of a band."""
    gradient = band.gradient
    rows = by_aliases if isinstance(by_aliases, float) else by_aliases[band.first : band.first + len(gradient)]
    return _compute_residual_limit(gradient, noise, rows)


class _Windows(NamedTuple):
    """Windows of one size."""

    sigma: float
    fit: Fit
    shares: Map


def _solve(
    images: ImageStack,
    band: RowBand,
    fields: Map,
    limit: Map,
    model: Model,
    pixels: _Pixels,
    begun: Map,
    windows: _Windows,
) -> None:
    """Fit the windows around the pixels of a band, every other one of them where the fits vary smoothly."""
    reach = np.array([images.farthest, images.longest, images.aside, DISCONTINUITY_PX])
    fixed = band.by_pixel, limit, fields, reach, window_weights(windows.sigma), model, images.view(), band.first

    def solve(numbers: NDArray[np.int64]) -> None:
        solve_members(*fixed, windows.fit, pixels.at, windows.shares, numbers)

    def solve_all(numbers: NDArray[np.int64]) -> None:
        in_threads(solve, [numbers[n : n + _PIXELS] for n in range(0, len(numbers), _PIXELS)])

    inside = (pixels.at[:, 0] >= band.top) & (pixels.at[:, 0] < band.bottom)
    if windows.sigma < _LEAST_LATTICE_SIGMA_PX:
        solve_all(np.flatnonzero(inside))
        return
    nodes = inside & is_node(pixels.at)
    solve_all(np.flatnonzero(nodes))
    left = inside & ~nodes
    index = np.full(images.shape, -1, dtype=np.int32)
    index[pixels.where] = np.arange(len(pixels.at))
    nodes &= np.isfinite(windows.fit.theta[0, 0])
    arms, limits = list_arms(images, len(fields)), (_ONE_SURFACE_PX, _SMOOTH_PX)
    each = pixels.at, index, nodes, begun, windows.fit, windows.shares, arms, limits, left
    in_threads(partial(interpolate_members, *each), split_pixels(len(pixels.at)))
    solve_all(np.flatnonzero(left))


def find_hidden(
    images: ImageStack, fields: Map, near: Mask | None = None, places: list[int] | None = None
) -> NDArray[np.uint8]:
    """Return the images in which each pixel is occluded, as bits; empty for one camera; zero far from a mask.

    ``places``: Images to consider, by their indices in `ImageStack.stack`; default: all.
    """
    near = np.ones(fields.shape[1:], dtype=np.bool_) if near is None else near
    if images.farthest == 0.0 or not near.any():
        return NO_OCCLUSION
    view, inner = images.view() if places is None else images.view_of(places), (slice(None), slice(None))
    if images.beside is None:
        # Pixels as far away as points of different disparity and velocity are displaced relative to each other.
        inside = fields[:, near]
        displaced = np.concatenate([inside[:1], inside[0] * inside[1:]])
        apart = np.nan_to_num(np.nanquantile(displaced, 0.99, axis=1) - np.nanquantile(displaced, 0.01, axis=1))
        rows, columns = _Pixels.of(near, math.ceil(float(apart @ list_arms(images, len(fields)))) + 2).box
        box = rows.start, rows.stop, columns.start, columns.stop
    else:
        # Points beyond the region occlude those within.
        wide, around_it = images.beside
        left, top = images.corner[0] - wide.left, images.corner[1] - wide.top
        inner = slice(top, top + images.shape[0]), slice(left, left + images.shape[1])
        view = view._replace(
            centre_x=view.centre_x + left, centre_y=view.centre_y + top, origin=view.origin + [left, top]
        )
        whole = np.zeros((len(fields), wide.height, wide.width))
        whole[: len(around_it)] = around_it
        whole[(slice(None), *inner)] = fields
        fields, box = whole, (0, wide.height, 0, wide.width)
    hidden = np.zeros((-(-len(view.s) // 8), *fields.shape[1:]), dtype=np.uint8)
    in_threads(partial(hide, view, fields, _SAME_PX / images.farthest, hidden, box=box), range(len(hidden)))
    return np.ascontiguousarray(hidden[(slice(None), *inner)])
