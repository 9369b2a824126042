"""The design space, and the evaluation of a candidate rig: scene, prediction, objectives and constraints."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from scenetruth.camera.sensor.sensor_types import PRESETS
from scenetruth.design.optimisation.catalogues import CameraEntry, CatalogueEntries, LensEntry, StageEntry
from scenetruth.design.optimisation.constraints import ConstraintSpec, evaluate_bound
from scenetruth.design.optimisation.design_records import (
    STATISTICS,
    ConstraintValue,
    Objective,
    compute_predicted_statistic,
)
from scenetruth.design.optimisation.rig_context import RigContext, compute_stage_uncertainty
from scenetruth.design.optimisation.specification import IlluminationSpec
from scenetruth.design.prediction import Prediction, predict
from scenetruth.errors import Problem, SceneError, SceneWarning
from scenetruth.scene import Scene
from scenetruth.scene.field_paths import assign
from scenetruth.scoring import QUANTITIES

__all__ = [
    "BaseRig", "BuiltRig", "DesignSpace", "Evaluation", "EvaluationTask", "Parameter", "build_rig",
    "compute_objective_contributions", "compute_rig_context", "evaluate_rig", "predict_scene", "rank_evaluations",
]  # fmt: skip


_DIGITS = 4  # significant digits of searched values


@dataclass(frozen=True)
class Parameter:
    """One design variable: a range from ``low`` to ``high``, or choices."""

    name: str  # path of a field, or a named variable of the design specification
    low: float = 0.0
    high: float = 1.0
    logarithmic: bool = False
    whole: bool = False
    choices: tuple[Any, ...] = ()

    def value(self, unit: float) -> Any:
        """Return the value at a coordinate from 0 to 1."""
        if self.choices:
            return self.choices[min(int(unit * len(self.choices)), len(self.choices) - 1)]
        if self.whole and not self.logarithmic:
            first, last = math.ceil(self.low), math.floor(self.high)
            return min(first + int(unit * (last - first + 1)), last)
        if self.logarithmic:
            value = float(self.low * (self.high / self.low) ** unit)
        else:
            value = self.low + (self.high - self.low) * unit
        return self.rounded(value)

    def rounded(self, value: float) -> float | int:
        """Return a value of the range, rounded to an integer or to four digits."""
        if self.whole:
            return min(max(round(value), math.ceil(self.low)), math.floor(self.high))
        return min(max(float(f"{value:.{_DIGITS}g}"), self.low), self.high)

    def unit(self, value: Any) -> float:
        """Return the coordinate from 0 to 1 of a value."""
        if self.choices:
            return (self.choices.index(value) + 0.5) / len(self.choices)
        if self.whole and not self.logarithmic:
            first, last = math.ceil(self.low), math.floor(self.high)
            return float((value - first + 0.5) / (last - first + 1))
        if self.logarithmic:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (float(value) - self.low) / (self.high - self.low)

    @property
    def levels(self) -> int:
        """Number of values; 0 for a range of real numbers."""
        if self.choices:
            return len(self.choices)
        return math.floor(self.high) - math.ceil(self.low) + 1 if self.whole else 0


@dataclass(frozen=True)
class DesignSpace:
    """All design variables, in the order of the design specification."""

    parameters: tuple[Parameter, ...]

    def __len__(self) -> int:
        """Return the number of parameters."""
        return len(self.parameters)

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return [one.name for one in self.parameters]

    def values(self, point: Sequence[float]) -> dict[str, Any]:
        """Return the values of a point of the unit cube, by name."""
        return {one.name: one.value(float(unit)) for one, unit in zip(self.parameters, point, strict=True)}

    def point(self, values: Mapping[str, Any]) -> list[float]:
        """Return the point of the unit cube of given values."""
        return [one.unit(values[one.name]) for one in self.parameters]


PHOTONS_PER_LUX_UM2_S = 4.09e3
"""Photons per µm² and second at 1 lux and 555 nm: 1 / 683 W/m² over h c / λ = 3.58e-19 J."""
_WAVELENGTH_UM = 0.55
_AIRY_SIGMA = 0.421
"""Standard deviation of the Gaussian fit to the core of the Airy disc, in λ N: 0.345 of its radius 1.22 λ N."""
_EXPOSED = 0.8  # fraction of full scale of radiance 1 without a specified illumination
_EXPOSURE_S = 0.01


@dataclass(frozen=True)
class BaseRig:
    """Common properties of all rigs."""

    plain: Mapping[str, Any]  # the base scene as plain data, with all fields
    places: Mapping[str, tuple[str, ...]]  # paths without wildcards, by path of the specification
    entries: CatalogueEntries
    light: IlluminationSpec | None  # None for one adapted to the camera
    depth_mm: float  # median of the measured region in the base scene, at which the lens is focused


@dataclass(frozen=True)
class BuiltRig:
    """The scene of a rig as plain data, and the selected catalogue entries."""

    plain: dict[str, Any]
    lens: LensEntry | None = None
    camera: CameraEntry | None = None
    stage: StageEntry | None = None
    f_number: float | None = None


def build_rig(base: BaseRig, values: Mapping[str, Any]) -> BuiltRig:
    """Return the scene of a rig."""
    plain = copy.deepcopy(dict(base.plain))
    for path, places in base.places.items():
        for place in places:
            assign(plain, place, copy.deepcopy(values[path]))
    moved = float(values.get("working_distance_mm", base.depth_mm)) - base.depth_mm
    if moved:
        _move(plain, moved)
    lens = base.entries.lenses[values["lens"]] if "lens" in values else None
    camera = base.entries.cameras[values["camera"]] if "camera" in values else None
    stage = base.entries.stages[values["stage"]] if "stage" in values else None
    if "exposure_s" in values:
        plain["shutter"]["exposure_time_s"] = values["exposure_s"]
    exposure = plain["shutter"]["exposure_time_s"]
    if camera is not None:
        _put_camera(plain, camera, exposure)
    elif isinstance(plain["sensor"], dict) and "exposure_s" in values and "exposure_time_s" in plain["sensor"]:
        plain["sensor"]["exposure_time_s"] = exposure
    f_number = None
    if lens is not None:
        f_number = float(values.get("f_number", min(max(8.0, lens.f_number_least), lens.f_number_most)))
        _put_lens(plain, lens, f_number, base.depth_mm + moved, base.light)
    if stage is not None:
        _put_stage(plain, stage, exposure)
    return BuiltRig(plain, lens, camera, stage, f_number)


def _move(plain: dict[str, Any], by_mm: float) -> None:
    """Move all objects and the focus along Z, in place."""
    for thing in (*plain.get("objects", ()), *plain.get("plants", ())):
        x, y, z = thing["pose"]["position_mm"]
        thing["pose"]["position_mm"] = [x, y, z + by_mm]
    defocus = plain["optics"].get("defocus")
    if defocus is not None:
        defocus["focus_distance_mm"] += by_mm


def _put_camera(plain: dict[str, Any], entry: CameraEntry, exposure_s: float) -> None:
    camera = plain["camera"]
    focal = camera["focal_length_mm"]
    if focal is None and camera["pixel_pitch_um"] is None:
        # The focal length in px is converted to mm; a lens of the catalogue replaces it.
        focal = 1e-3 * camera["focal_length_px"] * entry.pixel_pitch_um
    camera |= {"width": entry.width, "height": entry.height, "pixel_pitch_um": entry.pixel_pitch_um}
    camera |= {"focal_length_mm": focal, "focal_length_px": None, "principal_point_px": None}
    exposure = exposure_s or _EXPOSURE_S
    given = {
        "quantum_efficiency": entry.quantum_efficiency,
        "full_well_e": entry.full_well_e,
        "temporal_dark_noise_e": entry.read_noise_e,
        "bit_depth": entry.bit_depth,
        "dark_current_e_per_s": entry.dark_current_e_per_s,
        "dsnu_e": entry.dsnu_e,
        "prnu": entry.prnu,
    }
    sensor: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    whole = {**(PRESETS[entry.preset].values if entry.preset else {}), **sensor}
    top = 2.0 ** whole["bit_depth"] - 1 - whole.get("black_level_dn", 0.0)
    gain = whole.get("gain_dn_per_e", top / whole["full_well_e"])
    holds = min(whole["full_well_e"], top / gain)
    sensor |= {"kind": "emva1288", "exposure_time_s": exposure, "gain_dn_per_e": gain}
    sensor["photon_rate_per_s"] = _EXPOSED * holds / (whole["quantum_efficiency"] * exposure)
    plain["sensor"] = sensor | ({"preset": entry.preset} if entry.preset else {})


def _put_lens(
    plain: dict[str, Any], lens: LensEntry, f_number: float, depth_mm: float, light: IlluminationSpec | None
) -> None:
    camera = plain["camera"]
    pitch = camera["pixel_pitch_um"]
    if pitch is None:
        message = "is required with a lens, whose focal length is in mm; or add camera to the variables"
        raise SceneError([Problem("camera.pixel_pitch_um", message)])
    if depth_mm <= lens.focal_length_mm:
        message = f"must be above the focal length of the lens, {lens.focal_length_mm:g} mm"
        raise SceneError([Problem("working_distance_mm", message, depth_mm)])
    # Image distance of a thin lens focused at Z: f Z / (Z - f).
    image_mm = lens.focal_length_mm * depth_mm / (depth_mm - lens.focal_length_mm)
    effective = f_number * image_mm / lens.focal_length_mm
    camera |= {"focal_length_mm": image_mm, "focal_length_px": None, "distortion": None}
    wavelength = light.wavelength_um if light is not None else _WAVELENGTH_UM
    blur_px = math.hypot(lens.blur_um, _AIRY_SIGMA * wavelength * effective) / pitch
    optics = plain["optics"]
    earlier = optics.get("defocus") or {}
    kept = {name: value for name, value in earlier.items() if name in ("focus_distance_mm", "samples")}
    focus = {"focus_distance_mm": depth_mm, **kept}
    optics |= {
        "psf": {"kind": "gaussian", "sigma_px": blur_px},
        "defocus": {"aperture_mm": lens.focal_length_mm / f_number, **focus},
    }
    sensor = plain["sensor"]
    if light is not None and isinstance(sensor, dict) and "photon_rate_per_s" in sensor:
        lux = light.illuminance_lux / (4 * effective**2)
        sensor["photon_rate_per_s"] = PHOTONS_PER_LUX_UM2_S * lux * pitch**2


def _put_stage(plain: dict[str, Any], entry: StageEntry, exposure_s: float) -> None:
    names = ("repeatability_um", "backlash_um", "straightness_um", "pitch_urad", "yaw_urad", "roll_urad")
    stage = plain["stage"]
    stage["errors"] = {name: getattr(entry, name) for name in names}
    step = abs(stage["baseline_mm"]) / entry.speed_mm_per_s if entry.speed_mm_per_s else 0.0
    stage["time_per_position_s"] = entry.settle_s + step + exposure_s


_NO_SCENE = 100.0  # excess of a candidate without a valid scene or visible region, above that of any constraint
_MOST_EXCESS = 10.0
_S_PER_H = 3600.0


@dataclass(frozen=True)
class EvaluationTask:
    """Input of the evaluation of any rig; the method has the settings of the scene."""

    base: BaseRig
    limits: tuple[ConstraintSpec, ...]
    objectives: tuple[Objective, ...]
    method: str


@dataclass(frozen=True)
class Evaluation:
    """Evaluation of a candidate rig."""

    values: Mapping[str, Any]  # of the design variables by name
    predicted: Mapping[str, float]  # by title of the objective; infinite if not available
    parts: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # by objective: noise, stage, scan
    constraints: tuple[ConstraintValue, ...] = ()  # all evaluated; empty for an invalid scene
    problem: str = ""  # reason for an invalid scene, or an empty text

    @property
    def holds(self) -> bool:
        """Whether the rig is valid and satisfies all constraints."""
        stated = all(math.isfinite(value) for value in self.predicted.values())
        return not self.problem and stated and all(one.holds for one in self.constraints)

    @property
    def excess(self) -> float:
        """Sum of the relative constraint violations; 0 for a feasible rig."""
        if self.problem:
            return _NO_SCENE
        over = sum(min(-one.margin, _MOST_EXCESS) for one in self.constraints if not one.holds)
        return over + _MOST_EXCESS * sum(not math.isfinite(value) for value in self.predicted.values())


def evaluate_rig(task: EvaluationTask, values: Mapping[str, Any]) -> Evaluation:
    """Evaluate one rig."""
    nothing = {one.title: math.inf for one in task.objectives}
    try:
        built = build_rig(task.base, values)
        scene = Scene.from_dict(built.plain)
        prediction = predict_scene(scene, task.method)
    except SceneError as error:
        first = error.problems[0]
        return Evaluation(values, nothing, problem=f"{first.path}: {first.message}" if first.path else first.message)
    facts = compute_rig_context(task, built, scene, prediction, values)
    if facts is None:
        region = task.objectives[0].region
        return Evaluation(values, nothing, problem=f"{region}: is not visible")
    parts = {one.title: compute_objective_contributions(one, scene, prediction) for one in task.objectives}
    total = {title: _root_sum(each.values()) if each else math.inf for title, each in parts.items()}
    constraints = tuple(one for limit in task.limits for one in limit.checked(facts))
    return Evaluation(values, total, parts, (*constraints, *_hardware_constraints(facts)))


def predict_scene(scene: Scene, method: str) -> Prediction:
    """Return the prediction of a scene, without warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        return predict(scene, method=method)


