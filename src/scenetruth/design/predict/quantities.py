"""Units and titles of what is predicted, as of `scenetruth.scoring.QUANTITIES`: scores take long to load."""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["TITLES", "UNITS"]

UNITS: Mapping[str, str] = {
    "depth": "mm",
    "disparity": "px/step",
    "velocity_x": "mm/frame",
    "velocity_y": "mm/frame",
    "velocity_z": "mm/frame",
    "flow_x": "px/frame",
    "flow_y": "px/frame",
    "velocity_endpoint": "mm/frame",
    "growth_rate": "%/h",
    "growth_largest": "%/h",
    "growth_least": "%/h",
    "slope_x": "1",
    "slope_y": "1",
    "normal": "°",
}
"""Units by quantity, for people: data sets have growth per frame."""

TITLES: Mapping[str, str] = {
    "depth": "Depth",
    "disparity": "Disparity",
    "velocity_x": "Velocity in X",
    "velocity_y": "Velocity in Y",
    "velocity_z": "Velocity in Z",
    "flow_x": "Optical flow in x",
    "flow_y": "Optical flow in y",
    "velocity_endpoint": "Velocity endpoint",
    "growth_rate": "Growth rate",
    "growth_largest": "Largest growth of length",
    "growth_least": "Least growth of length",
    "slope_x": "Slope in X",
    "slope_y": "Slope in Y",
    "normal": "Normal",
}
"""What they are, in words."""
