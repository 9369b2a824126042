"""The union of all kinds of deformation that follow a formula, for objects and for the leaves of plants."""

from typing import TYPE_CHECKING

from scenetruth.kinds import one_of
from scenetruth.scene.deformation import DeformationModel

__all__ = ["Deformation"]

if TYPE_CHECKING:
    Deformation = DeformationModel
else:
    Deformation = one_of(DeformationModel, "scenetruth.scene.deformation")
