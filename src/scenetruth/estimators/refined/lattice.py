"""Windows on a lattice: fits at every n-th pixel where they vary smoothly, interpolated between, and at all others."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.fit_maps import STEADY_PLACES, blank_fit, extract_fields
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels.lattice import carry_rows, find_smooth_cells, interpolate_rows
from scenetruth.estimators.refined.kernels.window_solver import DIRECTION, EVERY_VARIANCE, Fit, Model
from scenetruth.estimators.refined.kernels.window_sums import EVERY_MODEL, NO_MODEL, solve_rows
from scenetruth.estimators.refined.noise_estimation import spline_transfer, textured
from scenetruth.estimators.refined.row_bands import FIT_LIMITS, RowBand, pieces, window_weights
from scenetruth.threads import in_threads

__all__ = ["WindowLattice", "lattice_step"]

# Largest error of interpolation, as a displacement in any image, in px: below that of the splines through the images.
_ERROR_PX = 5e-4
# Or smaller than this fraction of the standard deviation of the fit, whose square it increases by 1 % at most.
_ERROR_SHARE = 0.1
_VARIANCES = (0, 3, 4, 5, 6, 7, 8)  # numbers of the variances of disparity, velocity and acceleration
# Error of a cubic polynomial through four values halfway between the middle nodes, relative to their fourth difference.
_CUBIC_ERROR = 3 / 128
_LEAST_NODES = 5  # smallest number of nodes along an axis with a fourth difference
# Number of rows of nodes that a cell depends on, below its own, + 1; and distance in nodes at which nodes are required.
_ROWS_BELOW, _REQUIRED = 4, 3
_NO_FIT = -128
_COARSE_STEP = 2  # distance where all windows are on the lattice: as of the rows, and smaller than narrow objects

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


def lattice_step(sigma_px: float) -> int:
    """Return the distance of windows from which the results between them can be interpolated, in px."""
    return max(1, int(FIT_LIMITS.lattice_step * sigma_px))


class WindowLattice:
    """Windows of one size, fitted band by band.

    ``fits``: Fit of each model, or of the selected model at every pixel, at all pixels; with the initial parameters.
    ``chosen``: Model of every pixel, `EVERY_MODEL` or `NO_MODEL`.
    ``least_share``: Smallest valid fraction of a window.
    ``variances``: Number of variances.
    ``coarse``: Whether all windows are on the lattice, also where their fits do not vary smoothly.
    """

    def __init__(
        self,
        images: ImageStack,
        models: Sequence[Model],
        sigma_px: float,
        fits: Sequence[Fit],
        chosen: NDArray[np.int8],
        *,
        least_share: float,
        variances: int,
        coarse: bool = False,
    ) -> None:
        self._images, self._models, self._fits, self._chosen = images, models, fits, chosen
        self._weights, self._least, self._variances, self._coarse = (
            window_weights(sigma_px),
            least_share,
            variances,
            coarse,
        )
        self._step = _COARSE_STEP if coarse else lattice_step(sigma_px)
        self._done, self._sigma = 0, sigma_px
        if self._step == 1:
            return
        self._of_nodes = _models_of_nodes(chosen, self._step)
        begun = [np.ascontiguousarray(fit.theta[:, :: self._step, :: self._step]) for fit in fits]
        blank = partial(blank_fit, variances=variances > 0, element=variances == EVERY_VARIANCE)
        self._nodes = [blank(begun[0])]
        self._nodes += [
            self._nodes[0] if fit is fits[0] else blank(each) for fit, each in zip(fits[1:], begun[1:], strict=True)
        ]

    @property
    def behind(self) -> int:
        """Number of rows above a band that are fitted with it."""
        return 0 if self._step == 1 or self._coarse else _ROWS_BELOW * self._step

    def put(self, band: RowBand) -> None:
        """Fit the windows of a band."""
        if self._step == 1:
            self._solve(band, self._fits, self._chosen, 1, (band.top, band.bottom))
            return
        step, height = self._step, self._images.shape[0]
        self._solve(band, self._nodes, self._of_nodes, step, (-(-band.top // step), -(-band.bottom // step)))
        if self._coarse and not band.last:
            return
        # Cells depend on nodes below them.
        first, self._done = self._done, height if band.last else max(band.bottom - self.behind, self._done)
        smooth = [self._smooth(nodes) for nodes in self._nodes]
        for model, (fit, nodes) in enumerate(zip(self._fits, self._nodes, strict=True)):
            if model == 0 or fit is not self._fits[0]:
                # Of several models, the first determines where windows are fitted at every pixel.
                carried = ~smooth[model] if self._coarse else _empty(nodes) | (smooth[0] & ~smooth[model])
                self._between(nodes, smooth[model], carried, fit, model, (first, self._done))
        if not self._coarse:
            done = smooth[0] | np.logical_and.reduce([_empty(nodes) for nodes in self._nodes])
            models = np.where(done, self._of_nodes, NO_MODEL)
            cells = np.repeat(np.repeat(models, step, axis=0), step, axis=1)[:height, : self._images.shape[1]]
            single = np.where(cells == self._chosen, NO_MODEL, self._chosen).astype(np.int8)
            self._solve(band, self._fits, single, 1, (first, self._done))

    def _solve(
        self, band: RowBand, fits: Sequence[Fit], chosen: NDArray[np.int8], step: int, rows: tuple[int, int]
    ) -> None:
        # Always two models, so that the kernel is compiled once.
        models, pair = (self._models[0], self._models[-1]), (fits[0], fits[-1])
        common = len(self._models), self._images.view(), band.first, self._least * self._images.channels
        solve = partial(solve_rows, band.products, self._weights, models, *common, pair, chosen, self._variances, step)
        in_threads(solve, pieces(*rows, step))

    def _smooth(self, nodes: Fit) -> Mask:
        """Return the cells in which the fits of the nodes are interpolated."""
        out = np.zeros(self._of_nodes.shape, dtype=np.bool_)
        if min(out.shape) < _LEAST_NODES:
            return out
        fields = extract_fields(nodes.theta)
        error = np.zeros(out.shape)
        with np.errstate(invalid="ignore"):
            for axis in (1, 2):
                fourth = _CUBIC_ERROR * self._within_window(np.diff(nodes.theta, 4, axis=axis))
                ends = [(0, 0), (0, 0), (0, 0)]
                ends[axis] = (2, 2)
                error += self._images.moved_px(fields, fields + np.pad(fourth, ends, mode="edge"))
            std = np.zeros_like(fields)
            for place, number in enumerate(_VARIANCES[: len(fields)]):
                if number < self._variances:
                    std[place] = np.sqrt(nodes.variance[number])
            limit = np.fmax(_ERROR_PX, _ERROR_SHARE * self._images.moved_px(fields, fields + std))
            # Without texture, fits are of noise alone, and no values are wanted.
            noise = np.sqrt(nodes.residual[0]) / spline_transfer(self._images.spline)
            clear = textured(nodes.residual[1], noise, self._images.count, self._images.spline)
            rough = ~(error <= limit) & (clear | np.isnan(noise))
            known = np.isfinite(nodes.theta).all(axis=0)
        find_smooth_cells(rough, np.where(known, self._of_nodes, _NO_FIT).astype(np.int8), out)
        return out

    def _within_window(self, theta: Map) -> Map:
        """Return the largest changes of disparity, velocity and acceleration at a standard deviation from the centre.

        ``theta``: Changes of the parameters, shape (15 or 18, y, x).
        """
        steps, sigma = np.abs(theta), self._sigma
        out = extract_fields(steps)
        out[0] += sigma * (steps[1] + steps[2]) + sigma**2 * (steps[3] + steps[4] + steps[5])
        for n, place in enumerate(STEADY_PLACES[1:], 1):
            out[n] += sigma * (steps[place + 1] + steps[place + 2])
        return out

    def _between(self, nodes: Fit, smooth: Mask, carried: Mask, fit: Fit, model: int, rows: tuple[int, int]) -> None:
        """Write the fits of pixels in a range of rows: interpolated, or carried from the nearest node."""
        several = len(self._models) > 1 and self._fits[0] is not self._fits[-1]
        wanted = self._chosen != NO_MODEL
        if several:
            wanted = (self._chosen == EVERY_MODEL) | (self._chosen == model)
        # Values at nodes and pixels; whether they are parameters; whether they are positive; first map of a direction.
        maps: list[tuple[Any, Any, bool, bool, int]] = [
            (nodes.theta, fit.theta, True, False, -1),
            (nodes.residual, fit.residual, False, True, -1),
        ]
        if self._variances > 0:
            maps += [(nodes.variance, fit.variance, False, True, -1)]
            maps += [(nodes.images[None], fit.images[None], False, True, -1)]
        if self._variances == EVERY_VARIANCE:
            maps += [(nodes.element, fit.element, False, False, DIRECTION)]
            maps += [(nodes.element_variance, fit.element_variance, False, True, -1)]
        for values, out, parameters, positive, signed in maps:
            interpolate = partial(interpolate_rows, values, self._step, smooth, wanted, positive, signed, out)
            in_threads(interpolate, pieces(*rows))
            in_threads(partial(carry_rows, values, self._step, carried, wanted, parameters, out), pieces(*rows))


def _models_of_nodes(chosen: NDArray[np.int8], step: int) -> NDArray[np.int8]:
    """Return the models of the nodes: where none is selected, that of a pixel which depends on the node."""
    from scipy.ndimage import maximum_filter

    near = maximum_filter(chosen, 2 * _REQUIRED * step + 1)[::step, ::step]
    own = chosen[::step, ::step]
    return np.ascontiguousarray(np.where(own == NO_MODEL, near, own))


def _empty(nodes: Fit) -> Mask:
    """Return the cells between nodes without a fit."""
    out = np.pad(np.isnan(nodes.theta[0]), ((0, 1), (0, 1)), mode="edge")
    return np.asarray(out[:-1, :-1] & out[1:, :-1] & out[:-1, 1:] & out[1:, 1:])
