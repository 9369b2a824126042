"""Motions in the world: models and the point maps that they define."""

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
