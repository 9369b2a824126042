"""The scene of a rig: the base scene with the values of what is free, and with what was chosen from catalogues."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from scenetruth.camera.sensor.presets import PRESETS
from scenetruth.dataset.recipe.paths import assign
from scenetruth.design.optimise.catalogues.entries import CameraEntry, LensEntry, StageEntry
from scenetruth.design.optimise.catalogues.load import Entries
from scenetruth.design.optimise.goal.parts import Light
from scenetruth.errors import Problem, SceneError

__all__ = ["Base", "Built", "build"]

PHOTONS_PER_LUX_UM2_S = 4.09e3
"""Photons per µm² and second of light of 555 nm and 1 lux: 1 / 683 W/m² over h c / λ = 3.58e-19 J."""
_WAVELENGTH_UM = 0.55
_AIRY_SIGMA = 0.421
"""Standard deviation of the Gaussian that fits the core of Airy's disc, in λ N: 0.345 of its radius of 1.22 λ N."""
_EXPOSED = 0.8
"""Share of what a sensor can say that radiance 1 fills, where no light is given."""
_EXPOSURE_S = 0.01


@dataclass(frozen=True)
class Base:
    """What all rigs have in common.

    Parameters
    ----------
    plain
        The base scene as plain values, with all fields.
    places
        Paths without wildcards, by those of the goal.
    entries
        The catalogues.
    light
        The light; None for as much as cameras need.
    depth_mm
        Depth of what is measured in the base scene: the lens is focused there.
    """

    plain: Mapping[str, Any]
    places: Mapping[str, tuple[str, ...]]
    entries: Entries
    light: Light | None
    depth_mm: float


@dataclass(frozen=True)
class Built:
    """A rig's scene as plain values, and what was chosen from catalogues."""

    plain: dict[str, Any]
    lens: LensEntry | None = None
    camera: CameraEntry | None = None
    stage: StageEntry | None = None
    f_number: float | None = None


def build(base: Base, values: Mapping[str, Any]) -> Built:
    """Return the scene of a rig.

    Parameters
    ----------
    base
        What all rigs have in common.
    values
        Of what is free, by name.

    Raises
    ------
    SceneError
        If what was chosen cannot be put together; whether it makes a scene is another question.
    """
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
    return Built(plain, lens, camera, stage, f_number)


def _move(plain: dict[str, Any], by_mm: float) -> None:
    """Move all that stands before the camera, and the focus with it."""
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
        # The base scene's field of view in px says nothing of a lens; a lens of the catalogue replaces it.
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


def _put_lens(plain: dict[str, Any], lens: LensEntry, f_number: float, depth_mm: float, light: Light | None) -> None:
    camera = plain["camera"]
    pitch = camera["pixel_pitch_um"]
    if pitch is None:
        message = "must be given with a lens: its focal length is in mm; or let camera be free too"
        raise SceneError([Problem("camera.pixel_pitch_um", message)])
    if depth_mm <= lens.focal_length_mm:
        message = f"the lens's focal length of {lens.focal_length_mm:g} mm leaves no image at this distance"
        raise SceneError([Problem("working_distance_mm", message, depth_mm)])
    # A thin lens that is focused at Z has its image at f Z / (Z - f): all scales with that.
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
