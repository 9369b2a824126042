"""Cramér-Rao bound of depth and motion, at every pixel of a scene and in closed form."""

from scenetruth.bound.closed_form import ClosedFormBound, closed_form_bound, texture_gradient
from scenetruth.bound.cramer_rao import cramer_rao_bound

__all__ = ["ClosedFormBound", "closed_form_bound", "cramer_rao_bound", "texture_gradient"]
