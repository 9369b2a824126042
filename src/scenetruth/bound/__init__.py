"""Cramér-Rao bound of depth and motion, at every pixel of a scene and in closed form."""

from scenetruth.bound.closed_form import ClosedFormBound, closed_form_bound, texture_gradient
from scenetruth.bound.cramer_rao import cramer_rao_bound
from scenetruth.bound.motion_selection import MapNeighbourhood, PointNeighbourhood, select_affine

__all__ = [
    "ClosedFormBound",
    "MapNeighbourhood",
    "PointNeighbourhood",
    "closed_form_bound",
    "cramer_rao_bound",
    "select_affine",
    "texture_gradient",
]
