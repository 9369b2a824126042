"""Acquisition schedule of a fit: times of the images of a scan, and rolling shutters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.estimators.refined.image_stack import FramesNeeded, ImageStack
from scenetruth.schema import compute_pixel_grid, read_acquisition, read_intrinsics

__all__ = ["AcquisitionTimes", "read_schedule", "remove_delay_bias"]

Map = NDArray[np.float64]

_ROUNDING = 1e-9  # frames below which a time is that of its frame


@dataclass(frozen=True, eq=False)
class AcquisitionTimes:
    """Planned times of all images, in frames."""

    times: Map
    """Times of the images of the reference camera, shape (frames,)."""
    delays: Map | None
    """Times of all images after that of the reference camera, shape (frames, cameras); None if they are equal."""
    shutter: tuple[float, float]
    """Rolling shutter: frames and stage steps from one row to the next."""

    def delays_of(self, frames: FramesNeeded) -> Map | None:
        """Return the delays of the frames of a fit."""
        return None if self.delays is None else self.delays[frames.first : frames.last]


def read_schedule(recording: xr.Dataset, positions: Map) -> AcquisitionTimes:
    """Read the times of a recording; the reference is the camera nearest to position 0, as of an `ImageStack`.

    ``positions``: Positions (s, s_y) of the cameras in steps, shape (cameras, 2).
    """
    acquisition, intrinsics = read_acquisition(recording), read_intrinsics(recording)
    interval = intrinsics.frame_interval_s
    times = acquisition.time_s.reshape(len(positions), -1).T / interval
    # Frames are numbered from 0 at the reference.
    own = times[:, int(np.argmin(np.abs(positions).sum(axis=1)))]
    delays = times - own[:, None]
    even = np.rint(own)
    own = np.where(np.abs(own - even) < _ROUNDING, even, own)
    row_s = acquisition.line_time_s * compute_pixel_grid(recording).step_px
    step = row_s * acquisition.stage_speed_mm_per_s / intrinsics.baseline_mm if intrinsics.baseline_mm else 0.0
    return AcquisitionTimes(
        own, delays if np.abs(delays).max(initial=0.0) > _ROUNDING else None, (row_s / interval, step)
    )


_LEAST_FACTOR = 0.5  # smallest ratio to the apparent disparity: a flow of half of it from camera to camera


def remove_delay_bias(fields: Map, images: ImageStack) -> None:
    """Correct initial fields, shape (4, y, x), for motion from camera to camera, in place.

    Cameras that are taken s τ later, in frames, show the disparity d - τ (u - x u_Z / f) in place of d, with the
    flow u = d q of the fields, which is that of the images whatever the disparity.
    """
    frame, _ = images.reference()
    s = images.positions[:, 0]
    if images.delays is None or not s.any():
        return
    later = float(s @ images.delays[frame] / (s @ s))
    x = np.arange(images.shape[1]) - images.centre[0]
    factor = 1.0 + later * (fields[1] - x * fields[3] / images.focal)
    factor = np.clip(factor, _LEAST_FACTOR, 1.0 / _LEAST_FACTOR)
    fields[0] *= factor
    fields[1:] /= factor
