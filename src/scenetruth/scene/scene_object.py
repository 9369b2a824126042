"""An object of a scene: its mesh, texture, pose, deformations and motions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import ValidationInfo, field_validator

from scenetruth.discovery import discriminated_union
from scenetruth.scene.deformation import OwnFrameModel
from scenetruth.scene.mesh import MeshModel
from scenetruth.scene.mesh.mesh_file import FileMesh
from scenetruth.scene.motion.rigid_motions import Motion
from scenetruth.scene.texture import TextureModel
from scenetruth.scene.vertex_animation import VertexModel
from scenetruth.validated_model import Direction, Finite, FrozenModel, Name, Vector3

__all__ = ["Pose", "Rotation", "SceneObject", "Texture"]


class Rotation(FrozenModel):
    """A rotation about an axis through the object's origin (right-hand rule: X towards Y about Z)."""

    axis: Direction
    """Direction of the axis."""
    angle_deg: Finite
    """Angle in degrees."""


class Pose(FrozenModel):
    """Where an object stands at t = 0: rotated first, in the given order, then moved to its position."""

    position_mm: Vector3 = (0.0, 0.0, 0.0)
    """World position of the mesh's origin in mm."""
    rotations: tuple[Rotation, ...] = ()
    """Rotations about fixed axes, applied one after the other."""


if TYPE_CHECKING:
    AnyDeformation = OwnFrameModel
    Mesh = MeshModel
    Texture = TextureModel
else:
    AnyDeformation = discriminated_union(
        OwnFrameModel, "scenetruth.scene.deformation", "scenetruth.scene.vertex_animation"
    )
    Mesh = discriminated_union(MeshModel, "scenetruth.scene.mesh", "scenetruth.scene.leaf")
    Texture = discriminated_union(TextureModel, "scenetruth.scene.texture", "scenetruth.scene.leaf")


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
        given = [index for index, entry in enumerate(value) if isinstance(entry, VertexModel)]
        mesh = info.data.get("mesh")
        if given and (given != [0] or not (mesh is None or isinstance(mesh, FileMesh))):
            msg = f"'{value[given[-1]].kind}' says where the vertices of a mesh file are: "
            msg += "it must be the first deformation and the only one of its sort, of a mesh of kind 'file'"
            raise ValueError(msg)
        return value
