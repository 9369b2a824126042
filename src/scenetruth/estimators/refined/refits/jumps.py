"""Jumps between the surfaces of neighbouring pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.images import Images
from scenetruth.estimators.refined.parameters import carried, fields_of

__all__ = ["JUMP_PX", "jumps", "mixed"]

JUMP_PX = 0.5
"""Neighbours whose own parameters move a point by more than this against each other's are of different surfaces."""
# Neighbours on whose other surface a pixel in front may show in part.
_MIXED_BY = ((1, 0), (-1, 0), (0, 1), (0, -1), (2, 0), (-2, 0), (0, 2), (0, -2))

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


def jumps(images: Images, theta: Map) -> Mask:
    """Tell where the surface of a pixel's neighbour is not its own, or unknown."""
    found = np.zeros(images.shape, dtype=np.bool_)
    for right, down in ((1, 0), (0, 1)):
        with np.errstate(invalid="ignore"):
            moved = images.moved_px(fields_of(theta), fields_of(carried(theta, right, down)))
        jump = ~(moved <= JUMP_PX)
        jump[:down], jump[:, :right] = False, False
        found |= jump
    return found


def mixed(images: Images, theta: Map) -> Mask:
    """Tell which pixels lie in front within 2 px of a jump: the outline's blur carries the nearer surface too far."""
    found = np.zeros(images.shape, dtype=np.bool_)
    for right, down in _MIXED_BY:
        beside = fields_of(carried(theta, right, down))
        with np.errstate(invalid="ignore"):
            found |= (images.moved_px(fields_of(theta), beside) > JUMP_PX) & (np.abs(theta[0]) > np.abs(beside[0]))
    return found
