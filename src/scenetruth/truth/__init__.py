"""Exact maps of what the camera sees: a geometry pass of its own at pixel centres, in float64."""

from scenetruth.truth.maps import GeometryPass, truth_maps

__all__ = ["GeometryPass", "truth_maps"]
