"""The images of a recording, read some frames at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

__all__ = ["FrameReader"]


class FrameReader:
    """Reads windows of frames from a recording; what two windows in a row have in common is read once.

    Parameters
    ----------
    recording
        A checked recording, in memory or opened from a store.

    Examples
    --------
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 9, 30, 40)), focal_length_px=500, baseline_mm=5)
    >>> reader = FrameReader(recording)
    >>> reader.shape, reader.frames(2, 5).shape, reader.missing()
    ((1, 2, 9, 30, 40), (1, 2, 3, 30, 40), 0)
    """

    def __init__(self, recording: xr.Dataset) -> None:
        self._image = image = recording["image"]
        sizes = image.sizes
        native = image.dtype.newbyteorder("=")
        self.dtype = native if native in (np.uint8, np.uint16) else np.dtype(np.float32)
        """Type in which images are given: uint8 and uint16 as recorded, all other types as float32."""
        cameras = sizes.get("s_y", 1) * sizes["s"]
        self.shape = (sizes.get("channel", 1), cameras, sizes["t"], sizes["y"], sizes["x"])
        """Numbers of channels, cameras (of a grid row by row), frames, rows and columns."""
        self._first = 0
        self._held: NDArray[Any] = np.empty((*self.shape[:2], 0, *self.shape[3:]), dtype=self.dtype)

    def frames(self, first: int, last: int) -> NDArray[Any]:
        """Return the images of successive frames.

        Parameters
        ----------
        first, last
            The first frame, and the one behind the last, as places along t.

        Returns
        -------
        numpy.ndarray
            Shape (channel, s, t, y, x), contiguous; it may be the recording's own memory.
        """
        held = self._first, self._first + self._held.shape[2]
        if held == (first, last):
            return self._held
        if first >= held[0] and first < held[1] < last:
            # Old images first, so that the new ones need not wait for memory of theirs.
            window = np.empty((*self.shape[:2], last - first, *self.shape[3:]), dtype=self.dtype)
            window[:, :, : held[1] - first] = self._held[:, :, first - held[0] :]
            window[:, :, held[1] - first :] = self._read(held[1], last)
        else:
            window = np.ascontiguousarray(self._read(first, last))
        self._first, self._held = first, window
        return window

    def missing(self) -> int:
        """Return how many values are not finite in the type in which images are given."""
        if self._image.dtype.kind != "f":
            return 0
        count = 0
        for frame in range(self.shape[2]):
            image = self._read(frame, frame + 1)
            # The sum is quick: it is finite only if all values are. If it overflows, the exact count decides.
            with np.errstate(over="ignore", invalid="ignore"):
                if not np.isfinite(image.sum()):
                    count += int((~np.isfinite(image)).sum())
        return count

    def _read(self, first: int, last: int) -> NDArray[Any]:
        values = self._image.isel(t=slice(first, last)).values
        values = np.moveaxis(values, -1, 0) if "channel" in self._image.dims else values[None]
        values = values.reshape(self.shape[0], self.shape[1], last - first, *self.shape[3:])
        with np.errstate(over="ignore"):
            return values.astype(self.dtype, copy=False)
