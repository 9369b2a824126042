"""Rounds of warping all images and fitting all windows, until nothing moves."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.element import FUNCTIONALS, VALUES
from scenetruth.estimators.refined.kernels.warp import PRODUCTS, View, add_products, mean_texture, warp_rows
from scenetruth.estimators.refined.kernels.windows import FULL, Fit, Model, correct_brightness, solve_rows
from scenetruth.estimators.refined.noise import noise_of, spline_transfer, textured
from scenetruth.estimators.refined.settings import RefinedSettings
from scenetruth.estimators.refined.start import filled
from scenetruth.estimators.threads import in_threads

__all__ = ["FIELDS", "Images", "Refined", "refine", "window_weights"]

FIELDS = (0, 6, 9, 12)
"""Places of d, q_X, q_Y and q_Z among the parameters of a fit."""

# Bytes of warped images that are kept at a time, rows that a thread takes at a time, and rows of a band at least.
_SCRATCH_BYTES, _ROWS, _LEAST_BAND = 192e6, 16, 32
# Windows of which less is known have no estimate.
_LEAST_SHARE = 0.5
# Frames before and after that take part in the first rounds.
_STAGES = (1, 2)
# Share of the pixels that must stand still at the end: at outlines, some never do.
_STILL_SHARE = 0.9
# How many times as large as by noise alone a change of disparity must be to count.
_SIGNIFICANT = 4.0
# Windows whose residual is beyond this many times the noise are not asked whether they stand still.
_FITTED = 1.5
# Windows reach this many times their standard deviation.
_CUT = 2.0

Map = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Images:
    """Images that are fitted together.

    Parameters
    ----------
    coefficients
        Coefficients of their splines by frame, shape (channel, s, y, x) each.
    positions
        Positions of the cameras in steps.
    times
        Times of the frames after the estimated one.
    focal, centre
        Focal length, and principal point (x, y), in columns and rows.
    """

    coefficients: list[NDArray[np.float32]]
    positions: Map
    times: Map
    focal: float
    centre: tuple[float, float]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        height, width = self.coefficients[0].shape[-2:]
        return height, width

    def within(self, reach: float) -> Images:
        """Return the images of the frames up to so many before and after."""
        chosen = np.flatnonzero(np.abs(self.times) <= reach)
        kept = [self.coefficients[n] for n in chosen]
        return Images(kept, self.positions, self.times[chosen], self.focal, self.centre)

    def view(self) -> View:
        """Return where and when all images were taken, camera by camera within each frame."""
        s = np.tile(self.positions, len(self.times))
        t = np.repeat(self.times, len(self.positions))
        return View(s, np.zeros_like(s), t, self.focal, *self.centre)


@dataclass(frozen=True, eq=False)
class Refined:
    """What the rounds end with."""

    fit: Fit
    """The fit around every pixel; NaN where there is none."""
    curved: NDArray[np.bool_]
    """Where the surface is of second order, shape (y, x)."""
    rounds: int
    """How many rounds it took."""


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
    models = _models(images, settings)
    plain = models[0]._replace(gradient=0) if models[0].surface > 0 else models[0]
    span = float(np.abs(images.times).max())
    stages = [(images.within(reach), plain) for reach in _STAGES if reach < span]
    state = np.zeros((FULL, *images.shape))
    state[list(FIELDS)] = start
    done, left = 0, settings.rounds - len(models)
    for part, model in [*stages, (images, plain), *[(images, models[0])] * left]:
        if done >= left:
            break
        (fit,) = _round(part, state, [model], settings)
        before, state = state, _kept(state, fit.theta)
        done += 1
        if told is not None:
            told(done)
        if model is models[0] and _still(before, state, fit, images, settings.tolerance_px):
            break
    curved = np.full(images.shape, models[0].surface == _CURVED)
    chosen = np.zeros(images.shape, dtype=np.int8)
    if len(models) > 1:
        plane, bent = _round(images, state, models, settings, variances=1)
        curved = _needs_curvature(plane, bent, settings.window_sigma_px)
        # The change of order moves the pixels: another round follows.
        state = _kept(state, np.where(curved, bent.theta, plane.theta))
        chosen[curved] = 1
        done += 1
        if told is not None:
            told(done)
    fit, *_ = _round(images, state, models, settings, variances=_ALL, chosen=chosen)
    if told is not None:
        told(done + 1)
    return Refined(fit, curved, done + 1)


# Variances of a fit, with those of the surface element.
_ALL = 7
_CONSTANT, _PLANE, _CURVED = 1, 3, 6
_SURFACES = {"constant": [_CONSTANT], "plane": [_PLANE], "curved": [_CURVED], "auto": [_PLANE, _CURVED]}
_GRADIENTS = {"translation": 0, "rigid": 1, "growing": 2, "affine": 3}


def _models(images: Images, settings: RefinedSettings) -> list[Model]:
    """Return the models to choose from, the simplest first, as far as cameras and frames can tell."""
    moves = len(images.times) > 1
    if len(images.positions) == 1:
        return [Model(0, 2, 3 if settings.motion != "translation" else 0)]
    gradient = _GRADIENTS[settings.motion] if moves else 0
    # Without slopes, a surface has no tangents that could turn.
    if settings.surface == "constant" and 0 < gradient < _GRADIENTS["affine"]:
        gradient = 0
    return [Model(surface, 3 if moves else 0, gradient) for surface in _SURFACES[settings.surface]]


def window_weights(sigma_px: float) -> Map:
    """Return the window's weights and their squares along one axis, times the powers 0 to 4 of the distance.

    Parameters
    ----------
    sigma_px
        Standard deviation of the Gaussian window.

    Returns
    -------
    numpy.ndarray
        Shape (2, 5, 2 r + 1).
    """
    reach = math.ceil(_CUT * sigma_px)
    at = np.arange(-reach, reach + 1, dtype=np.float64)
    weights = np.exp(-0.5 * (at / sigma_px) ** 2)
    weights /= weights.sum()
    powers = at ** np.arange(5)[:, None]
    return np.stack([weights * powers, weights**2 * powers])


def _round(
    images: Images,
    state: Map,
    models: list[Model],
    settings: RefinedSettings,
    *,
    variances: int = 0,
    chosen: NDArray[np.int8] | None = None,
) -> list[Fit]:
    """Warp all images by what is known of every pixel, and fit each model anew, or the one that is chosen."""
    height, width = images.shape
    view, channels = images.view(), len(images.coefficients[0])
    fields = np.ascontiguousarray(state[list(FIELDS)])
    windows = window_weights(settings.window_sigma_px)
    reach = windows.shape[2] // 2
    gains = settings.brightness == "per_image"
    if chosen is None:
        chosen = np.full(images.shape, -1, dtype=np.int8)
        fits = [_blank(state, variances=variances > 0) for _ in models]
    else:
        fits = [_blank(state, variances=variances > 0)] * len(models)
    stacks = [np.concatenate([part[channel] for part in images.coefficients]) for channel in range(channels)]
    at_a_time = int(_SCRATCH_BYTES / (8 * len(view.s) * width)) - 4 * reach
    band = max(at_a_time, _LEAST_BAND)
    for top in range(0, height, band):
        bottom = min(top + band, height)
        # Windows reach beyond the band, and so do those of the gains at their pixels.
        step = _brightness_step(windows[0, 0])
        first, end = max(top - 2 * reach - step, 0), min(bottom + 2 * reach + step, height)
        products = np.zeros((PRODUCTS, end - first, width))
        for stack in stacks:
            _add_channel(stack, view, fields, first, windows[0, 0] if gains else None, products)
        # Always two, so that the kernel is compiled once.
        pairs = (models[0], models[-1]), len(models), view, channels, first, _LEAST_SHARE, (fits[0], fits[-1])
        solve = partial(solve_rows, products, windows, *pairs, chosen, variances)
        in_threads(solve, _pieces(top - first, bottom - first))
    return fits


def _add_channel(
    coefficients: NDArray[np.float32], view: View, fields: Map, first: int, window: Map | None, products: Map
) -> None:
    """Add the normal equations of one channel's images for the rows of a band."""
    _, rows, width = products.shape
    count, least = len(coefficients), max(2, (len(coefficients) + 1) // 2)
    warped = np.empty((count, rows, width), dtype=np.float32)
    gradient = np.empty((2, rows, width), dtype=np.float32)
    pieces = _pieces(0, rows)
    in_threads(partial(warp_rows, coefficients, view, fields, first, warped, gradient), pieces)
    if window is not None:
        texture, even = np.empty((rows, width), dtype=np.float32), np.empty_like(warped)
        in_threads(partial(mean_texture, warped, least, texture), pieces)
        weights = window.astype(np.float32)
        step = _brightness_step(window)

        def correct(number: int) -> None:
            correct_brightness(warped[number], texture, weights, step, first, even[number])

        in_threads(correct, range(count))
        warped = even
    in_threads(partial(add_products, view, fields, warped, gradient, first, least, products), pieces)


def _brightness_step(window: Map) -> int:
    """Return how far apart gain and offset are found: six times in a window's half width."""
    return max(1, len(window) // 12)


def _pieces(first: int, end: int) -> list[tuple[int, int]]:
    return [(row, min(row + _ROWS, end)) for row in range(first, end, _ROWS)]


def _blank(state: Map, *, variances: bool) -> Fit:
    shape = state.shape[1:] if variances else (1, 1)
    variance = np.full((6, *shape), np.nan)
    element, of_element = (np.full((count, *shape), np.nan, dtype=np.float32) for count in (VALUES, FUNCTIONALS))
    images = np.full(shape, np.nan, dtype=np.float32)
    return Fit(state.copy(), variance, element, of_element, images, np.full((2, *state.shape[1:]), np.nan))


def _kept(state: Map, theta: Map) -> Map:
    """Return parameters that are known everywhere: a fit's where it is sound, else those of the nearest that is."""
    with np.errstate(invalid="ignore"):
        sound = np.isfinite(theta).all(axis=0) & (theta[0] * state[0] > 0)
        sound &= np.abs(theta[0] - state[0]) < 0.5 * np.abs(state[0])
    return filled(theta, sound) if sound.any() else state


def _still(before: Map, after: Map, fit: Fit, images: Images, tolerance_px: float) -> bool:
    """Tell whether almost no pixel that is fitted well moved by more than a tolerance in any image."""
    steps = np.abs(after[list(FIELDS)] - before[list(FIELDS)])
    farthest, longest = np.abs(images.positions).max(), np.abs(images.times).max()
    moved = steps[0] * farthest
    aside = max(images.centre) / images.focal
    for step, arm in zip(steps[1:], (1.0, 1.0, aside), strict=True):
        moved = np.maximum(moved, step * np.abs(after[0]) * longest * arm)
    left = np.sqrt(fit.residual[0]) / spline_transfer()
    count = len(images.positions) * len(images.times)
    with np.errstate(invalid="ignore"):
        fitted = textured(fit.residual[1], noise_of(left), count) & (left < _FITTED * noise_of(left))
    return not fitted.any() or bool(np.mean(moved[fitted] < tolerance_px) >= _STILL_SHARE)


def _needs_curvature(plane: Fit, curved: Fit, sigma_px: float) -> NDArray[np.bool_]:
    """Tell where the second order changes disparity by more than noise.

    Both fits have the same windows, and the plane is a part of the curved model: noise alone makes them differ by the
    difference of their variances. Squares of the difference, averaged over the window, must be `_SIGNIFICANT` times
    that, with what the curved fit leaves for the noise.
    """
    from scipy.ndimage import gaussian_filter

    with np.errstate(invalid="ignore"):
        noise = (curved.variance[0] - plane.variance[0]) * curved.residual[0]
        square = (curved.theta[0] - plane.theta[0]) ** 2
        known = np.isfinite(square) & np.isfinite(noise)
        means = [gaussian_filter(np.where(known, values, 0.0), sigma_px) for values in (square, noise)]
        return np.asarray(known & (means[0] > _SIGNIFICANT * means[1]))
