"""Other views of the estimated frame, compared with the reference at given disparities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels.bare_surfaces import compare_pixels
from scenetruth.threads import in_bands

__all__ = ["OtherViews", "match_views"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ROUNDS = 4
_LEAST_PIXELS = 16
_NOISE, _BLUR_PX = 1.5, 0.3  # tolerated differences: deviations of the noise, and displacement


@dataclass(frozen=True, eq=False)
class OtherViews:
    """Other views of the frame in the row of the reference, with the brightness of the reference."""

    grey: NDArray[np.float32]
    """Grey values, shape (v, y, x)."""
    positions: Map
    """Positions in steps, shape (v,)."""
    shifts: Map
    """Displacements to the left due to errors of the poses, in px, shape (v,)."""

    @property
    def uncertainty(self) -> float:
        """Root of the mean squared displacement due to errors of the poses, in px."""
        return float(np.sqrt(np.mean(self.shifts**2))) if len(self.shifts) else 0.0

    def compare(self, disparity: Map, grey: Map, noise: float) -> Map:
        """Return the mean squared difference of every pixel on the side of the views that agrees better.

        The unit is the sum of the variances of noise and of 0.3 px of displacement.
        """
        from scipy.ndimage import maximum_filter1d

        slope = maximum_filter1d(np.abs(np.gradient(grey, axis=1)), 3, axis=1)
        out = np.empty(grey.shape)
        views = (self.grey, self.positions, self.shifts)
        in_bands(compare_pixels, len(grey), disparity, grey, slope, *views, _NOISE * noise, _BLUR_PX, out, least=16)
        return out


def match_views(images: ImageStack, grey: Map, disparity: Map, where: Mask) -> OtherViews:
    """Return the other views, with gain, offset and shift that match the reference at the pixels of a mask.

    ``grey``: Reference image.
    ``disparity``: In columns per step, used within the mask.
    """
    frame, camera = images.reference()
    y, x = np.nonzero(where)
    of_reference, d, slope = grey[y, x], disparity[y, x], np.gradient(grey, axis=1)[y, x]
    views, positions, shifts = [], [], []
    for other, (s, s_y) in enumerate(images.positions):
        if other == camera or s_y != images.positions[camera, 1] or (frame, other) in images.left_out:
            continue
        view = (
            sum((images.grey(frame, other, n) for n in range(images.channels)), np.zeros_like(grey)) / images.channels
        )
        there = x - d * (s - images.positions[camera, 0])
        left = np.floor(there).astype(np.int64)
        inside = (left >= 0) & (left + 1 < grey.shape[1])
        here, across, row, left = of_reference[inside], slope[inside], y[inside], left[inside]
        part = there[inside] - left
        seen = (1 - part) * view[row, left] + part * view[row, left + 1]
        gain, offset, shift = 1.0, 0.0, 0.0
        close = np.ones(len(here), dtype=np.bool_)
        for _ in range(_ROUNDS):
            if close.sum() < _LEAST_PIXELS:
                break
            design = np.stack([seen[close], np.ones(close.sum()), -across[close]], axis=1)
            gain, offset, shift = np.linalg.lstsq(design, here[close])[0].tolist()
            off = np.abs(here - gain * seen - offset + shift * across)
            close = off <= 3.0 / 0.6745 * np.median(off)
        views.append((gain * view + offset).astype(np.float32))
        positions.append(s - images.positions[camera, 0])
        shifts.append(shift)
    return OtherViews(np.array(views).reshape(-1, *grey.shape), np.array(positions), np.array(shifts))
