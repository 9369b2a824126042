"""Comparison of rivals with the fits: in the images nearest to the reference, then in the mean of all images.

A rival is another disparity or motion of a window. If single images are too noisy to distinguish it from the fit, the
mean image decides: a rival fits all images as well only if the mean image resembles itself at its displacement. The
mean image does not decide where the rival fits better: a fit in the wrong period averages out the texture that would
contradict it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.image_stack import NO_DEFECTS, NO_LENS
from scenetruth.estimators.refined.kernels.ambiguity import COSTS, compare_rivals
from scenetruth.estimators.refined.kernels.warp import ImageView
from scenetruth.estimators.refined.mean_image import MeanImage
from scenetruth.threads import in_threads

__all__ = ["SAME", "ImageComparison", "MeanComparison", "find_equal_rivals"]

SAME = 0.15
"""Largest dissimilarity of windows of a texture that repeats."""
# Two minima are equal if their costs differ by less than this number of standard deviations of noise, or than the
# effect of this shift in px, to which the rival may be curved.
_DEVIATIONS, _SHIFT_PX = 3.0, 0.1
# The same shift for the mean image, whose interpolation error is not in the cost of the fit.
_SHIFT_OF_MEAN_PX = 0.2
# Smallest fraction of the weight that a rival must have in the images; with less, near the border of the image, it is
# equal only if the reference resembles itself there.
_LEAST_COMMON = 0.4
_LEAST_COMMON_OF_MEAN = 0.1  # the same for the mean image; with less, it does not decide
_STAY = 0.5  # rivals that move by more than this fraction of their displacement are not minima
_STEP, _ROUNDS = 2, 5  # pixels evaluated, and iterations
_TASK = 32  # rivals per task of a thread

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ImageComparison:
    """Images of a comparison with the reference.

    ``coefficients``, ``reference``, ``view``, ``fields``, ``bad``, ``factors``, ``both``: As for `compare_rivals`.
    ``variance``: Variance of the noise of an image at every pixel, shape (y, x).
    ``weights``: Window along one axis.
    """

    coefficients: NDArray[np.float32]
    reference: Map
    view: ImageView
    fields: Map
    bad: NDArray[np.uint8]
    factors: Map
    both: bool
    variance: Map
    weights: Map

    def find_equal(self, rivals: Map) -> tuple[Mask, Mask]:
        """Return which rivals fit as well, or better, within noise, and which of them fit worse or alike.

        ``rivals``: Row, column, changes along x and y, order, indices of the window and dissimilarity, shape (m, 8).
        """
        own, rival, share, slope, moved, spread = self.costs(rivals)
        equal = rival < own + np.maximum(_DEVIATIONS * spread, _SHIFT_PX**2 * slope)
        minimum = moved > _STAY * np.hypot(rivals[:, 2], rivals[:, 3])
        equal &= np.where(share > _LEAST_COMMON, minimum, rivals[:, 7] < SAME)
        return equal, rival > own - spread

    def costs(self, rivals: Map) -> tuple[Map, ...]:
        """Return the outputs of `compare_rivals` with weights as fractions, and the deviation of cost differences."""
        out = np.empty((COSTS, len(rivals)))
        images = self.coefficients, self.reference, self.view, self.fields, self.bad, self.factors, self.both
        starts = np.ascontiguousarray(rivals[:, :4])
        work = partial(compare_rivals, *images, self.weights, (_STEP, _ROUNDS), starts, out)
        in_threads(work, [(n, min(n + _TASK, len(rivals))) for n in range(0, len(rivals), _TASK)])
        own, rival, weight, slope, moved = out
        used, count = self.weights[::_STEP], len(self.coefficients)
        share = weight / (used.sum() ** 2 * count)
        # Differences of two images have twice the variance of one; those of the reference are common to both costs.
        square = self.variance[rivals[:, 0].astype(int), rivals[:, 1].astype(int)]
        spread = 4.0 * square * np.sqrt(share * (used**2).sum() ** 2 * count)
        return own, rival, share, slope, moved, spread


@dataclass(frozen=True, eq=False)
class MeanComparison:
    """Mean image, compared with itself at the displacements of rivals.

    ``variance``: Variance of the noise of an image at every pixel, shape (y, x).
    ``weights``: Window along one axis.
    ``factors``, ``both``: As for `compare_rivals`, of the nearest image.
    ``margin``: Columns and rows around a window that rivals reach.
    """

    mean: MeanImage
    variance: Map
    weights: Map
    factors: Map
    both: bool
    margin: tuple[int, int]

    def find_distinct(self, rivals: Map) -> Mask:
        """Return which rivals the mean image distinguishes from the fit beyond noise."""
        self._extend(rivals)
        mean = self.mean
        if not mean.coefficients.size:
            return np.zeros(len(rivals), dtype=np.bool_)
        missing = np.isnan(mean.grey)
        variance = self.variance * self._share(rivals)
        stack = np.repeat(mean.coefficients[None], 2, axis=0)
        reference = np.repeat(mean.grey[None], 2, axis=0)
        fields = np.where(missing, np.nan, np.zeros((mean.fields, 1, 1)))
        factors = np.stack([self.factors, -self.factors])
        bad = missing[None].astype(np.uint8) if missing.any() else NO_DEFECTS
        view = _still(mean)
        window = ImageComparison(stack, reference, view, fields, bad, factors, self.both, variance, self.weights)
        own, rival, share, slope, moved, spread = window.costs(rivals)
        # Both samples of the mean image have its noise; at the place of the fit, they are the same.
        square = variance[rivals[:, 0].astype(int), rivals[:, 1].astype(int)]
        by_noise = 2.0 * square * share * self.weights[::_STEP].sum() ** 2 * len(stack)
        distinct = rival > own + by_noise + np.maximum(_DEVIATIONS * spread, _SHIFT_OF_MEAN_PX**2 * slope)
        # Rivals that move to the place of the fit are minima of noise.
        distinct |= moved <= _STAY * np.hypot(rivals[:, 2], rivals[:, 3])
        return np.asarray(distinct & (share > _LEAST_COMMON_OF_MEAN))

    def _extend(self, rivals: Map) -> None:
        """Compute the mean image around windows."""
        where = np.zeros(self.variance.shape, dtype=np.bool_)
        reach = len(self.weights) // 2 + 3
        across, down = (reach + margin for margin in self.margin)
        for row, column in np.unique(rivals[:, :2].astype(int), axis=0):
            where[max(row - down, 0) : row + down + 1, max(column - across, 0) : column + across + 1] = True
        self.mean.extend(where)

    def _share(self, rivals: Map) -> Map:
        """Return the mean noise share in the windows of rivals as a map, 1 where no pixel is available."""
        reach = len(self.weights) // 2
        out = np.ones_like(self.mean.share)
        for row, column in np.unique(rivals[:, :2].astype(int), axis=0):
            window = self.mean.share[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
            available = np.isfinite(window)
            out[row, column] = window[available].mean() if available.any() else 1.0
        return out


def _still(mean: MeanImage) -> ImageView:
    """Return a view of two images in which every pixel is at its own place."""
    zero = np.zeros(2)
    return ImageView(zero, zero, zero, np.zeros((2, 4)), 1.0, 0.0, 0.0, mean.spline, 0.0, 0.0, NO_LENS)


def find_equal_rivals(candidates: Map, flags: Mask, compared: ImageComparison, mean: MeanComparison) -> None:
    """Set the windows of which a candidate fits as well, of a grid, testing the candidates of each in their order.

    ``candidates``: As for `ImageComparison.find_equal`.
    ``flags``: Windows with such a candidate, shape (rows, columns).
    """
    orders = candidates[:, 4]
    windows: tuple[Any, Any] = (candidates[:, 5].astype(np.intp), candidates[:, 6].astype(np.intp))
    following = np.zeros(flags.shape)
    while True:
        equal = np.zeros(len(candidates), dtype=np.bool_)
        worse, pending = equal.copy(), flags.copy()
        for order in np.unique(orders):
            tested = np.flatnonzero((orders == order) & (following[windows] <= order) & ~pending[windows])
            if tested.size:
                equal[tested], worse[tested] = compared.find_equal(candidates[tested])
                again = tested[equal[tested]]
                pending[windows[0][again], windows[1][again]] = True
        found = np.flatnonzero(equal)
        if not found.size:
            return
        distinct = np.zeros(len(candidates), dtype=np.bool_)
        doubtful = np.flatnonzero(equal & worse)
        if doubtful.size:
            distinct[doubtful] = mean.find_distinct(candidates[doubtful])
        ambiguous = found[~distinct[found]]
        flags[windows[0][ambiguous], windows[1][ambiguous]] = True
        # Windows without an equal candidate are finished, the others go on after it.
        following[:] = np.inf
        following[windows[0][found], windows[1][found]] = orders[found] + 1
