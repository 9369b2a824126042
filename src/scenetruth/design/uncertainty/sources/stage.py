"""Sources of uncertainty in the acquisition: stage guide, positions, scan timing and shutter."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, ClassVar

import numpy as np

from scenetruth.camera import Schedule
from scenetruth.camera.stage import STAGE_PRESETS
from scenetruth.design.uncertainty.observation_model import (
    Disturbance,
    ImageDisturbance,
    ObservationModel,
    displace_camera,
    disturb_poses,
    shift_in_time,
)
from scenetruth.design.uncertainty.source import Calibration, Mitigation, UncertaintySource
from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene

__all__ = ["StageGuideSource", "make_stage_schedule"]


_BETTER = "air_bearing"


class StageGuideSource(UncertaintySource):
    """An error of the guide: random for every camera position, and the same at every visit."""

    group = "stage"
    field: ClassVar[str]
    """Field in the stage errors."""
    axes: ClassVar[tuple[int, ...]]
    """Axes: 0 to 2 for positions, 3 to 5 for rotations."""
    unit: ClassVar[float]
    """Its unit in mm or rad."""

    def deviation(self, scene: Scene) -> float:
        """Return the standard deviation, in the unit of the field."""
        return float(getattr(scene.stage.errors, self.field, 0.0)) if scene.stage.errors else 0.0

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the standard deviation with its unit."""
        return f"{self.deviation(scene):g} {'µrad' if self.field.endswith('urad') else 'µm'}"

    def disturbances(self, sight: ObservationModel) -> Iterable[Disturbance]:
        """Yield the error of each camera position, for each axis."""
        size = self.deviation(sight.scene) * self.unit
        for camera in sight.s:
            for axis in self.axes:
                yield partial(_disturb_camera, sight, camera, axis, size)

    def drawn(self, sight: ObservationModel, scene: Scene) -> Iterable[Disturbance]:
        """Return the actual errors of the stage of a scene."""
        return [disturb_poses(make_stage_schedule(scene), sight)]

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation | None:
        """Return a better stage."""
        return propose_air_bearing(scene, self.field, self.kind)


def _disturb_camera(
    sight: ObservationModel, camera: int, axis: int, size: float, s: int, t: int
) -> ImageDisturbance | None:
    if s != camera:
        return None
    off = np.zeros(6)
    off[axis] = size
    return displace_camera(sight, s, t, off[:3], off[3:])


def make_stage_schedule(scene: Scene) -> Schedule:
    """Return the acquisition schedule of a scene."""
    return Schedule(scene.stage, scene.frames, partial(generator_for, scene.seed, "stage"))


def propose_air_bearing(scene: Scene, field: str, kind: str) -> Mitigation:
    """Return the effect of an air bearing, or of halving the error where an air bearing is no better."""
    errors: dict[str, Any] = scene.stage.errors.model_dump() if scene.stage.errors else {}
    better = STAGE_PRESETS[_BETTER]
    if errors.get(field, 0.0) <= better[field]:
        return Mitigation(
            f"a stage with half this error (stage.errors.{field}: {errors.get(field, 0.0) / 2:g})", {kind: 0.5}
        )
    factors = {
        cause: max((min(better[name] / errors[name], 1.0) for name in fields if errors.get(name)), default=1.0)
        for cause, fields in _FIELDS.items()
    }
    return Mitigation(f"an air bearing (stage.errors: {{preset: {_BETTER}}})", factors)


_FIELDS = {
    "stage_position": ("repeatability_um", "backlash_um"),
    "stage_straightness": ("straightness_um",),
    "stage_pitch": ("pitch_urad",),
    "stage_yaw": ("yaw_urad",),
    "stage_roll": ("roll_urad",),
}
"""Fields of the stage errors, by source."""


class StagePitchSource(StageGuideSource):
    """Rotations about X, which shift images along y."""

    kind = "stage_pitch"
    title = "stage pitch"
    perfect: ClassVar[Mapping[str, Any]] = {"stage.errors.pitch_urad": 0.0}
    field = "pitch_urad"
    axes = (3,)
    unit = 1e-6


