"""Motions in the world: models and the point maps that they define."""

from scenetruth.scene.motion.motion_presets import MOTION_PRESETS
from scenetruth.scene.motion.point_maps import (
    MotionModel,
    MovedPoints,
    PointMap,
    Points,
    apply,
    compose,
    pose_map,
    rotate_points,
    to_moved_points,
)
from scenetruth.scene.motion.rigid_motions import ConstantRotation, ConstantVelocity, Exponential, Motion

__all__ = [
    "MOTION_PRESETS", "ConstantRotation", "ConstantVelocity", "Exponential", "Motion", "MotionModel", "MovedPoints",
    "PointMap", "Points", "apply", "compose", "pose_map", "rotate_points", "to_moved_points",
]  # fmt: skip
