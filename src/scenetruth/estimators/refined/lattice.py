"""Windows on lattices: fits at every n-th pixel where they vary smoothly, interpolated between, elsewhere denser."""

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
from scenetruth.estimators.refined.row_bands import FIT_LIMITS, RowBand, pieces, window_weights
from scenetruth.threads import in_threads

__all__ = ["WindowLattice", "WindowNodes", "lattice_step", "sample_step"]

# Largest error of interpolation, as a displacement in any image, in px: below that of the splines through the images.
_ERROR_PX = 5e-4
# Or, of start values, below the steps of the iterations that follow.
_DRAFT_ERROR_PX = 0.02
# Or smaller than this fraction of the standard deviation of the fit, whose square it increases by 1 % at most.
_ERROR_SHARE = 0.1
_VARIANCES = (0, 3, 4, 5, 6, 7, 8)  # numbers of the variances of disparity, velocity and acceleration
# Error of a cubic polynomial through four values halfway between the middle nodes, relative to their fourth difference.
_CUBIC_ERROR = 3 / 128
_LEAST_NODES = 5  # smallest number of nodes along an axis with a fourth difference
# Number of rows of nodes that a cell depends on, below its own, + 1; and distance in nodes at which nodes are required.
_ROWS_BELOW, _REQUIRED = 4, 3
_NO_FIT = -128
COARSE_STEP = 2
"""Distance of the windows of coarse fits: as of their rows, and smaller than narrow objects."""

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]
Chosen = NDArray[np.int8]


def lattice_step(sigma_px: float) -> int:
    """Return the distance of windows from which the results between them can be interpolated, in px."""
    return max(1, int(FIT_LIMITS.lattice_step * sigma_px))


def sample_step(sigma_px: float) -> int:
    """Return the distance of windows in which statistics of areas larger than a window are sampled, in px.

    Fits at a distance r have a correlation of exp(-r² / 4σ²): at σ, means and means of squares over larger areas have
    the same noise as those over all pixels.
    """
    return max(1, int(sigma_px))


def _lattice_steps(sigma_px: float, *, coarse: bool, draft: bool) -> list[int]:
    """Return the distances of the windows of all lattices, the widest first."""
    step = lattice_step(sigma_px)
    each = COARSE_STEP if coarse or (draft and step >= 2 * COARSE_STEP) else 1
    if step <= each or (coarse and not draft):
        return [each]
    finer: list[int] = []
    while 2 * each <= step:
        finer.insert(0, each)
        each *= 2
    return [step, *finer]


class _Windows:
    """Windows of one size that are fitted by the same models."""

    def __init__(
        self, images: ImageStack, models: Sequence[Model], sigma_px: float, least_share: float, variances: int
    ) -> None:
        self.images, self.models, self.sigma, self.variances = images, models, sigma_px, variances
        self._weights, self._least = window_weights(sigma_px), least_share * images.channels

    def blank(self, theta: Map) -> Fit:
        """Return a fit with initial parameters."""
        return blank_fit(theta, variances=self.variances > 0, element=self.variances == EVERY_VARIANCE)

    def solve(self, band: RowBand, fits: Sequence[Fit], chosen: Chosen, step: int, rows: tuple[int, int]) -> None:
        """Fit the windows around the pixels of a lattice, for a range of its rows."""
        # Always two models, so that the kernel is compiled once.
        models, pair = (self.models[0], self.models[-1]), (fits[0], fits[-1])
        common = len(self.models), self.images.view(), band.first, self._least
        solve = partial(solve_rows, band.products, self._weights, models, *common, pair, chosen, self.variances, step)
        in_threads(solve, pieces(*rows, step))