def compute_rig_context(
    task: EvaluationTask, built: BuiltRig, scene: Scene, prediction: Prediction, values: Mapping[str, Any]
) -> RigContext | None:
    """Return the context of a rig; None if the first objective's region is not visible."""
    region = task.objectives[0].region
    if region not in prediction.by_region:
        return None
    return RigContext(scene, prediction, region, values, built.lens, built.camera, built.stage, built.f_number)


def compute_objective_contributions(objective: Objective, scene: Scene, prediction: Prediction) -> dict[str, float]:
    """Return the contributions of each source to the statistic of an objective; empty if it is not predicted."""
    quantity, region = objective.quantity, objective.region
    figures = prediction.precisions.get(region, {})
    if quantity not in figures:
        return {}
    figure = figures[quantity]
    signals = {name: one.signal for name, one in figures.items()}
    hour = 100.0 * _S_PER_H / scene.frames.frame_interval_s if QUANTITIES[quantity].units == "%/h" else 1.0
    more = compute_stage_uncertainty(scene, prediction.by_region[region], signals)
    factor = hour * STATISTICS[objective.statistic].of_normal
    value = compute_predicted_statistic(figure, objective.statistic)
    share = prediction.growth_bias_share.get(region, 0.0) if quantity == "growth_rate" else 0.0
    found = {"noise": value * math.sqrt(1.0 - share)}
    if share:
        found["anisotropy"] = value * math.sqrt(share)
    return found | {what: factor * stated[quantity] for what, stated in more.items() if quantity in stated}


