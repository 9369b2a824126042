"""A start by plane sweep, from another image where that of the reference does not suit the others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.refined.bad.images import agreement
from scenetruth.estimators.refined.bad.pixels import SoundFrames
from scenetruth.estimators.refined.frames import FramesNeeded
from scenetruth.estimators.refined.images import Images
from scenetruth.estimators.refined.start import Rig, Start, filled, swept_fields

__all__ = ["brought_back", "sound_start"]

# Images agree in so large a share of the textured blocks, or other images are tried; what they find is taken if it
# makes the images agree in so many times as many.
_ENOUGH, _BETTER = 0.5, 1.25
_MEDIAN_PX = 5

Map = NDArray[np.float64]


def sound_start(frames: SoundFrames, needed: FramesNeeded, images: Images, rig: Rig, sigma_px: float) -> Start:
    """Find disparity and velocity of every pixel of the reference, as `swept_fields`.

    Parameters
    ----------
    frames
        Reads the images.
    needed
        The frames that are fitted.
    images
        The same images, to ask which start makes them agree.
    rig
        The cameras.
    sigma_px
        Standard deviation of the windows.

    Raises
    ------
    EstimateError
        If no image shows anything to start from.
    """
    near = images.within(1.0)
    reference, middle = int(np.argmin(np.hypot(*rig.positions.T))), needed.output - needed.first
    row = np.flatnonzero(rig.positions[:, 1] == rig.positions[reference, 1]).tolist()
    others = sorted(row, key=lambda n: abs(rig.positions[n, 0]))[1:3]
    # Frames and cameras to start from, with the frames before and behind, one of both, and beside.
    anchors = [(middle, reference, 1, 1), (middle, reference, 0, 1), (middle, reference, 1, 0)]
    anchors += [(n, reference, 1, 1) for n in (middle + 1, middle - 1)] + [(middle, n, 1, 1) for n in others]
    best: Start | None = None
    most, reason = 0.0, ""
    tried = set()
    for frame, camera, before, behind in anchors:
        first, last = max(frame - before, 0), min(frame + behind + 1, len(images.times))
        # At the ends of a window there is nothing before, or behind.
        if not 0 <= frame < len(images.times) or (frame, camera, first, last) in tried:
            continue
        tried.add((frame, camera, first, last))
        values = frames.frames(needed.first + first, needed.first + last).astype(np.float32, copy=False)
        own = Rig(rig.positions - rig.positions[camera], rig.baseline_mm, rig.focal, rig.centre)
        try:
            found = swept_fields(values, frame - first, images.times[first:last] - images.times[frame], own)
        except EstimateError as error:
            reason = reason or error.problems[0].message
            continue
        if (frame, camera) != (middle, reference):
            fields = brought_back(found.fields, float(rig.positions[camera, 0]), float(images.times[frame]), rig)
            found = Start(fields, np.zeros_like(found.known))
        share = agreement(near, found.fields, sigma_px, even=True).blocks
        if best is None or share > _BETTER * most:
            best, most = found, share
        if most >= _ENOUGH or len(near.times) * len(rig.positions) < 3:
            break
    if best is None:
        raise EstimateError([Problem("image", reason)])
    return best


def brought_back(fields: Map, s: float, t: float, rig: Rig) -> Map:
    """Return fields at the pixels of the reference, from those at the pixels of another image.

    What stands at p = (x, y, f) / d from the camera at s steps at the time t is at p + (s, 0, 0) - t q from the
    reference at time 0. Of points that fall on one pixel, the nearest counts; pixels between are filled from those
    beside.

    Parameters
    ----------
    fields
        d and q, shape (4, y, x).
    s, t
        Where and when the other image was taken.
    rig
        The cameras.
    """
    _, height, width = fields.shape
    d, q_x, q_y, q_z = fields
    y, x = np.mgrid[:height, :width].astype(np.float64)
    x, y = x - rig.centre[0], y - rig.centre[1]
    scale = 1.0 / (1.0 - t * d * q_z / rig.focal)
    to_x = np.rint((x + d * (s - t * q_x)) * scale + rig.centre[0])
    to_y = np.rint((y - d * t * q_y) * scale + rig.centre[1])
    own = d * scale
    inside = (to_x >= 0) & (to_x < width) & (to_y >= 0) & (to_y < height) & (own * d > 0)
    order = np.argsort(np.abs(own[inside]), kind="stable")
    rows, columns = (at[inside][order].astype(np.intp) for at in (to_y, to_x))
    out, known = np.zeros_like(fields), np.zeros((height, width), dtype=np.bool_)
    # Of several values for one place, the last stays.
    for n, values in enumerate((own, q_x, q_y, q_z)):
        out[n, rows, columns] = values[inside][order]
    known[rows, columns] = True
    return filled(out, known, _MEDIAN_PX) if known.any() else fields.copy()
