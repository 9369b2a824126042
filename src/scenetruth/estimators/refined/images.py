"""The images of a window of frames, ready to be warped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.warp import View

__all__ = ["Images"]

Map = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Images:
    """Images that are fitted together.

    Parameters
    ----------
    coefficients
        Coefficients of their splines by frame, shape (channel, s, y, x) each.
    positions
        Positions (s, s_y) of the cameras in steps, shape (cameras, 2).
    times
        Times of the frames after the estimated one.
    focal, centre
        Focal length, and principal point (x, y), in columns and rows.
    moved
        How far every image is from where it should be, in the order of `stack`, as of `warp.corrected`, shape (n, 4).
    """

    coefficients: list[NDArray[np.float32]]
    positions: Map
    times: Map
    focal: float
    centre: tuple[float, float]
    moved: Map

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        height, width = self.coefficients[0].shape[-2:]
        return height, width

    @property
    def channels(self) -> int:
        """Number of colour channels."""
        return len(self.coefficients[0])

    @property
    def farthest(self) -> float:
        """Distance of the farthest camera, in steps."""
        return float(np.hypot(*self.positions.T).max())

    @property
    def longest(self) -> float:
        """Time to the farthest frame, in frames."""
        return float(np.abs(self.times).max())

    @property
    def aside(self) -> float:
        """By how many px U_Z = Z moves a point at an end of the image per frame, over those that U_X = Z does."""
        return max(self.centre) / self.focal

    def within(self, reach: float) -> Images:
        """Return the images of the frames up to so many before and after."""
        return self._of(np.flatnonzero(np.abs(self.times) <= reach))

    def few(self) -> Images:
        """Return the images of the first frame, the estimated one and the last."""
        return self._of(np.unique([np.argmin(self.times), np.argmin(np.abs(self.times)), np.argmax(self.times)]))

    def _of(self, frames: NDArray[np.intp]) -> Images:
        kept = [self.coefficients[n] for n in frames]
        moved = self.moved.reshape(len(self.times), -1, 4)[frames].reshape(-1, 4)
        return Images(kept, self.positions, self.times[frames], self.focal, self.centre, moved)

    def stack(self, channel: int) -> NDArray[np.float32]:
        """Return the coefficients of one channel, camera by camera within each frame, shape (n, y, x)."""
        return np.concatenate([part[channel] for part in self.coefficients])

    def view(self) -> View:
        """Return where and when all images were taken, in the order of `stack`."""
        s, s_y = np.tile(self.positions.T, len(self.times))
        t = np.repeat(self.times, len(self.positions))
        return View(s, s_y, t, self.moved, self.focal, *self.centre)

    def moved_px(self, before: Map, after: Map) -> Map:
        """Return by how much a change of d and q, shape (4, ...) each, moves points where it moves them most, in px."""
        steps = np.abs(after - before)
        moved = steps[0] * self.farthest
        for step, arm in zip(steps[1:], (1.0, 1.0, self.aside), strict=True):
            moved = np.maximum(moved, step * np.abs(before[0]) * self.longest * arm)
        return np.asarray(moved)
