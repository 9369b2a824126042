"""Exact maps of what the camera sees: a geometry pass of its own at pixel centres, in float64."""

from scenetruth.truth.maps import GeometryPass, truth_maps
from scenetruth.truth.rolling import truth_by_rows

__all__ = ["GeometryPass", "truth_by_rows", "truth_maps"]
