"""The images that are fitted together, and where they were taken."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.bad.pixels import SoundFrames
from scenetruth.threads import in_threads

__all__ = ["FramesNeeded", "Splines", "frames_needed"]


@dataclass(frozen=True)
class FramesNeeded:
    """The frames behind one estimate, as places along t."""

    output: int
    """The frame that is estimated."""
    first: int
    """The first frame that is fitted."""
    last: int
    """The one behind the last."""


def frames_needed(count: int, window: int, *, every: bool) -> list[FramesNeeded]:
    """Tell which frames are estimated, and from which.

    Parameters
    ----------
    count
        Number of frames of the recording.
    window
        Number of frames to be fitted together, at most.
    every
        Whether frames are estimated whose window does not lie inside the recording; it is cut there.

    Returns
    -------
    list of FramesNeeded
        In the order of time. For an even window, one frame more comes after the estimated one than before.

    Examples
    --------
    >>> [frames.output for frames in frames_needed(9, 9, every=False)]
    [4]
    >>> frames_needed(3, 9, every=True)[0]
    FramesNeeded(output=0, first=0, last=3)
    """
    window = window if every else min(window, count)
    before = (window - 1) // 2
    after = window - before
    return [
        FramesNeeded(n, max(n - before, 0), min(n + after, count))
        for n in range(count)
        if every or (n >= before and n + after <= count)
    ]


class Splines:
    """Coefficients of splines through the images of a window of frames; frames are transformed once.

    Parameters
    ----------
    images
        Reads the images.
    order
        Order of the splines, 3 or 5.
    """

    def __init__(self, images: SoundFrames, order: int) -> None:
        self._images, self._order = images, order
        self._held: dict[int, NDArray[np.float32]] = {}

    def frames(self, first: int, last: int) -> list[NDArray[np.float32]]:
        """Return the coefficients of successive frames, shape (channel, s, y, x) each.

        Parameters
        ----------
        first, last
            The first frame, and the one behind the last, as places along t.
        """
        for frame in [frame for frame in self._held if not first <= frame < last]:
            del self._held[frame]
        for frame in range(first, last):
            if frame not in self._held:
                self._held[frame] = _coefficients(self._images.frames(frame, frame + 1)[:, :, 0], self._order)
        return [self._held[frame] for frame in range(first, last)]


def _coefficients(images: NDArray[Any], order: int) -> NDArray[np.float32]:
    from scipy.ndimage import spline_filter

    out = np.empty(images.shape, dtype=np.float32)

    def transform(index: tuple[int, int]) -> None:
        out[index] = spline_filter(images[index].astype(np.float64), order, mode="mirror")

    in_threads(transform, list(np.ndindex(images.shape[:2])))
    return out
