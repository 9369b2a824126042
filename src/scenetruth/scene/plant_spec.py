"""The models of plants: leaves of one kind, set about a stem."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from scenetruth.model import Finite, FrozenModel, NonNegative, Positive, Vector3
from scenetruth.scene.deformation_spec import Deformation, Growth
from scenetruth.scene.leaf_spec import LeafMesh, LeafTexture, Petiole
from scenetruth.scene.motions import Motion
from scenetruth.scene.pose_spec import Rotation

__all__ = ["Plant", "Rosette", "Seedling"]

Elevation = Annotated[float, Field(gt=-90, lt=90, allow_inf_nan=False)]
Part = Annotated[float, Field(gt=0, le=1)]


class _Plant(FrozenModel):
    """What all plants share. The stem points to -Z, towards the camera: plants are seen from above."""

    name: Annotated[str, Field(min_length=1)]
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


class Rosette(_Plant):
    """Leaves at phyllotactic angles around a short stem; younger ones are smaller, steeper and higher up."""

    kind: Literal["rosette"]
    """``rosette``."""
    leaf: LeafMesh
    """The oldest and largest leaf; the others have the same form."""
    leaves: Annotated[int, Field(ge=1, le=100)] = 9
    """Number of leaves."""
    divergence_deg: Finite = 137.508
    """Angle from each leaf to the next younger one; 137.508 is the golden angle."""
    smallest: Part = 0.3
    """Length of the youngest leaf relative to the oldest; from leaf to leaf it falls by one factor."""
    elevation_deg: tuple[Elevation, Elevation] = (8.0, 50.0)
    """Angle of the oldest and of the youngest leaf with the plane across the stem; positive rises along the stem."""
    stem_mm: NonNegative = 8.0
    """How much farther along the stem the youngest leaf stands than the oldest."""
    azimuth_deg: Finite = 0.0
    """Direction of the oldest leaf, from X towards Y."""


class Seedling(_Plant):
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


Plant = Annotated[Rosette | Seedling, Field(discriminator="kind")]
