"""The images that the viewer can show: those of all cameras at one frame, and of the reference camera at all frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.scoring.alignment import select_pixels
from scenetruth.scoring.report.viewer.limits import value_limits
from scenetruth.scoring.report.viewer.packing import PackedMap, pack_map

__all__ = ["Images", "PackedImage", "images_of"]

_THINNED = 1.2
"""By how much more than its share of the pixels a thinned image takes: differences between neighbours grow."""
_COARSEST = 4
"""Thinner than every fourth pixel, images are of no use: some are left out then."""


@dataclass(frozen=True)
class PackedImage:
    """One image.

    Parameters
    ----------
    row, camera, frame
        Its s_y, s and t.
    step
        Every how manieth row and column of the reference image it has.
    packed
        Its grey values.
    """

    row: int
    camera: int
    frame: int
    step: int
    packed: PackedMap


@dataclass(frozen=True)
class Images:
    """The images of a page.

    Parameters
    ----------
    shown
        Those that it has, the reference camera's at the reference frame first.
    cameras, frames
        The cameras (s_y, s) and the frames t of the recording.
    left_out
        How many of those wanted it has not.
    units
        What the grey values are.
    limits
        Low and high of the range that is shown at first.
    """

    shown: Sequence[PackedImage]
    cameras: Sequence[tuple[int, int]]
    frames: Sequence[int]
    left_out: int
    units: str
    limits: tuple[float, float]


def images_of(recording: xr.Dataset, estimate: xr.Dataset, frame: int, step: int, budget: int) -> Images:
    """Pick and pack images.

    Parameters
    ----------
    recording
        The recording.
    estimate
        The estimate, whose pixels are taken.
    frame
        The reference frame t.
    step
        Every how manieth row and column of the reference image is kept.
    budget
        How many characters all but the reference image may take; thinned more, or left out, where they would take more.
    """
    every = select_pixels(recording, estimate)["image"]
    frames = [int(t) for t in every["t"].values]
    at = frame if frame in frames else 0 if 0 in frames else frames[len(frames) // 2]
    rows = [int(s) for s in every["s_y"].values] if "s_y" in every.dims else [0]
    columns = [int(s) for s in every["s"].values] if "s" in every.dims else [0]
    cameras = [(row, column) for row in rows for column in columns]

    def read(row: int, camera: int, t: int, step: int) -> NDArray[np.generic]:
        chosen = {"s_y": row, "s": camera, "t": t}
        image = every.sel({dim: value for dim, value in chosen.items() if dim in every.dims})
        grey = image.mean("channel") if "channel" in image.dims else image
        return np.asarray(grey.values[::step, ::step])

    reference = read(0, 0, at, step)
    limits = value_limits(reference.astype(np.float64))
    first = PackedImage(0, 0, at, 1, pack_map(reference, limits))
    others = [(*camera, at) for camera in cameras if camera != (0, 0)]
    others += [(0, 0, t) for t in sorted(frames, key=lambda t: abs(t - at)) if t != at]
    room = budget / max(first.packed.size, 1)
    coarser = 1 if len(others) <= room else math.ceil(math.sqrt(_THINNED * len(others) / room))
    wanted = len(others)
    if coarser > _COARSEST:
        coarser = _COARSEST
        keep = max(1, int(room * coarser**2 / _THINNED))
        # Evenly over all, so that both the cameras and the frames are seen.
        others = [others[n * wanted // keep] for n in range(keep)] if keep < wanted else others
    shown, used = [first], 0
    for row, camera, t in others:
        packed = pack_map(read(row, camera, t, step * coarser), limits)
        used += packed.size
        if used > _THINNED * budget:
            break
        shown.append(PackedImage(row, camera, t, coarser, packed))
    units = "DN" if every.dtype.kind in "ui" else "1"
    return Images(shown, cameras, frames, wanted - len(shown) + 1, units, limits)