def _root_sum(values: Any) -> float:
    total = math.sqrt(math.fsum(value * value for value in values))
    return total if total > 0 else math.inf


def _hardware_constraints(facts: RigContext) -> Iterator[ConstraintValue]:
    lens, stage = facts.lens, facts.stage
    if lens is not None:
        focus = facts.scene.optics.defocus
        at = facts.depth_mm if focus is None else focus.focus_distance_mm
        yield evaluate_bound("least_focus", "focus distance of the lens", at, "at least", lens.least_focus_mm, "mm")
        yield from _aperture_constraints(facts.f_number or lens.f_number_least, lens.f_number_least, lens.f_number_most)
        camera = facts.scene.camera
        diagonal = 1e-3 * (camera.pixel_pitch_um or 0.0) * math.hypot(camera.width, camera.height)
        yield evaluate_bound("image_circle", "diagonal of the sensor", diagonal, "at most", lens.image_circle_mm, "mm")
    if stage is not None:
        yield evaluate_bound("travel", "travel of the chosen stage", facts.travel_mm, "at most", stage.travel_mm, "mm")


def _aperture_constraints(f_number: float, least: float, most: float) -> Iterator[ConstraintValue]:
    yield evaluate_bound("f_number", "f-number of the lens", f_number, "at least", least, "1")
    yield evaluate_bound("f_number", "f-number of the lens", f_number, "at most", most, "1")


def rank_evaluations(found: Sequence[Evaluation]) -> list[Evaluation]:
    """Return evaluations sorted by excess, feasible first, then by the product of the objectives."""

    def worth(one: Evaluation) -> tuple[float, float]:
        logs = [math.log(value) for value in one.predicted.values() if math.isfinite(value)]
        return one.excess, sum(logs) if logs else math.inf

    return sorted(found, key=worth)
