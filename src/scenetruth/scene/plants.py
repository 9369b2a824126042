"""Plants made into their leaves: one object of the scene for each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation as Turn

from scenetruth.scene.deformation_spec import Deformation, Hinge
from scenetruth.scene.leaf_spec import LeafMesh
from scenetruth.scene.motion.time_curve import HarmonicCurve
from scenetruth.scene.plant_spec import Plant, Rosette
from scenetruth.scene.pose_spec import Pose, Rotation
from scenetruth.scene.spec import SceneObject

__all__ = ["leaves_of", "scaled"]

GOLDEN_ANGLE_DEG = 137.508


@dataclass(frozen=True)
class _Place:
    """One leaf of a plant: its mesh, direction, angle with the plane across the stem, and height on the stem."""

    mesh: LeafMesh
    azimuth_deg: float
    elevation_deg: float
    height_mm: float
    age: float
    """1 for the oldest leaf, 0 for the youngest."""


def leaves_of(plant: Plant) -> list[SceneObject]:
    """Return the leaves of a plant as objects, the oldest first."""
    places = _rosette(plant) if isinstance(plant, Rosette) else _seedling(plant)
    return [_leaf(plant, number, place) for number, place in enumerate(places)]


def scaled(mesh: LeafMesh, size: float) -> LeafMesh:
    """Return a leaf of the same form whose lengths, and those of its triangles, are ``size`` times as large."""
    parts = {
        "length_mm": mesh.length_mm * size,
        "resolution_mm": mesh.resolution_mm * size,
        "width_mm": mesh.full_width_mm * size,
        "fold_width_mm": None if mesh.fold_width_mm is None else mesh.fold_width_mm * size,
    }
    for name, lengths in (
        ("serration", ("depth_mm",)),
        ("petiole", ("length_mm", "diameter_mm")),
        ("undulation", ("amplitude_mm",)),
    ):
        part = getattr(mesh, name)
        if part is not None:
            parts[name] = part.model_copy(update={length: getattr(part, length) * size for length in lengths})
    return mesh.model_copy(update=parts)


def _rosette(plant: Rosette) -> list[_Place]:
    low, high = plant.elevation_deg
    places = []
    for number in range(plant.leaves):
        youth = number / max(plant.leaves - 1, 1)
        mesh = scaled(plant.leaf, plant.smallest**youth)
        azimuth = plant.azimuth_deg + number * plant.divergence_deg
        places.append(_Place(mesh, azimuth, low + (high - low) * youth, plant.stem_mm * youth, 1 - youth))
    return places


def _seedling(plant: Plant) -> list[_Place]:
    assert not isinstance(plant, Rosette)
    low, high = plant.elevation_deg
    places = [_Place(plant.cotyledon, plant.azimuth_deg + 180 * side, low, 0.0, 1.0) for side in range(2)]
    for number in range(plant.leaves):
        pair, side = divmod(number, 2)
        azimuth = plant.azimuth_deg + 90 * (pair + 1) + 180 * side
        # The second pair is younger: smaller, steeper and higher up.
        mesh = plant.leaf if pair == 0 else scaled(plant.leaf, 0.5)
        height, steeper = plant.stem_mm * (1 + 0.5 * pair), high + 15 * pair
        places.append(_Place(mesh, azimuth, steeper, height, 0.0))
    return places


def _leaf(plant: Plant, number: int, place: _Place) -> SceneObject:
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
    deformation: list[Deformation] = []
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
        pose=Pose(position_mm=(float(x), float(y), float(z)), rotations=rotations),
        deformation=tuple(deformation),
        motion=tuple(_about(entry, plant) for entry in plant.motion),
    )


def _about(entry: object, plant: Plant) -> object:
    """Turn what has no point of its own about the plant, not about each leaf."""
    if getattr(entry, "point_mm", ()) is None:
        return entry.model_copy(update={"point_mm": plant.position_mm})  # type: ignore[attr-defined]
    return entry


def _turned(rotations: tuple[Rotation, ...], arm: tuple[float, float, float]) -> np.ndarray:
    point = np.asarray(arm, dtype=np.float64)
    for rotation in rotations:
        axis = np.asarray(rotation.axis) / np.linalg.norm(rotation.axis)
        point = Turn.from_rotvec(axis * np.deg2rad(rotation.angle_deg)).apply(point)
    return point