class WindowNodes:
    """Windows at every n-th pixel of every n-th row, fitted band by band.

    ``fit``: Fit at these pixels, with the initial parameters.
    ``chosen``: Model of these pixels, `EVERY_MODEL` or `NO_MODEL`.
    """

    behind = 0

    def __init__(
        self,
        images: ImageStack,
        models: Sequence[Model],
        sigma_px: float,
        fit: Fit,
        chosen: Chosen,
        *,
        step: int,
        least_share: float,
        variances: int,
    ) -> None:
        self._windows = _Windows(images, models, sigma_px, least_share, variances)
        self._fits, self._chosen, self._step = [fit] * len(models), chosen, step

    def put(self, band: RowBand) -> None:
        """Fit the windows of a band."""
        rows = -(-band.top // self._step), -(-band.bottom // self._step)
        self._windows.solve(band, self._fits, self._chosen, self._step, rows)


class WindowLattice:
    """Windows of one size, fitted band by band.

    Where the fits of a lattice do not vary smoothly, windows are fitted on a lattice of half the distance, and so on to
    every pixel.

    ``fits``: Fit of each model, or of the selected model at every pixel, at all pixels; with the initial parameters.
    ``chosen``: Model of every pixel, `EVERY_MODEL` or `NO_MODEL`.
    ``least_share``: Smallest valid fraction of a window.
    ``variances``: Number of variances.
    ``coarse``: Whether windows are fitted at every other pixel only.
    ``draft``: Whether the results of coarse fits are start values, which may be interpolated with a larger error.
    """

    def __init__(
        self,
        images: ImageStack,
        models: Sequence[Model],
        sigma_px: float,
        fits: Sequence[Fit],
        chosen: Chosen,
        *,
        least_share: float,
        variances: int,
        coarse: bool = False,
        draft: bool = False,
    ) -> None:
        windows = _Windows(images, models, sigma_px, least_share, variances)
        steps = _lattice_steps(sigma_px, coarse=coarse, draft=draft)
        error_px = _DRAFT_ERROR_PX if coarse and draft else _ERROR_PX
        left = [chosen.copy(), *(np.full_like(chosen, NO_MODEL) for _ in steps[1:])]
        levels = enumerate(zip(steps, left, strict=True))
        self._levels = [
            _Level(windows, fits, each, step, error_px, last=n == len(steps) - 1) for n, (step, each) in levels
        ]

    @property
    def behind(self) -> int:
        """Number of rows above a band that are fitted with it."""
        return self._levels[0].behind + sum(level.ahead + level.behind for level in self._levels[1:])

    def put(self, band: RowBand) -> None:
        """Fit the windows of a band."""
        height, ready = self._levels[0].left.shape[0], band.bottom
        for level, finer in zip(self._levels, [*self._levels[1:], None], strict=True):
            first, done = level.put(band, height if band.last else ready)
            if finer is not None:
                finer.left[first:done] = level.left[first:done]
                ready = max(done - finer.ahead, 0)


class _Level:
    """Windows on one lattice, and the values between them.

    ``left``: Model of every pixel that the lattice has to provide; then of those which it could not provide.
    ``last``: Whether it provides all of them.
    """

    def __init__(
        self, windows: _Windows, fits: Sequence[Fit], left: Chosen, step: int, error_px: float, *, last: bool
    ) -> None:
        self._windows, self._fits, self.left, self._step, self._last = windows, fits, left, step, last
        self._error_px = error_px
        self._ready = self._done = 0
        # From the initial parameters, which the fits of a wider lattice replace later.
        self._nodes = [] if step == 1 else [windows.blank(_every_nth(fit, step)) for fit in fits]
        self._of_nodes = np.zeros((len(fits), *left[::step, ::step].shape), dtype=np.bool_)

    @property
    def ahead(self) -> int:
        """Number of rows below a node whose pixels may depend on it."""
        return 0 if self._step == 1 else _REQUIRED * self._step

    @property
    def behind(self) -> int:
        """Number of rows of pixels above a node that depend on it."""
        return 0 if self._step == 1 else _ROWS_BELOW * self._step

    def put(self, band: RowBand, ready: int) -> tuple[int, int]:
        """Fit windows up to a row, and return the range of rows that are complete."""
        height, step = self.left.shape[0], self._step
        first, before = self._done, self._ready
        self._ready = max(ready, before)
        self._done = height if band.last else max(self._ready - self.behind, first)
        if step == 1:
            self._windows.solve(band, self._fits, self.left, 1, (before, self._ready))
            return first, self._done
        self._solve_nodes(band, (-(-before // step), -(-self._ready // step)))
        if (self.left[first : self._done] != NO_MODEL).any():
            self._fill((first, self._done))
        return first, self._done

    def _solve_nodes(self, band: RowBand, rows: tuple[int, int]) -> None:
        """Fit the windows of the nodes on which pixels depend."""
        step, models = self._step, range(len(self._windows.models))
        first, last = max((rows[0] - _REQUIRED) * step, 0), (rows[1] + _REQUIRED) * step
        near = [_near_nodes(self._wanted(model)[first:last], step)[rows[0] - first // step :] for model in models]
        for model in models:
            self._of_nodes[model, rows[0] : rows[1]] = near[model][: rows[1] - rows[0]]
        every = self._of_nodes.all(axis=0) if len(models) > 1 else np.zeros_like(self._of_nodes[0])
        which = np.argmax(self._of_nodes, axis=0)
        chosen = np.where(every, EVERY_MODEL, np.where(self._of_nodes.any(axis=0), which, NO_MODEL)).astype(np.int8)
        self._windows.solve(band, self._nodes, chosen, step, rows)

    def _wanted(self, model: int) -> Mask:
        return np.asarray((self.left == EVERY_MODEL) | (self.left == model))

    def _fill(self, rows: tuple[int, int]) -> None:
        """Write the fits of the pixels of a range of rows where they are smooth, and remove these from those left."""
        step, width = self._step, self.left.shape[1]
        smooth = [self._smooth(model, rows) for model in range(len(self._nodes))]
        empty = [_empty(nodes) for nodes in self._nodes]
        for model in range(len(self._nodes)):
            # Of several models at one pixel, the first determines whether windows are fitted on the next lattice.
            carried = ~smooth[model] if self._last else empty[model] | (smooth[0] & ~smooth[model])
            self._between(model, smooth[model], carried, rows)
        cells = slice(rows[0] // step, -(-rows[1] // step))
        columns = np.arange(width) // step
        of_rows = np.arange(*rows) // step - cells.start
        left = self.left[rows[0] : rows[1]]
        every = smooth[0] | np.logical_and.reduce(empty)
        for model, done in [(EVERY_MODEL, every), *((n, smooth[n] | empty[n]) for n in range(len(smooth)))]:
            if self._last:
                done = np.ones_like(done)
            left[(left == model) & done[cells][of_rows][:, columns]] = NO_MODEL

    def _smooth(self, model: int, rows: tuple[int, int]) -> Mask:
        """Return the cells in which the fits of the nodes are interpolated."""
        nodes, images = self._nodes[model], self._windows.images
        out = np.zeros(self._of_nodes.shape[1:], dtype=np.bool_)
        if min(out.shape) < _LEAST_NODES:
            return out
        # Only the nodes on which the rows depend, as far as there are enough.
        end = min(-(-rows[1] // self._step) + _ROWS_BELOW, len(out))
        begin = max(min(rows[0] // self._step - _REQUIRED, end - _LEAST_NODES), 0)
        near = slice(begin, max(end, _LEAST_NODES))
        theta, residual = nodes.theta[:, near], nodes.residual[:, near]
        fields = extract_fields(theta)
        error = np.zeros(fields.shape[1:])
        with np.errstate(invalid="ignore"):
            for axis in (1, 2):
                fourth = _CUBIC_ERROR * self._within_window(np.diff(theta, 4, axis=axis))
                ends = [(0, 0), (0, 0), (0, 0)]
                ends[axis] = (2, 2)
                error += images.moved_px(fields, fields + np.pad(fourth, ends, mode="edge"))
            std = np.zeros_like(fields)
            for place, number in enumerate(_VARIANCES[: len(fields)]):
                if number < self._windows.variances:
                    std[place] = np.sqrt(nodes.variance[number, near])
            limit = np.fmax(self._error_px, _ERROR_SHARE * images.moved_px(fields, fields + std))
            # Without texture, fits are of noise alone, and no values are wanted.
            noise = np.sqrt(residual[0]) / images.transfer
            clear = images.is_textured(residual[1], noise)
            rough = ~(error <= limit) & (clear | np.isnan(noise))
            known = np.isfinite(theta).all(axis=0) & self._of_nodes[model, near]
        found = np.zeros(known.shape, dtype=np.bool_)
        find_smooth_cells(rough, np.where(known, model, _NO_FIT).astype(np.int8), found)
        out[near] = found
        return out

    def _within_window(self, theta: Map) -> Map:
        """Return the largest changes of disparity, velocity and acceleration at a standard deviation from the centre.

        ``theta``: Changes of the parameters, shape (15 or 18, y, x).
        """
        steps, sigma = np.abs(theta), self._windows.sigma
        out = extract_fields(steps)
        out[0] += sigma * (steps[1] + steps[2]) + sigma**2 * (steps[3] + steps[4] + steps[5])
        for n, place in enumerate(STEADY_PLACES[1:], 1):
            out[n] += sigma * (steps[place + 1] + steps[place + 2])
        return out

    def _between(self, model: int, smooth: Mask, carried: Mask, rows: tuple[int, int]) -> None:
        """Write the fits of pixels in a range of rows: interpolated, or carried from the nearest node."""
        nodes, fit, wanted = self._nodes[model], self._fits[model], self._wanted(model)
        variances = self._windows.variances
        # Values at nodes and pixels; whether they are parameters; whether they are positive; first map of a direction.
        maps: list[tuple[Any, Any, bool, bool, int]] = [
            (nodes.theta, fit.theta, True, False, -1),
            (nodes.residual, fit.residual, False, True, -1),
        ]
        if variances > 0:
            maps += [(nodes.variance, fit.variance, False, True, -1)]
            maps += [(nodes.images[None], fit.images[None], False, True, -1)]
        if variances == EVERY_VARIANCE:
            maps += [(nodes.element, fit.element, False, False, DIRECTION)]
            maps += [(nodes.element_variance, fit.element_variance, False, True, -1)]
        for values, out, parameters, positive, signed in maps:
            interpolate = partial(interpolate_rows, values, self._step, smooth, wanted, positive, signed, out)
            in_threads(interpolate, pieces(*rows))
            in_threads(partial(carry_rows, values, self._step, carried, wanted, parameters, out), pieces(*rows))


def _every_nth(fit: Fit, step: int) -> Map:
    return np.ascontiguousarray(fit.theta[:, ::step, ::step])


def _near_nodes(wanted: Mask, step: int) -> Mask:
    """Return the nodes on which the pixels of a mask depend."""
    from scipy.ndimage import maximum_filter

    height, width = wanted.shape
    rows, columns = -(-height // step), -(-width // step)
    whole = np.zeros((rows * step, columns * step), dtype=np.bool_)
    whole[:height, :width] = wanted
    cells = whole.reshape(rows, step, columns, step).any(axis=(1, 3))
    return np.asarray(maximum_filter(cells, 2 * _REQUIRED + 1, mode="constant"))


def _empty(nodes: Fit) -> Mask:
    """Return the cells between nodes without a fit."""
    out = np.pad(np.isnan(nodes.theta[0]), ((0, 1), (0, 1)), mode="edge")
    return np.asarray(out[:-1, :-1] & out[1:, :-1] & out[:-1, 1:] & out[1:, 1:])
