"""The union of all kinds of motion, for whatever moves in the world."""

from typing import TYPE_CHECKING

from scenetruth.kinds import one_of
from scenetruth.scene.motion import MotionModel

__all__ = ["Motion"]

if TYPE_CHECKING:
    Motion = MotionModel
else:
    Motion = one_of(MotionModel, "scenetruth.scene.motion")
