"""Selection of the best model of every pixel by photo-consistency, with gain and offset of the images in blocks."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.fit_maps import (
    carried_to,
    extract_fields,
)
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels.photo_consistency import (
    LANES,
    carry_models,
    compute_costs,
    judge_pixels,
)
from scenetruth.estimators.refined.kernels.warp import ImageView, image_parts, warp_rows
from scenetruth.estimators.refined.row_bands import (
    NO_OCCLUSION,
)
from scenetruth.threads import in_threads

__all__ = [
    "BLOCK_PX",
    "GainOffset",
    "HypothesisSelection",
    "estimate_gain_offset",
    "list_arms",
    "split_pixels",
    "uniform_gain_offset",
]

Map = NDArray[np.float64]

BLOCK_PX = 32
"""Side length of a block in px."""
_LEAST_BLOCK_PIXELS = 64  # smallest number of pixels of a block
_RESIDUAL_OF_BLOCK = 1.5  # largest residual of a block, relative to the noise
_GAIN_STD, _LEAST_GAIN = 0.03, 0.1  # prior standard deviation of the gain of a block, and smallest gain


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
    noise: float,
) -> GainOffset:
    """Estimate gains and offsets of the images relative to their mean by regression in blocks over ``good`` pixels.

    Blocks with residuals beyond the ``noise`` contain pixels of wrong parameters: they take the values of the nearest
    others. The gain of an image in all blocks is the prior of that in blocks with little texture.
    """
    count, (height, width) = len(view.s), fields.shape[1:]
    down, across = -(-height // BLOCK_PX), -(-width // BLOCK_PX)
    sums = np.full((4, count, down, across), np.nan)
    square = np.full((down, across), np.inf)
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
                sums[:, used, block, column], square[block, column] = found

    in_threads(regress, range(down))
    # Gain, mean grey value of the image, mean grey value of the mean image, and its sum of squares about that.
    gain, mean, middle, squares = sums
    gain[~used], mean[~used], middle[~used], squares[~used] = 1.0, 0.0, 0.0, 1.0
    known = np.isfinite(gain).all(axis=0) & (gain > _LEAST_GAIN).all(axis=0)
    if not known.any():
        return uniform_gain_offset(count)
    fitting = known & (square <= (_RESIDUAL_OF_BLOCK * noise) ** 2)
    if fitting.any():
        known = fitting
    common = ((gain * squares)[:, known].sum(axis=1) / squares[:, known].sum(axis=1))[:, None, None]
    prior = (noise / _GAIN_STD) ** 2
    gain = (gain * squares + common * prior) / (squares + prior)
    offset = mean - gain * middle
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    values = (np.ascontiguousarray(each[:, nearest[0], nearest[1]], dtype=np.float32) for each in (gain, offset))
    return GainOffset(*values)


def _in_block(values: NDArray[np.float64], *, some_bad: bool) -> tuple[NDArray[np.float64], float] | None:
    """Regress images on their mean; ``values``: grey values, shape (n, pixels), NaN where invalid.

    Returns: Gains, mean grey values, those of the mean image at the same pixels, and its sums of squares about them,
    shape (4, n); and the mean square residual.
    """
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
    left = np.where(known, around - gain[:, None] * (texture - middle[:, None]), 0.0)
    # A gain and an offset of every image, and the mean image, are estimated.
    free = max(int(known.sum()) - values.shape[1] - 2 * len(values), 1)
    return np.stack([gain, means, middle + means.mean(), squares]), float((left**2).sum()) / free


_SIDE_COST = 1.05  # ratio by which the images of one side must agree better than all images
_LEAST_JUDGED_SHARE = 0.3  # smallest fraction of the neighbourhood of a pixel with a valid cost
_SAME_MODEL_PX = 0.03  # models that displace a point by less than this in all images lead to the same fit
_BETTER = 0.03  # decrease of the residual, in squares of the noise, below which the earlier of two models remains
_JUDGED_PIXELS = 4000  # number of pixels per thread task


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
        self._images, self._square = images, noise**2
        self._pixels = np.ascontiguousarray(np.argwhere(where))
        self._stacks = [images.stack(channel) for channel in range(images.channels)]
        self._bad = images.bad_stack()
        self._view, self._fields = images.view(), np.ascontiguousarray(extract_fields(theta))
        self._brightness = [
            uniform_gain_offset(len(self._view.s))
            if steady is None
            else estimate_gain_offset(stack, self._view, self._fields, self._bad, steady, noise)
            for stack in self._stacks
        ]
        self._arms = list_arms(images, len(self._fields))
        self.theta = theta.copy()
        """Parameters of the selected models."""
        self._sides = np.full((*images.shape, LANES), np.nan, dtype=np.float32)
        rows, columns = self._pixels.T
        self._sides[rows, columns] = self._judge(self._pixels)
        self._cost = self._residual(self._pixels)

    def offer(self, theta: Map) -> None:
        """Select models where they explain the images better; parameters are (15 or 18, y, x), NaN where invalid."""
        self._try(theta, 0, 0)

    def spread(self, distance: int) -> None:
        """Try the models of the eight pixels at a distance, at every pixel."""
        for down in (-distance, 0, distance):
            for right in (-distance, 0, distance):
                if right or down:
                    self._try(self.theta, right, down)

    def _try(self, source: Map, right: int, down: int) -> None:
        """Select the models of the pixels at an offset where they explain the images better."""
        moved = np.empty(len(self._pixels))
        fixed = source, self.theta, self._pixels, (right, down), self._arms, self._fields, moved
        in_threads(partial(carry_models, *fixed), split_pixels(len(self._pixels)))
        with np.errstate(invalid="ignore"):
            numbers = np.flatnonzero(moved > _SAME_MODEL_PX)
        pixels = self._pixels[numbers]
        rows, columns = pixels.T
        before = self._sides[rows, columns]
        self._sides[rows, columns] = self._judge(pixels)
        cost = self._residual(pixels)
        # The margin covers the effect of noise: of equivalent models, the earlier one remains.
        better = cost < self._cost[numbers] - _BETTER
        self._sides[rows[~better], columns[~better]] = before[~better]
        self._cost[numbers[better]] = cost[better]
        chosen = rows[better], columns[better]
        self.theta[:, *chosen] = carried_to(source, *chosen, right, down)

    def _judge(self, pixels: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the variances of the images of `SIDES` at pixels, NaN where not valid, shape (n, 8)."""
        total = np.zeros((len(pixels), LANES), dtype=np.float32)
        for stack, brightness in zip(self._stacks, self._brightness, strict=True):
            sides = np.full_like(total, np.nan)
            pair = brightness.gain, brightness.offset
            judge = partial(judge_pixels, stack, self._view, self._fields, self._bad, pair, BLOCK_PX, pixels, sides)
            in_threads(judge, split_pixels(len(pixels)))
            total += sides / len(self._stacks)
        return total

    def _residual(self, pixels: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the residual over pixels and their neighbours, in squares of the noise."""
        out = np.empty(len(pixels), dtype=np.float32)
        fixed = self._sides, pixels, _LEAST_JUDGED_SHARE, _SIDE_COST, out
        in_threads(partial(compute_costs, *fixed), split_pixels(len(pixels)))
        return out / np.float32(self._square)


def split_pixels(count: int) -> list[tuple[int, int]]:
    """Return the ranges of pixels of the thread tasks."""
    return [(n, min(n + _JUDGED_PIXELS, count)) for n in range(0, count, _JUDGED_PIXELS)]


def list_arms(images: ImageStack, fields: int) -> Map:
    """Return the displacements in px by a unit of disparity, and by one of velocity, as `ImageStack.moved_px`."""
    return images.arms(fields)
