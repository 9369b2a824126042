"""Motions in the world: each type is a model and the map of points that it defines."""

from scenetruth.scene.motion.point_maps import (
    MotionModel,
    MovedPoints,
    PointMap,
    Points,
    apply,
    compose,
    pose_map,
    to_moved_points,
)

__all__ = [
    "MotionModel",
    "MovedPoints",
    "PointMap",
    "Points",
    "apply",
    "compose",
    "pose_map",
    "to_moved_points",
]