class StagePositionSource(UncertaintySource):
    """Errors along X that are random at every visit, and backlash, which depends on the direction of approach."""

    kind = "stage_position"
    title = "stage position"
    group = "stage"
    perfect: ClassVar[Mapping[str, Any]] = {"stage.errors.repeatability_um": 0.0, "stage.errors.backlash_um": 0.0}

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return repeatability and backlash."""
        errors = scene.stage.errors
        if errors is None:
            return ""
        backlash = f", backlash {errors.backlash_um:g} µm" if errors.backlash_um else ""
        return f"{errors.repeatability_um:g} µm{backlash}"

    def disturbances(self, sight: ObservationModel) -> Iterable[Disturbance]:
        """Yield the error of every visit, and the effect of backlash on all visits."""
        errors = sight.scene.stage.errors
        if errors is None:
            return
        for place in [(s, t) for s in sight.s for t in sight.t] if errors.repeatability_um else []:
            yield partial(_disturb_image, sight, place, 1e-3 * errors.repeatability_um)
        if errors.backlash_um:
            only = errors.model_copy(update=dict.fromkeys(_OTHER_FIELDS, 0.0))
            stage = sight.scene.stage.model_copy(update={"errors": only, "time_per_position_s": 0.0})
            yield disturb_poses(Schedule(stage, sight.scene.frames, partial(generator_for, 0, "stage")), sight)

    def drawn(self, sight: ObservationModel, scene: Scene) -> Iterable[Disturbance]:
        """Return the actual errors of the stage of a scene."""
        return [disturb_poses(make_stage_schedule(scene), sight)]

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation:
        """Return a better stage."""
        errors = scene.stage.errors
        backlash = errors is not None and errors.backlash_um > errors.repeatability_um
        return propose_air_bearing(scene, "backlash_um" if backlash else "repeatability_um", self.kind)


_OTHER_FIELDS = ("repeatability_um", "straightness_um", "pitch_urad", "yaw_urad", "roll_urad")


def _disturb_image(
    sight: ObservationModel, place: tuple[int, int], size_mm: float, s: int, t: int
) -> ImageDisturbance | None:
    return displace_camera(sight, s, t, np.array([size_mm, 0.0, 0.0]), np.zeros(3)) if (s, t) == place else None


class StageRollSource(StageGuideSource):
    """Rotations about Z, which rotate images."""

    kind = "stage_roll"
    title = "stage roll"
    perfect: ClassVar[Mapping[str, Any]] = {"stage.errors.roll_urad": 0.0}
    field = "roll_urad"
    axes = (5,)
    unit = 1e-6


class RollingShutterSource(UncertaintySource):
    """Rolling shutter: a point that moves to another row is exposed at another time."""

    kind = "rolling_shutter"
    title = "rolling shutter"
    group = "stage"
    perfect: ClassVar[Mapping[str, Any]] = {"shutter.readout_time_s": 0.0}

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the time from the first row to the last."""
        return f"{scene.shutter.readout_time_s:g} s"

    def disturbances(self, sight: ObservationModel) -> Iterable[Disturbance]:
        """Yield the motion between the exposure times of a point's rows in the reference and in the image."""
        shutter, height = sight.scene.shutter, sight.scene.camera.height
        interval = sight.scene.frames.frame_interval_s
        first = sight.points.y - sight.points.y[0, 0]

        def change(s: int, t: int) -> ImageDisturbance:
            row = sight.place(s, t).y - sight.points.y[0, 0]
            later = shutter.row_offsets_s(row, height) - shutter.row_offsets_s(first, height)
            return shift_in_time(sight, s, t, later / interval)

        yield change

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation:
        """Return a global shutter."""
        return Mitigation("a global shutter (shutter.readout_time_s: 0)", {self.kind: 0.0})


class StageStraightnessSource(StageGuideSource):
    """Errors of position along Y and along Z."""

    kind = "stage_straightness"
    title = "stage straightness"
    perfect: ClassVar[Mapping[str, Any]] = {"stage.errors.straightness_um": 0.0}
    field = "straightness_um"
    axes = (1, 2)
    unit = 1e-3


class ScanTimingSource(UncertaintySource):
    """Motion of the object while the stage travels, which is interpreted as depth."""

    kind = "timing"
    title = "scan timing"
    group = "stage"
    perfect: ClassVar[Mapping[str, Any]] = {"stage.time_per_position_s": 0.0}

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the time per position."""
        return f"{scene.stage.time_per_position_s:g} s per position"

    def disturbances(self, sight: ObservationModel) -> Iterable[Disturbance]:
        """Yield the motion until the exposure of each image."""
        schedule = make_stage_schedule(sight.scene)
        interval = sight.scene.frames.frame_interval_s
        yield lambda s, t: shift_in_time(sight, s, t, schedule.offset_s(s, t) / interval)

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation:
        """Return half the time."""
        half = scene.stage.time_per_position_s / 2
        return Mitigation(f"half the time per position (stage.time_per_position_s: {half:g})", {self.kind: 0.5})


class StageYawSource(StageGuideSource):
    """Rotations about Y, which displace images along x, as depth does."""

    kind = "stage_yaw"
    title = "stage yaw"
    perfect: ClassVar[Mapping[str, Any]] = {"stage.errors.yaw_urad": 0.0}
    field = "yaw_urad"
    axes = (4,)
    unit = 1e-6
