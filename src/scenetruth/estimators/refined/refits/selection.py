"""Which of several surfaces every pixel shows: models of its neighbours are offered, and the images judge."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.bands import pieces
from scenetruth.estimators.refined.blocks import BLOCK_PX, brightness_of_blocks, even_brightness
from scenetruth.estimators.refined.images import Images
from scenetruth.estimators.refined.kernels.judge import SIDES, judge_rows
from scenetruth.estimators.refined.parameters import carried, fields_of
from scenetruth.estimators.refined.seen import local_means
from scenetruth.threads import in_threads

__all__ = ["Selection"]

Map = NDArray[np.float64]

# The images of one side alone must agree better by this than all of them do.
_SIDE_COST = 1.05
# So much of a pixel's neighbourhood must be judged.
_LEAST = 0.3
# Models that move a point by more than this in any image are of different surfaces.
_DIFFERENT_PX = 0.5


class Selection:
    """The best model of every pixel so far.

    Parameters
    ----------
    images
        The images that judge.
    theta
        Parameters to begin with, shape (15 or 18, y, x).
    where
        Pixels to be judged, shape (y, x).
    noise
        Standard deviation of what the images leave by noise alone.
    steady
        Pixels that tell the images' brightness, shape (y, x); without, it is the same in all.
    """

    def __init__(
        self,
        images: Images,
        theta: Map,
        where: NDArray[np.bool_],
        noise: float,
        steady: NDArray[np.bool_] | None = None,
    ) -> None:
        self._images, self._where, self._square = images, where, noise**2
        self._stacks = [images.stack(channel) for channel in range(images.channels)]
        self._bad = images.bad_stack()
        view, fields = images.view(), np.ascontiguousarray(fields_of(theta))
        self._brightness = [
            even_brightness(len(stack))
            if steady is None
            else brightness_of_blocks(stack, view, fields, self._bad, steady)
            for stack in self._stacks
        ]
        self.theta = theta.copy()
        self.cost = self._judge(theta)
        """What the images leave with it, in squares of the noise."""
        self.rival = np.full(images.shape, np.inf, dtype=np.float32)
        """The same for the best model of another surface that was offered."""

    def offer(self, theta: Map) -> None:
        """Take models where they explain the images better.

        Parameters
        ----------
        theta
            Parameters, shape (15 or 18, y, x); NaN where there are none.
        """
        cost = self._judge(theta)
        with np.errstate(invalid="ignore"):
            moved = self._images.moved_px(fields_of(self.theta), fields_of(theta))
            other = ~(moved <= _DIFFERENT_PX)
            # No worse than by what noise may do: models that came first stay.
            better = cost < self.cost - 0.03
        worse = np.where(better, self.cost, cost)
        self.rival[other] = np.minimum(self.rival, worse)[other]
        self.theta[:, better] = theta[:, better]
        self.cost[better] = cost[better]

    def spread(self, distance: int) -> None:
        """Offer every pixel the models of eight others in turn.

        Parameters
        ----------
        distance
            How far away they are, in rows and columns.
        """
        for down in (-distance, 0, distance):
            for right in (-distance, 0, distance):
                if right or down:
                    self.offer(carried(self.theta, right, down))

    def _judge(self, theta: Map) -> NDArray[np.float32]:
        fields = np.where(self._where, fields_of(theta), np.nan)
        sides = np.empty((SIDES, *self._images.shape), dtype=np.float32)
        best = np.full(self._images.shape, np.inf, dtype=np.float32)
        totals = np.zeros_like(sides)
        for stack, brightness in zip(self._stacks, self._brightness, strict=True):
            judge = partial(judge_rows, stack, self._images.view(), fields, self._bad, *brightness, BLOCK_PX, sides)
            in_threads(judge, pieces(0, self._images.shape[0]))
            totals += sides / len(self._stacks)
        for side in range(SIDES):
            known = np.isfinite(totals[side])
            share = local_means(known.astype(np.float32))
            mean = local_means(np.where(known, totals[side], 0.0)) / np.maximum(share, _LEAST)
            cost = np.where(share > _LEAST, mean, np.inf) * (1.0 if side == 0 else _SIDE_COST)
            best = np.minimum(best, cost / self._square)
        return best
