"""What constraints are computed from: the scene of a rig, its prediction, and what was chosen from catalogues."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from scenetruth.design.optimise.catalogues.entries import CameraEntry, LensEntry, StageEntry
from scenetruth.design.predict import Causes, Prediction
from scenetruth.scene import Scene

__all__ = ["Facts"]


@dataclass(frozen=True)
class Facts:
    """A rig as constraints see it.

    Parameters
    ----------
    scene
        Its scene.
    prediction
        What is predicted of it.
    region
        The region of the first objective.
    parameters
        What was free, by name.
    lens, camera, stage
        What was chosen from catalogues; None if nothing was.
    f_number
        Of the lens; None without one.
    """

    scene: Scene
    prediction: Prediction
    region: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    lens: LensEntry | None = None
    camera: CameraEntry | None = None
    stage: StageEntry | None = None
    f_number: float | None = None

    @property
    def causes(self) -> Causes:
        """What was predicted of the region."""
        return self.prediction.by_region[self.region]

    @property
    def depth_mm(self) -> float:
        """Median depth of the region."""
        return self.causes.depth_mm

    @property
    def travel_mm(self) -> float:
        """How far the stage goes from the first position to the last."""
        places = self.scene.stage.x_mm
        return float(places.max() - places.min())

    @property
    def images_per_frame(self) -> int:
        """Images that are taken in each frame."""
        return self.scene.stage.positions * self.scene.stage.rows

    @property
    def price(self) -> float | None:
        """Sum of the prices of what was chosen, in euros; None if one is not known or nothing was chosen."""
        chosen = [one for one in (self.lens, self.camera, self.stage) if one is not None]
        prices = [one.price_eur for one in chosen]
        return sum(price for price in prices if price is not None) if prices and None not in prices else None
