"""Plants: leaves of one form arranged about a stem; each leaf is an object of the scene."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from scenetruth.scene.deformation import Deformation, DeformationModel, Growth, Hinge
from scenetruth.scene.leaf.leaf_mesh import LeafMesh
from scenetruth.scene.leaf.leaf_model import Petiole
from scenetruth.scene.leaf.texture_synthesis import LeafTexture
from scenetruth.scene.motion import MotionModel
from scenetruth.scene.motion.rigid_motions import Motion
from scenetruth.scene.motion.time_curve import HarmonicCurve
from scenetruth.scene.scene_object import Pose, Rotation, SceneObject
from scenetruth.validated_model import Finite, FrozenModel, Name, NonNegative, Positive, Vector3

__all__ = ["LeafPlace", "PlantModel", "Rosette", "Seedling"]


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


LengthRatio = Annotated[float, Field(ge=0.01, le=1)]


class Rosette(PlantModel):
    """Leaves at phyllotactic angles around a short stem; younger ones are smaller, steeper and higher up."""

    kind: Literal["rosette"]
    """``rosette``."""
    leaf: LeafMesh
    """The oldest and largest leaf; the others have the same form."""
    leaves: Annotated[int, Field(ge=1, le=100)] = 9
    """Number of leaves."""
    divergence_deg: Finite = 137.508
    """Angle from each leaf to the next younger one; 137.508 is the golden angle."""
    smallest: LengthRatio = 0.3
    """Length of the youngest leaf relative to the oldest; from leaf to leaf it falls by one factor."""
    elevation_deg: tuple[Elevation, Elevation] = (8.0, 50.0)
    """Angle of the oldest and of the youngest leaf with the plane across the stem; positive rises along the stem."""
    stem_mm: NonNegative = 8.0
    """How much farther along the stem the youngest leaf stands than the oldest."""
    azimuth_deg: Finite = 0.0
    """Direction of the oldest leaf, from X towards Y."""

    def places(self) -> list[LeafPlace]:
        """Return the leaves, the oldest first."""
        low, high = self.elevation_deg
        places = []
        for number in range(self.leaves):
            youth = number / max(self.leaves - 1, 1)
            mesh = self.leaf.scaled(self.smallest**youth)
            azimuth = self.azimuth_deg + number * self.divergence_deg
            places.append(LeafPlace(mesh, azimuth, low + (high - low) * youth, self.stem_mm * youth, 1 - youth))
        return places


class Seedling(PlantModel):
    """Two seed leaves, opposite each other, and above them the first true leaves across."""

    kind: Literal["seedling"]
    """``seedling``."""
    cotyledon: LeafMesh = LeafMesh(
        kind="leaf",
        outline="elliptic",
        length_mm=14,
        width_mm=9,
        petiole=Petiole(length_mm=6, diameter_mm=1.2),
        bend_along_deg=-15,
        resolution_mm=0.5,
    )
    """The two seed leaves."""
    leaf: LeafMesh = LeafMesh(
        kind="leaf",
        outline="ovate",
        length_mm=12,
        width_mm=8,
        petiole=Petiole(length_mm=3, diameter_mm=1.0),
        bend_along_deg=25,
        fold_deg=20,
        resolution_mm=0.5,
    )
    """The oldest of the true leaves."""
    leaves: Annotated[int, Field(ge=0, le=4)] = 2
    """Number of true leaves; a second pair is smaller, and stands across the first."""
    elevation_deg: tuple[Elevation, Elevation] = (12.0, 40.0)
    """Angle of the seed leaves and of the true leaves with the plane across the stem; positive rises along the stem."""
    stem_mm: NonNegative = 3.0
    """How much farther along the stem the true leaves stand than the seed leaves."""
    azimuth_deg: Finite = 0.0
    """Direction of the first seed leaf, from X towards Y."""

    def places(self) -> list[LeafPlace]:
        """Return the leaves, the oldest first."""
        low, high = self.elevation_deg
        places = [LeafPlace(self.cotyledon, self.azimuth_deg + 180 * side, low, 0.0, 1.0) for side in range(2)]
        for number in range(self.leaves):
            pair, side = divmod(number, 2)
            azimuth = self.azimuth_deg + 90 * (pair + 1) + 180 * side
            # The second pair is younger: smaller, steeper and higher up.
            mesh = self.leaf if pair == 0 else self.leaf.scaled(0.5)
            height, steeper = self.stem_mm * (1 + 0.5 * pair), high + 15 * pair
            places.append(LeafPlace(mesh, azimuth, steeper, height, 0.0))
        return places
