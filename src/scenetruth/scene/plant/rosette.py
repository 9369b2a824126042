"""Rosettes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from scenetruth.model import Finite, NonNegative
from scenetruth.scene.leaf.mesh import LeafMesh
from scenetruth.scene.plant.base import Elevation, LeafPlace, PlantModel

__all__ = ["Rosette"]

Part = Annotated[float, Field(ge=0.01, le=1)]


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
    smallest: Part = 0.3
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
