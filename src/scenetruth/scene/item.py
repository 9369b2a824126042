"""An object of a scene: its shape, what is seen on it, where it stands, and how it deforms and moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import ValidationInfo, field_validator

from scenetruth.kinds import one_of
from scenetruth.model import FrozenModel, Name
from scenetruth.scene.deformation import OwnFrameModel
from scenetruth.scene.mesh import MeshModel
from scenetruth.scene.mesh.file import FileMesh
from scenetruth.scene.motions import Motion
from scenetruth.scene.nodal import NodalModel
from scenetruth.scene.pose import Pose
from scenetruth.scene.texture import TextureModel

__all__ = ["AnyDeformation", "Mesh", "SceneObject", "Texture"]

if TYPE_CHECKING:
    AnyDeformation = OwnFrameModel
    Mesh = MeshModel
    Texture = TextureModel
else:
    AnyDeformation = one_of(OwnFrameModel, "scenetruth.scene.deformation", "scenetruth.scene.nodal")
    Mesh = one_of(MeshModel, "scenetruth.scene.mesh", "scenetruth.scene.leaf")
    Texture = one_of(TextureModel, "scenetruth.scene.texture", "scenetruth.scene.leaf")


class SceneObject(FrozenModel):
    """A textured mesh that stands and moves before the camera."""

    name: Name
    """Name, unique in the scene; keys the object's random numbers."""
    mesh: Mesh
    """Its shape."""
    texture: Texture
    """Its surface."""
    pose: Pose = Pose()
    """Where it stands at t = 0."""
    deformation: tuple[AnyDeformation, ...] = ()
    """How it changes in its own frame, before it is posed; several deformations are applied one after the other."""
    motion: tuple[Motion, ...] = ()
    """How it moves in the world; several motions are applied one after the other."""

    @field_validator("deformation")
    @classmethod
    def _vertices_come_first(
        cls, value: tuple[AnyDeformation, ...], info: ValidationInfo
    ) -> tuple[AnyDeformation, ...]:
        given = [index for index, entry in enumerate(value) if isinstance(entry, NodalModel)]
        mesh = info.data.get("mesh")
        if given and (given != [0] or not (mesh is None or isinstance(mesh, FileMesh))):
            msg = f"'{value[given[-1]].kind}' says where the vertices of a mesh file are: "
            msg += "it must be the first deformation and the only one of its sort, of a mesh of kind 'file'"
            raise ValueError(msg)
        return value
