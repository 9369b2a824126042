"""What blur does to images of an object whose distance changes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.ndimage import laplace

from scenetruth.design.budget.sight import Change, Disturbance, Map, Sight

__all__ = ["growing_blur"]


def growing_blur(sight: Sight, variance: Callable[[Map, Map], Map]) -> Disturbance:
    """Return what it does that the blur of the texture changes over time.

    Parameters
    ----------
    sight
        The scene.
    variance
        By how much the blur's variance changes along x and along y, in px², referred to the texture as the reference
        shows it: a function of the share by which a point is seen larger, and of its depth in mm there and then.

    Notes
    -----
    A Gaussian blur whose variance grows by δ changes an image by δ/2 ∇²T.
    """
    curvature = 0.5 * laplace(sight.texture)

    def change(s: int, t: int) -> Change:
        place = sight.place(s, t)
        depth = sight.intrinsics.focal_length_px * sight.intrinsics.baseline_mm / (sight.points.d * place.scale)
        return Change(grey=np.asarray(variance(place.scale - 1, depth) * curvature))

    return change
