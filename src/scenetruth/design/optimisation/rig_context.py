"""Context of a rig for constraints and predictions: scene, prediction, catalogue entries and stage uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from scenetruth.design.optimisation.catalogues import CameraEntry, LensEntry, StageEntry
from scenetruth.design.prediction import Prediction, PredictionInputs
from scenetruth.scene import Scene

__all__ = ["RigContext", "StageShifts", "compute_stage_shifts_px", "compute_stage_uncertainty"]


_UNIFORM = 1 / math.sqrt(12)  # RMS distance from the centre of an interval, as a fraction of its length


@dataclass(frozen=True)
class StageShifts:
    """Standard deviations in px of image shifts along x due to stage errors."""

    along: float  # total
    guide: float  # the same at every visit of a position
    visit: float  # independent at every visit
    turn_x: float  # gradient of the shift along x
    turn_y: float  # gradient of the shift along y


def compute_stage_shifts_px(scene: Scene, depth_mm: float) -> StageShifts:
    """Return the image shifts due to the stage errors of a scene."""
    errors, camera = scene.stage.errors, scene.camera
    if errors is None:
        return StageShifts(0.0, 0.0, 0.0, 0.0, 0.0)
    focal = camera.focal_px
    nearer = 1e-3 * errors.straightness_um / depth_mm
    # A camera rotation ψ about Y shifts an image point at x by f ψ (1 + x²/f²).
    turn_x = math.hypot(nearer, 2e-6 * errors.yaw_urad * camera.width * _UNIFORM / focal)
    turn_y = 1e-6 * errors.roll_urad
    middle = 1e-6 * errors.yaw_urad * focal
    guide = math.sqrt(middle**2 + (nearer * camera.width * _UNIFORM) ** 2 + (turn_y * camera.height * _UNIFORM) ** 2)
    visit = 1e-3 * errors.repeatability_um * focal / depth_mm
    return StageShifts(math.hypot(guide, visit), guide, visit, turn_x, turn_y)


def compute_stage_uncertainty(
    scene: Scene, causes: PredictionInputs, signals: Mapping[str, float | None]
) -> dict[str, dict[str, float]]:
    """Return nonzero standard uncertainties by stage source (``stage``, ``scan``) and quantity, growth per frame."""
    s = scene.stage.x_mm / scene.stage.baseline_mm
    t = np.arange(causes.frames) - (causes.frames - 1) / 2
    over_s, over_t = math.sqrt(float(((s - s.mean()) ** 2).sum())), math.sqrt(float((t**2).sum()))
    depth, disparity, focal = causes.depth_mm, causes.disparity_px, scene.camera.focal_px
    found: dict[str, dict[str, float]] = {}
    shifts = compute_stage_shifts_px(scene, depth)
    if shifts.along > 0 and over_s > 0:
        d = math.hypot(shifts.guide, shifts.visit / math.sqrt(len(t))) / over_s
        slope = focal / disparity / over_s
        values = _propagate_disparity(d, depth, disparity, slope * shifts.turn_x, slope * shifts.turn_y)
        if over_t > 0:
            flow = shifts.visit / (math.sqrt(len(s)) * over_t)
            nearer = depth / disparity * shifts.visit / (over_s * over_t)
            lateral = depth * flow / focal
            values |= {"flow_x": flow, "velocity_x": lateral, "velocity_z": nearer, "growth_rate": 2 * nearer / depth}
            # An apparent approach acts as equal growth of all lengths.
            values |= {"growth_principal_1": nearer / depth, "growth_principal_2": nearer / depth}
            values["velocity_epe"] = math.hypot(lateral, nearer)
        found["stage"] = values
    lag = scene.stage.time_per_position_s / scene.frames.frame_interval_s
    if lag > 0 and scene.stage.scan == "unidirectional" and over_s > 0:
        moved, approach = (abs(signals.get(name) or 0.0) * lag for name in ("flow_x", "velocity_z"))
        turn = focal / disparity * approach / depth
        found["scan"] = _propagate_disparity(moved, depth, disparity, turn, turn)
    return {what: {name: value for name, value in values.items() if value > 0} for what, values in found.items()}


def _propagate_disparity(d: float, depth: float, disparity: float, slope_x: float, slope_y: float) -> dict[str, float]:
    """Return the uncertainties that follow from those of disparity and slopes."""
    values = {"disparity": d, "depth": depth * d / disparity, "slope_x": slope_x, "slope_y": slope_y}
    values["normal"] = math.degrees(math.hypot(slope_x, slope_y))
    return values


@dataclass(frozen=True)
class RigContext:
    """Input of the constraints for a rig; ``region`` is that of the first objective."""

    scene: Scene
    prediction: Prediction
    region: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    lens: LensEntry | None = None
    camera: CameraEntry | None = None
    stage: StageEntry | None = None
    f_number: float | None = None

    @property
    def causes(self) -> PredictionInputs:
        """Prediction inputs of the region."""
        return self.prediction.by_region[self.region]

    @property
    def depth_mm(self) -> float:
        """Median depth of the region, in mm."""
        return self.causes.depth_mm

    @property
    def travel_mm(self) -> float:
        """Distance between the outermost stage positions, in mm."""
        places = self.scene.stage.x_mm
        return float(places.max() - places.min())

    @property
    def images_per_frame(self) -> int:
        """Number of images of each frame."""
        return self.scene.stage.positions * self.scene.stage.rows

    @property
    def price(self) -> float | None:
        """Sum of the prices of the selected entries, in euros; None without entries or if a price is missing."""
        chosen = [one for one in (self.lens, self.camera, self.stage) if one is not None]
        prices = [one.price_eur for one in chosen]
        return sum(price for price in prices if price is not None) if prices and None not in prices else None
