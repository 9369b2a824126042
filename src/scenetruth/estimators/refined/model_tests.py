"""Fits of other models at one linearisation: of motion models, spans of frames and window sizes, on a lattice.

A converged fit is at the minimum of its residual. If the fit of another model, of fewer frames or of smaller windows is
near, one step leads to it, and all of them have the same warped images. They are solved at the nodes of a lattice: the
result of a Gaussian window varies so smoothly that statistics of a map follow from its nodes. Only where such a fit
differs, or is so far away that the step is not linear, images are warped again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.fit_maps import accelerated, blank_fit, extract_fields
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels.pixel_equations import PRODUCTS
from scenetruth.estimators.refined.kernels.warp import STEADY
from scenetruth.estimators.refined.kernels.window_solver import ALL, EVERY_VARIANCE, FULL, Fit, Model
from scenetruth.estimators.refined.kernels.window_sums import NO_MODEL, solve_rows
from scenetruth.estimators.refined.row_bands import FrameSubset, RowBand, around, bands, pieces, window_weights
from scenetruth.estimators.refined.velocity_curvature import add_velocity, remove_slopes, remove_velocity
from scenetruth.threads import in_threads

__all__ = ["Alternative", "Linearisation", "at_nodes", "enlarged", "find_far", "large_areas", "of_nearest_node"]

_LEAST_SHARE = 0.5  # smallest valid fraction of a window
# Largest step of a linear fit, as a displacement in any image: the error of a step is of second order.
_LINEAR_PX = 0.1
_OF_FIELDS = [0, 3, 4, 5]  # variances of d, q_X, q_Y and q_Z
_LEAST_SQUARE = 3  # smallest side of an area in nodes
_MOST_NEEDED = 0.02  # largest fraction of all nodes that an area must have, for small images

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Alternative(NamedTuple):
    """Another fit to the same images."""

    images: ImageStack
    """All images, or those of consecutive frames."""
    models: list[Model]
    """Model of planes, and that of curved surfaces if there is one."""
    sigma_px: float
    variances: int
    without_smooth: bool = False
    """Whether the smooth velocity is removed before the fit."""


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Parameters at which images are warped, and the windows that are solved there."""

    images: ImageStack
    state: Map
    """Parameters, finite at all pixels of these windows, shape (15 or 18, y, x)."""
    where: Mask
    """Pixels whose windows are solved, as far as they are nodes."""
    curved: Mask
    """Pixels with a surface of second order."""
    gains: bool
    """Whether every image has a gain and an offset."""
    step: int
    """Distance of the nodes in px."""
    smooth: Map | None = None
    """Velocity as in `smooth_velocity`."""

    def fits(self, alternatives: Sequence[Alternative]) -> list[Fit]:
        """Warp all images once, and return the fit of each alternative at the nodes."""
        widest = max(each.sigma_px for each in alternatives)
        near = around(self.where, window_weights(widest).shape[2] // 2)
        # Frames of the normal equations, all of them first.
        spans = [self.images]
        for each in alternatives:
            if all(len(each.images.times) != len(span.times) for span in spans):
                spans.append(each.images)
        fields = [self._fields(alternatives, span, near) for span in spans]
        subsets = [FrameSubset(*pair, self._frames(pair[0])) for pair in zip(spans[1:], fields[1:], strict=True)]
        solved = [_Windows(self, each) for each in alternatives]
        for band in bands(self.images, fields[0], widest, gains=self.gains, subsets=subsets):
            for span, products in zip(spans, (band.products, *band.of_subsets), strict=True):
                own = [each for each in solved if len(each.alternative.images.times) == len(span.times)]
                for windows in own:
                    if not windows.without_smooth:
                        windows.put(band, products)
                # Velocity is removed from the equations in place.
                if self.smooth is not None and any(windows.without_smooth for windows in own):
                    remove_velocity(products, band.first, self.smooth)
                for windows in own:
                    if windows.without_smooth:
                        windows.put(band, products)
        for windows in solved:
            if self.smooth is not None and windows.without_smooth:
                add_velocity(windows.fit, self.smooth, self.images, windows.chosen > NO_MODEL, self.step)
        return [windows.fit for windows in solved]

    def _fields(self, alternatives: Sequence[Alternative], span: ImageStack, near: Mask) -> Map:
        """Return the fields of the normal equations of a span: with the acceleration, if any alternative has one."""
        bent = [len(each.images.times) == len(span.times) and each.models[0].accelerated for each in alternatives]
        fields = extract_fields(accelerated(self.state) if any(bent) else self.state)
        return np.where(near, fields, np.nan)

    def _frames(self, span: ImageStack) -> slice:
        """Return the images of a span."""
        first, cameras = int(np.searchsorted(self.images.times, span.times[0])), len(self.images.positions)
        return slice(first * cameras, (first + len(span.times)) * cameras)


class _Windows:
    """Windows of an alternative at the nodes."""

    def __init__(self, at: Linearisation, alternative: Alternative) -> None:
        self.alternative, self._at = alternative, at
        self.without_smooth = alternative.without_smooth and at.smooth is not None
        nodes = slice(None, None, at.step), slice(None, None, at.step)
        begun = at.state[:, *nodes]
        if self.without_smooth and at.smooth is not None:
            begun = remove_slopes(begun, at.smooth[:, *nodes])
        bent = alternative.models[0].accelerated
        begun = accelerated(begun) if bent else np.ascontiguousarray(begun[:FULL])
        self.fit = blank_fit(begun, variances=True, element=alternative.variances == EVERY_VARIANCE)
        model = at.curved[nodes] & (len(alternative.models) > 1)
        self.chosen = np.where(at.where[nodes], model, NO_MODEL).astype(np.int8)
        # Pixels outside have no fit.
        self.fit.theta[:, self.chosen == NO_MODEL] = np.nan

    def put(self, band: RowBand, products: Map) -> None:
        """Fit the windows of a band."""
        own, at = self.alternative, self._at
        products = products if own.models[0].accelerated else products[:PRODUCTS]
        # Always two models, so that the kernel is compiled once.
        pair = own.models[0], own.models[-1]
        common: Any = len(own.models), own.images.view(), band.first, _LEAST_SHARE * own.images.channels
        fits = self.fit, self.fit
        weights = window_weights(own.sigma_px)
        solve = partial(solve_rows, products, weights, pair, *common, fits, self.chosen, own.variances, at.step)
        in_threads(solve, pieces(-(-band.top // at.step), -(-band.bottom // at.step), at.step))


def at_nodes(fit: Fit, step: int) -> Fit:
    """Return a fit to all pixels at every n-th row and column."""
    return Fit._make(each[..., ::step, ::step] for each in fit)


def large_areas(found: Mask, sigma: float) -> Mask:
    """Return the nodes in areas as large as a window, of a standard deviation in nodes.

    They contain a square of its width, and are as large as a Gaussian window with its mean square weight, 4 π σ².
    """
    from scipy.ndimage import grey_opening, label

    size = max(2 * int(sigma) + 1, _LEAST_SQUARE)
    areas, _ = label(grey_opening(found.astype(np.uint8), size, mode="nearest"))
    large = np.bincount(areas.ravel()) >= min(4.0 * math.pi * sigma**2, _MOST_NEEDED * found.size)
    large[0] = False
    return np.asarray(large[areas])


def enlarged(values: NDArray[Any], step: int, shape: tuple[int, int]) -> NDArray[Any]:
    """Return maps of nodes at all pixels: those of the nearest node."""
    rows, columns = (
        np.minimum((np.arange(size) + step // 2) // step, count - 1)
        for size, count in zip(shape, values.shape[-2:], strict=True)
    )
    return np.asarray(values[..., rows[:, None], columns])


def of_nearest_node(values: NDArray[Any], step: int, where: Mask) -> NDArray[Any]:
    """Return the values of maps of nodes at the pixels of a mask, shape (..., n)."""
    places = (
        np.minimum((each + step // 2) // step, count - 1)
        for each, count in zip(np.nonzero(where), values.shape[-2:], strict=True)
    )
    return np.asarray(values[(..., *places)])


def find_far(images: ImageStack, state: Map, fit: Fit, deviations: float = 0.0) -> Mask:
    """Return textured windows from which the step to a fit is too large to be linear.

    ``images``: Those of the fit.
    ``state``: Parameters at which the fit was linearised, at the same windows.
    ``deviations``: Standard deviations of the fit by noise up to which larger steps are not far either.
    """
    before = accelerated(state) if len(fit.theta) == ALL else state[:FULL]
    noise = np.sqrt(fit.residual[0]) / images.transfer
    clear = images.is_textured(fit.residual[1], noise)
    with np.errstate(invalid="ignore"):
        fields = extract_fields(fit.theta)
        limit: Map | float = _LINEAR_PX
        if deviations > 0.0:
            by_noise = np.zeros_like(fields)
            by_noise[:STEADY] = deviations * np.sqrt(fit.variance[_OF_FIELDS]) / images.transfer
            limit = np.hypot(_LINEAR_PX, images.moved_px(fields, fields + by_noise))
        far = ~(images.moved_px(extract_fields(before), fields) <= limit)
    return np.asarray(far & clear & np.isfinite(fit.theta[0]))
