"""What all plants are: leaves of one kind, set about a stem; each leaf is an object of the scene."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from scenetruth.model import FrozenModel, Name, NonNegative, Positive, Vector3
from scenetruth.scene.deformation import DeformationModel
from scenetruth.scene.deformation.growth import Growth
from scenetruth.scene.deformation.hinge import Hinge
from scenetruth.scene.deformations import Deformation
from scenetruth.scene.item import SceneObject
from scenetruth.scene.leaf.mesh import LeafMesh
from scenetruth.scene.leaf.texture import LeafTexture
from scenetruth.scene.motion import MotionModel
from scenetruth.scene.motion.time_curve import HarmonicCurve
from scenetruth.scene.motions import Motion
from scenetruth.scene.pose import Pose, Rotation

__all__ = ["Elevation", "LeafPlace", "PlantModel"]

GOLDEN_ANGLE_DEG = 137.508
# Below, the quotient is taken from its series.
_SMALL_RAD = 1e-3

Elevation = Annotated[float, Field(gt=-90, lt=90, allow_inf_nan=False)]


@dataclass(frozen=True)
class LeafPlace:
    """One leaf of a plant: its mesh, direction, angle with the plane across the stem, and height on the stem."""

    mesh: LeafMesh
    azimuth_deg: float
    elevation_deg: float
    height_mm: float
    age: float
    """1 for the oldest leaf, 0 for the youngest."""


class PlantModel(FrozenModel):
    """What all plants share. The stem points to -Z, towards the camera: plants are seen from above."""

    name: Name
    """Name, unique in the scene; its leaves are called ``name/leaf-1``, the oldest first."""
    position_mm: Vector3
    """World position of the foot of the oldest leaf's petiole, in the middle of the plant, in mm."""
    rotations: tuple[Rotation, ...] = ()
    """Rotations of the whole plant about its position, applied one after the other."""
    texture: LeafTexture = LeafTexture(kind="leaf")
    """What is seen on its leaves; every leaf has veins, mottling and hairs of its own."""
    growth: Growth | None = None
    """Growth of the oldest leaf; null for none."""
    youngest_growth: NonNegative = 2.0
    """Rate of growth of the youngest leaf relative to the oldest."""
    nutation_deg: NonNegative = 0.0
    """Amplitude in degrees with which leaves rise and sink about the feet of their petioles, each in its turn."""
    nutation_period_frames: Positive = 90.0
    """Period of that movement in frames; 90 are an hour and a half at one frame a minute."""
    deformation: tuple[Deformation, ...] = ()
    """More deformations of every leaf, in the leaf's own frame."""
    motion: tuple[Motion, ...] = ()
    """How the whole plant moves in the world."""

    @abstractmethod
    def places(self) -> Sequence[LeafPlace]:
        """Return the leaves, the oldest first."""

    def leaf_objects(self) -> list[SceneObject]:
        """Return the leaves as objects of the scene, the oldest first."""
        return [_leaf(self, number, place) for number, place in enumerate(self.places())]


def _leaf(plant: PlantModel, number: int, place: LeafPlace) -> SceneObject:
    stalk = 0.0 if place.mesh.petiole is None else place.mesh.petiole.length_mm
    # The foot of the petiole stands on the stem: the blade's base is as far away as the petiole is long.
    rotations = (
        Rotation(axis=(0, 1, 0), angle_deg=place.elevation_deg),
        Rotation(axis=(0, 0, 1), angle_deg=place.azimuth_deg),
        *plant.rotations,
    )
    foot = _turned(plant.rotations, (0.0, 0.0, -place.height_mm))
    base = _turned(rotations, (stalk, 0.0, 0.0))
    x, y, z = np.asarray(plant.position_mm) + foot + base
    deformation: list[DeformationModel] = []
    if plant.growth is not None:
        rate = plant.growth.rate_per_hour * (plant.youngest_growth + (1 - plant.youngest_growth) * place.age)
        growth = {"rate_per_hour": rate, "base_mm": 0.0, "tip_mm": place.mesh.length_mm, "preset": None}
        deformation.append(plant.growth.model_copy(update=growth))
    deformation += plant.deformation
    if plant.nutation_deg > 0:
        curve = HarmonicCurve(
            kind="harmonic",
            amplitude=plant.nutation_deg,
            period_frames=plant.nutation_period_frames,
            phase_deg=number * GOLDEN_ANGLE_DEG,
        )
        deformation.append(Hinge(kind="hinge", axis=(0, 1, 0), point_mm=(-stalk, 0, 0), angle_deg=curve))
    return SceneObject(
        name=f"{plant.name}/leaf-{number + 1}",
        mesh=place.mesh,
        texture=plant.texture,
        # A leaf may stand beyond the bounds of what a file may say, by as much as the plant is large.
        pose=Pose(rotations=rotations).model_copy(update={"position_mm": (float(x), float(y), float(z))}),
        deformation=tuple(deformation),
        motion=tuple(_about(entry, plant) for entry in plant.motion),
    )


def _about(entry: MotionModel, plant: PlantModel) -> MotionModel:
    """Turn what has no point of its own about the plant, not about each leaf."""
    if getattr(entry, "point_mm", ()) is None:
        return entry.model_copy(update={"point_mm": plant.position_mm})
    return entry


def _turned(rotations: tuple[Rotation, ...], arm: tuple[float, float, float]) -> np.ndarray:
    point = np.asarray(arm, dtype=np.float64)
    for rotation in rotations:
        axis = np.asarray(rotation.axis) / np.linalg.norm(rotation.axis)
        point = _matrix(axis * np.deg2rad(rotation.angle_deg)) @ point
    return point


def _matrix(vector_rad: np.ndarray) -> np.ndarray:
    """Return the matrix of a rotation vector as `scipy.spatial.transform.Rotation` does, to the bit, by a quaternion.

    To import that takes longer than everything else that is done to look at a plant.
    """
    a, b, c = vector_rad
    angle = np.sqrt(a * a + b * b + c * c)
    small = 0.5 - angle**2 / 48 + angle**2 * angle**2 / 3840
    scale = small if angle <= _SMALL_RAD else np.sin(angle / 2) / angle
    x, y, z, w = scale * a, scale * b, scale * c, np.cos(angle / 2)
    xx, yy, zz, ww, xy, zw, xz, yw, yz, xw = x * x, y * y, z * z, w * w, x * y, z * w, x * z, y * w, y * z, x * w
    return np.array(
        [
            [xx - yy - zz + ww, 2 * (xy - zw), 2 * (xz + yw)],
            [2 * (xy + zw), -xx + yy - zz + ww, 2 * (yz - xw)],
            [2 * (xz - yw), 2 * (yz + xw), -xx - yy + zz + ww],
        ]
    )
