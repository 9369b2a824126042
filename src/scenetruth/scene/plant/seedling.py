"""Seedlings."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from scenetruth.model import Finite, NonNegative
from scenetruth.scene.leaf.form import Petiole
from scenetruth.scene.leaf.mesh import LeafMesh
from scenetruth.scene.plant.base import Elevation, LeafPlace, PlantModel

__all__ = ["Seedling"]


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
