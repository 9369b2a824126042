"""Camera, stage and sensor of a twin, from a capture, its calibration and its noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenetruth.camera import Camera
from scenetruth.capture.calibration import RigCalibration
from scenetruth.capture.capture_file import Capture
from scenetruth.capture.folder_reading import CaptureFolder
from scenetruth.capture.measured_noise import sensor_noise
from scenetruth.capture.radiometry import SensorNoise
from scenetruth.capture.rectification import ideal_rotation
from scenetruth.capture.twin.surface_texture import NoiseLine

__all__ = ["SensorModel", "TwinRig", "describe_sensor", "make_rig"]

Floats = NDArray[np.float64]

_SHOT_SHARE = 1e-3
"""Share of shot noise in the variance at full scale below which the noise of a sensor does not depend on light."""
_DIGITS, _SAME_MM, _LEAST_TILT_URAD = 6, 1e-6, 1e-3


@dataclass(frozen=True, eq=False)
class TwinRig:
    """Camera and stage of a twin as sections of a scene file, in the frame of the recording.

    ``camera``: Section ``camera`` with the lens of the real camera. ``stage``: Section ``stage``; with a calibration it
    lists the estimated poses. ``reference_rotation``: Axes of the reference camera in the frame of the recording, as
    columns.
    """

    camera: dict[str, Any]
    stage: dict[str, Any]
    reference_rotation: Floats


def make_rig(capture: Capture, calibration: RigCalibration | None, recording: xr.Dataset) -> TwinRig:
    """Return camera and stage of a capture; with a calibration, the estimated lens and poses."""
    given = capture.stage
    stage: dict[str, Any] = given.model_dump(
        mode="json",
        include={"positions", "baseline_mm", "positions_mm", "rows", "row_spacing_mm", "scan", "time_per_position_s"},
        exclude_none=True,
    )
    along = recording["stage_x_mm"].values if calibration is None else calibration.positions_mm
    x_mm = along - along[(len(along) - 1) // 2]
    if np.abs(x_mm - given.x_mm).max() > _SAME_MM:
        # Measured positions.
        stage["positions_mm"] = np.round(x_mm, _DIGITS).tolist()
        del stage["positions"]
    errors = None if given.errors is None else given.errors.model_dump(mode="json", exclude={"preset"})
    if calibration is None:
        # Guide errors are not measured; visits vary as stated.
        if errors is not None:
            stage["errors"] = {name: errors[name] for name in ("repeatability_um", "backlash_um")}
        return TwinRig(_camera_section(capture.camera.to_camera()), stage, np.eye(3))
    if errors is not None:
        # Visits that a fiducial strip has measured, image by image, were removed by the rectification.
        known = "noise_share" in recording and "t" in recording["noise_share"].dims
        stage["errors"] = {**errors, "repeatability_um": 0.0, "backlash_um": 0.0} if known else errors
    rectified = recording.attrs.get("geometry") == "rectified"
    rotation = ideal_rotation(calibration) if rectified else np.eye(3)
    axis = rotation.T @ calibration.axis
    tilt = 1e6 * axis[1:] / axis[0]
    if np.abs(tilt).max() > _LEAST_TILT_URAD:
        stage["axis_tilt_urad"] = np.round(tilt, _DIGITS).tolist()
    direction = np.array([1.0, *(1e-6 * np.array(stage.get("axis_tilt_urad", (0.0, 0.0))))])
    poses = []
    for position, x in enumerate(np.round(x_mm, _DIGITS).tolist()):
        view = calibration.viewpoint(position)
        offset_um = 1e3 * (rotation.T @ view.position_mm - x * direction)
        turn_urad = 1e6 * Rotation.from_matrix(rotation.T @ view.rotation).as_rotvec()
        names = ("x_um", "y_um", "z_um", "pitch_urad", "yaw_urad", "roll_urad")
        poses.append(dict(zip(names, np.round([*offset_um, *turn_urad], _DIGITS).tolist(), strict=True)))
    stage["poses"] = poses
    return TwinRig(_camera_section(calibration.camera), stage, rotation.T)


def _camera_section(camera: Camera) -> dict[str, Any]:
    return camera.model_dump(mode="json", exclude_none=True)


@dataclass(frozen=True, eq=False)
class SensorModel:
    """Sensor of a twin as the section ``sensor`` of a scene file, with its origin in words."""

    section: dict[str, Any]
    noise: NoiseLine
    origin: str
    measured: SensorNoise | None = None


def describe_sensor(folder: CaptureFolder, seen: NoiseLine | None) -> SensorModel:
    """Return the sensor that has the noise of a capture: from dark frames and flat fields, else from its images.

    Radiance 1 is full scale.

    ``seen``: Noise of the images about their mean on the surfaces, as fractions of full scale.
    """
    measured, camera = sensor_noise(folder), folder.capture.camera
    full = float(2**camera.bit_depth - 1)
    if measured is not None and np.isfinite(measured.gain_dn_per_e):
        # Files may have more bits than the camera.
        unit = folder.images.pixels.full_scale / full
        gain, black = measured.gain_dn_per_e / unit, measured.black_level_dn / unit
        read = measured.temporal_dark_noise_e
        if not np.isfinite(read):
            read = float(np.sqrt(max(measured.dark_noise_dn**2 / unit**2 - 1 / 12, 0.0))) / gain
        section = _emva(folder, gain, black, read)
        for name, value in (("dsnu_e", measured.dsnu_e), ("prnu", measured.prnu)):
            if np.isfinite(value) and value > 0:
                section[name] = _rounded(value)
        return SensorModel(section, _line(gain, black, read, full), "dark frames and flat fields", measured)
    line = seen if seen is not None else NoiseLine((0.29 / full) ** 2, 0.0)
    origin = "differences of the images" if seen is not None else "quantisation alone"
    black = min(camera.black_level_dn, 0.5 * full)
    span = full - black
    if line.slope > _SHOT_SHARE * max(line.dark, 1e-300):
        gain = line.slope * span
        read = float(np.sqrt(max(line.dark * span**2 - 1 / 12, 0.0))) / gain
        return SensorModel(_emva(folder, gain, black, read), line, origin, measured)
    noise = float(np.sqrt(max(line.dark - 1 / (12 * full**2), 0.0)))
    section = {"kind": "gaussian", "noise_std": _rounded(noise), "bit_depth": camera.bit_depth}
    return SensorModel(section, line, origin, measured)


def _emva(folder: CaptureFolder, gain: float, black: float, read_e: float) -> dict[str, Any]:
    """Return a sensor whose full scale is a radiance of 1."""
    camera = folder.capture.camera
    capacity = (2**camera.bit_depth - 1 - black) / gain
    exposure = folder.exposure_time_s or 0.01
    section: dict[str, Any] = {
        "kind": "emva1288",
        "photon_rate_per_s": _rounded(capacity / exposure),
        "exposure_time_s": exposure,
        "quantum_efficiency": 1.0,
        "bit_depth": camera.bit_depth,
        "gain_dn_per_e": _rounded(gain),
        "full_well_e": _rounded(1.01 * capacity),
        "black_level_dn": _rounded(black),
        "temporal_dark_noise_e": _rounded(read_e),
    }
    if camera.encoding != "linear":
        section["gamma"] = 1 / (2.2 if camera.encoding == "srgb" else camera.gamma)
    if camera.bayer is not None and camera.plane == "mosaic":
        section["bayer"] = camera.bayer
    return section


def _line(gain: float, black: float, read_e: float, full: float) -> NoiseLine:
    """Return the noise as fractions of the digital numbers above black."""
    span = full - black
    return NoiseLine(((gain * read_e) ** 2 + 1 / 12) / span**2, gain / span)


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
