"""Plants: leaves of the same shape arranged about a stem; each leaf is a scene object."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator

from scenetruth.bands import BandNonNegative
from scenetruth.scene.band_textures import BandTextures
from scenetruth.scene.deformation import Deformation, DeformationModel, Growth, Hinge
from scenetruth.scene.leaf.leaf_mesh import LeafMesh
from scenetruth.scene.leaf.leaf_model import Petiole
from scenetruth.scene.leaf.texture_synthesis import LeafTexture
from scenetruth.scene.material import MATT, Material, MaterialOwner
from scenetruth.scene.motion import MotionModel
from scenetruth.scene.motion.rigid_motions import Motion
from scenetruth.scene.motion.time_curve import HarmonicCurve
from scenetruth.scene.scene_object import Pose, Rotation, SceneObject
from scenetruth.validated_model import Finite, Name, NonNegative, Positive, Vector3

__all__ = ["LeafPlace", "PlantModel", "Rosette", "Seedling"]


GOLDEN_ANGLE_DEG = 137.508
_SMALL_RAD = 1e-3  # angle below which the quotient is evaluated by its series

Elevation = Annotated[float, Field(gt=-90, lt=90, allow_inf_nan=False)]


@dataclass(frozen=True)
class LeafPlace:
    """One leaf of a plant: mesh, azimuth, elevation and height on the stem."""

    mesh: LeafMesh
    azimuth_deg: float
    elevation_deg: float
    height_mm: float
    age: float
    """1 for the oldest leaf, 0 for the youngest."""


class PlantModel(MaterialOwner):
    """Base class of plants. The stem points to -Z, towards the camera (top view)."""

    name: Name
    """Unique name in the scene; the leaves are called ``name/leaf-1`` and so on, oldest first."""
    position_mm: Vector3
    """World position of the petiole base of the oldest leaf, at the centre of the plant, in mm."""
    rotations: tuple[Rotation, ...] = ()
    """Rotations of the whole plant about its position, applied in order."""
    texture: LeafTexture | BandTextures = Field(LeafTexture(kind="leaf"), discriminator="kind")
    """Texture of the leaves, with individual veins, mottling and hairs for each leaf, or textures by band."""
    tint: BandNonNegative = 1.0
    """Factor of the texture, for all bands or for each, such as a spectrum of leaves."""
    material: Material = MATT
    """Gloss and transmission of the leaves; matt by default. The x direction of leaves is along the midrib."""
    growth: Growth | None = None
    """Growth of the oldest leaf; null for none."""
    along_share: Annotated[float, Field(ge=-1, le=2, allow_inf_nan=False)] | None = 0.6
    """Fraction of the growth rate along the midrib if ``growth`` does not define it, with the rest across; null for
    isotropic growth. Conformal maps, whose growth is isotropic, describe the displacements measured on leaves of
    Arabidopsis and other species to about 90 % (Mitchison 2016; Alim et al. 2016): growth of leaves is neither
    isotropic nor far from it. 0.6, half as much again along as across, is an assumption of that order.
    """
    youngest_growth: NonNegative = 2.0
    """Growth rate of the youngest leaf relative to the oldest."""
    nutation_deg: NonNegative = 0.0
    """Amplitude in degrees of the periodic elevation of leaves about their petiole bases, with a phase per leaf."""
    nutation_period_frames: Positive = 90.0
    """Period of the nutation in frames; 90 is 1.5 h at one frame per minute."""
    deformation: tuple[Deformation, ...] = ()
    """Further deformations of every leaf, in the leaf frame."""
    motion: tuple[Motion, ...] = ()
    """Motion of the whole plant in the world."""

    @field_validator("material")
    @classmethod
    def _of_no_file(cls, given: Material) -> Material:
        if given.from_file:
            msg = "`from_file` takes the material of a mesh file, and leaves have none; use a `preset`, or give values"
            raise ValueError(msg)
        return given

    @abstractmethod
    def places(self) -> Sequence[LeafPlace]:
        """Return the leaves, oldest first."""

    def leaf_objects(self) -> list[SceneObject]:
        """Return the leaves as scene objects, oldest first."""
        return [_leaf(self, number, place) for number, place in enumerate(self.places())]


def _leaf(plant: PlantModel, number: int, place: LeafPlace) -> SceneObject:
    stalk = 0.0 if place.mesh.petiole is None else place.mesh.petiole.length_mm
    # The petiole base is on the stem, and the blade base one petiole length away.
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
        given = plant.growth.along_share is not None or plant.growth.solid
        share = plant.growth.along_share if given else plant.along_share
        growth = {
            "rate_per_hour": rate,
            "base_mm": 0.0,
            "tip_mm": place.mesh.length_mm,
            "along_share": share,
            "preset": None,
        }
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
        tint=plant.tint,
        material=plant.material,
        # A leaf may exceed the coordinate bounds of scene files by the size of the plant.
        pose=Pose(rotations=rotations).model_copy(update={"position_mm": (float(x), float(y), float(z))}),
        deformation=tuple(deformation),
        motion=tuple(_about(entry, plant) for entry in plant.motion),
    )


def _about(entry: MotionModel, plant: PlantModel) -> MotionModel:
    """Rotate about the plant position instead of each leaf, unless a point is specified."""
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
    """Return a rotation matrix bit-identical to `scipy.spatial.transform.Rotation`, without the import of SciPy."""
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
    """Leaves at phyllotactic angles around a short stem; younger leaves are smaller, steeper and higher."""

    kind: Literal["rosette"]
    """``rosette``."""
    leaf: LeafMesh
    """Oldest and largest leaf; the other leaves have the same shape."""
    leaves: Annotated[int, Field(ge=1, le=100)] = 9
    """Number of leaves."""
    divergence_deg: Finite = 137.508
    """Divergence angle between successive leaves; 137.508 is the golden angle."""
    smallest: LengthRatio = 0.3
    """Length of the youngest leaf relative to the oldest; the ratio between successive leaves is constant."""
    elevation_deg: tuple[Elevation, Elevation] = (8.0, 50.0)
    """Elevation of the oldest and youngest leaf above the plane across the stem; positive along the stem."""
    stem_mm: NonNegative = 8.0
    """Distance along the stem from the oldest to the youngest leaf."""
    azimuth_deg: Finite = 0.0
    """Azimuth of the oldest leaf, from X towards Y."""

    def places(self) -> list[LeafPlace]:
        """Return the leaves, oldest first."""
        low, high = self.elevation_deg
        places = []
        for number in range(self.leaves):
            youth = number / max(self.leaves - 1, 1)
            mesh = self.leaf.scaled(self.smallest**youth)
            azimuth = self.azimuth_deg + number * self.divergence_deg
            places.append(LeafPlace(mesh, azimuth, low + (high - low) * youth, self.stem_mm * youth, 1 - youth))
        return places


class Seedling(PlantModel):
    """Two opposite cotyledons and, above them, the first true leaves at right angles."""

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
    """Shape of the two cotyledons."""
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
    """Oldest true leaf."""
    leaves: Annotated[int, Field(ge=0, le=4)] = 2
    """Number of true leaves; a second pair is smaller and at right angles to the first."""
    elevation_deg: tuple[Elevation, Elevation] = (12.0, 40.0)
    """Elevation of the cotyledons and true leaves above the plane across the stem; positive along the stem."""
    stem_mm: NonNegative = 3.0
    """Distance along the stem from the cotyledons to the true leaves."""
    azimuth_deg: Finite = 0.0
    """Azimuth of the first cotyledon, from X towards Y."""

    def places(self) -> list[LeafPlace]:
        """Return the leaves, oldest first."""
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
