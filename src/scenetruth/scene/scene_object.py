"""Object of a scene: mesh, texture, pose, deformations and motions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import ValidationInfo, field_validator

from scenetruth.bands import BandNonNegative
from scenetruth.discovery import discriminated_union
from scenetruth.scene.deformation import OwnFrameModel
from scenetruth.scene.material import MATT, Material, MaterialOwner
from scenetruth.scene.mesh import MeshModel
from scenetruth.scene.mesh.mesh_file import FileMesh
from scenetruth.scene.motion.rigid_motions import Motion
from scenetruth.scene.texture import TextureModel
from scenetruth.scene.vertex_animation import VertexModel
from scenetruth.validated_model import Direction, Finite, FrozenModel, Name, Vector3

__all__ = ["Pose", "Rotation", "SceneObject", "Texture"]


class Rotation(FrozenModel):
    """Rotation about an axis through the object origin (right-hand rule: X towards Y about Z)."""

    axis: Direction
    """Direction of the axis."""
    angle_deg: Finite
    """Angle in degrees."""


class Pose(FrozenModel):
    """Pose of an object at t = 0: rotations in the given order, then translation."""

    position_mm: Vector3 = (0.0, 0.0, 0.0)
    """World position of the mesh origin in mm."""
    rotations: tuple[Rotation, ...] = ()
    """Rotations about fixed axes, applied in order."""


if TYPE_CHECKING:
    AnyDeformation = OwnFrameModel
    Mesh = MeshModel
    Texture = TextureModel
else:
    AnyDeformation = discriminated_union(
        OwnFrameModel, "scenetruth.scene.deformation", "scenetruth.scene.vertex_animation"
    )
    Mesh = discriminated_union(MeshModel, "scenetruth.scene.mesh", "scenetruth.scene.leaf")
    Texture = discriminated_union(
        TextureModel, "scenetruth.scene.texture", "scenetruth.scene.leaf", "scenetruth.scene.band_textures"
    )


class SceneObject(MaterialOwner):
    """Textured mesh with pose, deformation and motion."""

    name: Name
    """Unique name in the scene, also the key of the random streams of the object."""
    mesh: Mesh
    """Shape of the object."""
    texture: Texture
    """Texture of the surface."""
    tint: BandNonNegative = 1.0
    """Factor of the texture, for all bands or for each, such as the reflectance of a pigment."""
    material: Material = MATT
    """Gloss and transmission of the surface; matt by default."""
    pose: Pose = Pose()
    """Pose at t = 0."""
    deformation: tuple[AnyDeformation, ...] = ()
    """Deformations in the object frame, applied in order before the pose."""
    motion: tuple[Motion, ...] = ()
    """Motions in the world, applied in order."""

    @field_validator("deformation")
    @classmethod
    def _vertices_come_first(
        cls, value: tuple[AnyDeformation, ...], info: ValidationInfo
    ) -> tuple[AnyDeformation, ...]:
        given = [index for index, entry in enumerate(value) if isinstance(entry, VertexModel)]
        mesh = info.data.get("mesh")
        if given and (given != [0] or not (mesh is None or isinstance(mesh, FileMesh))):
            msg = f"'{value[given[-1]].kind}' defines the vertex positions of a mesh file: "
            msg += "it must be the first deformation and the only vertex animation, for a mesh with `kind` 'file'"
            raise ValueError(msg)
        return value
