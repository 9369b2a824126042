"""What causes in the stage's guide have in common: errors of position or angle that belong to a camera position."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any, ClassVar

import numpy as np

from scenetruth.camera import Schedule
from scenetruth.camera.stage_errors import STAGE_PRESETS
from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause, Remedy
from scenetruth.design.budget.sight import Change, Disturbance, Sight, posed, poses_of
from scenetruth.randomness import generator_for
from scenetruth.scene import Scene

__all__ = ["GuideCause", "air_bearing", "schedule_of_stage"]

_BETTER = "air_bearing"


class GuideCause(Cause):
    """An error of the guide: drawn for every camera position, and the same at every visit."""

    group = "stage"
    field: ClassVar[str]
    """Its field among the errors of the stage."""
    axes: ClassVar[tuple[int, ...]]
    """Along or about which axes, 0 to 2: those of position, 3 to 5: those of rotation."""
    unit: ClassVar[float]
    """How many mm, or rad, its unit has."""

    def deviation(self, scene: Scene) -> float:
        """Return its standard deviation, in the unit of its field."""
        return float(getattr(scene.stage.errors, self.field, 0.0)) if scene.stage.errors else 0.0

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return its standard deviation."""
        return f"{self.deviation(scene):g} {'µrad' if self.field.endswith('urad') else 'µm'}"

    def disturbances(self, sight: Sight) -> Iterable[Disturbance]:
        """Give the error of each camera position, along or about each axis."""
        size = self.deviation(sight.scene) * self.unit
        for camera in sight.s:
            for axis in self.axes:
                yield partial(_of_one_camera, sight, camera, axis, size)

    def drawn(self, sight: Sight, scene: Scene) -> Iterable[Disturbance]:
        """Return what the stage of a scene does in fact."""
        return [poses_of(schedule_of_stage(scene), sight)]

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy | None:
        """Return a better stage."""
        return air_bearing(scene, self.field, self.kind)


def _of_one_camera(sight: Sight, camera: int, axis: int, size: float, s: int, t: int) -> Change | None:
    if s != camera:
        return None
    off = np.zeros(6)
    off[axis] = size
    return posed(sight, s, t, off[:3], off[3:])


def schedule_of_stage(scene: Scene) -> Schedule:
    """Return where and when a scene's images are taken."""
    return Schedule(scene.stage, scene.frames, partial(generator_for, scene.seed, "stage"))


def air_bearing(scene: Scene, field: str, kind: str) -> Remedy:
    """Return what an air bearing makes of the stage's errors, or half of them where that is no better.

    Parameters
    ----------
    scene
        The scene.
    field
        The field of the stage's errors that is to be mended.
    kind
        The cause that it belongs to.
    """
    errors: dict[str, Any] = scene.stage.errors.model_dump() if scene.stage.errors else {}
    better = STAGE_PRESETS[_BETTER]
    if errors.get(field, 0.0) <= better[field]:
        return Remedy(f"a stage with half of it (stage.errors.{field}: {errors.get(field, 0.0) / 2:g})", {kind: 0.5})
    factors = {
        cause: max((min(better[name] / errors[name], 1.0) for name in fields if errors.get(name)), default=1.0)
        for cause, fields in _FIELDS.items()
    }
    return Remedy(f"an air bearing (stage.errors: {{preset: {_BETTER}}})", factors)


_FIELDS = {
    "stage_position": ("repeatability_um", "backlash_um"),
    "stage_straightness": ("straightness_um",),
    "stage_pitch": ("pitch_urad",),
    "stage_yaw": ("yaw_urad",),
    "stage_roll": ("roll_urad",),
}
"""Fields of the stage's errors, by cause."""
