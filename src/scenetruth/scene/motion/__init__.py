"""Motions in the world: every kind is a module that holds its model and its map."""

from scenetruth.scene.motion.base import MotionModel, Moved, PointMap, Points
from scenetruth.scene.motion.maps import apply, compose, moved_of, pose_map

__all__ = [
    "MotionModel",
    "Moved",
    "PointMap",
    "Points",
    "apply",
    "compose",
    "moved_of",
    "pose_map",
]
