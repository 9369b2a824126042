"""Measurements to make twins of: simulated captures, imported and estimated."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml

from scenetruth.capture import Capture, RigCalibration, import_capture, load_capture, simulate_capture
from scenetruth.errors import SceneWarning
from scenetruth.estimators import estimate
from scenetruth.schema import make_recording
from scenetruth.storage import save_store

__all__ = ["MeasuredCapture", "measure_scene", "shifted_recording", "two_plates"]

FOCAL_PX = 1000.0


@dataclass(frozen=True)
class MeasuredCapture:
    """A capture with its run directory and the truth of its scene."""

    capture: Capture
    run: Path
    truth: Path


def two_plates(**changes: Any) -> dict[str, Any]:
    """Return a scene: a plate that moves in front of a wall at rest, with a blurred lens and an industrial camera."""
    noise = {"kind": "noise", "wavelength_mm": [1.8, 6.0], "mean": 0.4, "rms_contrast": 0.25}
    plain: dict[str, Any] = {
        "description": "Plate in front of a wall",
        "camera": {"width": 128, "height": 96, "focal_length_px": FOCAL_PX},
        "optics": {"psf": {"kind": "gaussian", "sigma_px": 0.6}},
        "stage": {"positions": 3, "baseline_mm": 8.0},
        "frames": {"count": 3, "frame_interval_s": 60},
        "objects": [
            {
                "name": "wall",
                "mesh": {"kind": "plane", "size_mm": [170, 130]},
                "pose": {"position_mm": [0, 0, 690], "rotations": [{"axis": [0, 1, 0], "angle_deg": 5}]},
                "texture": noise,
            },
            {
                "name": "plate",
                "mesh": {"kind": "plane", "size_mm": [42, 44]},
                "pose": {"position_mm": [-10, 0, 640], "rotations": [{"axis": [1, 0, 0], "angle_deg": 20}]},
                "texture": noise,
                "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.2, 0.1, -0.8]}],
            },
        ],
        "sensor": {"kind": "emva1288", "preset": "industrial_cmos"},
        "seed": 8,
    }
    return {**plain, **changes}


def measure_scene(
    folder: Path, scene: dict[str, Any], calibration: RigCalibration | None = None, **settings: Any
) -> MeasuredCapture:
    """Simulate a capture of a scene, import it with its focal length or a calibration, and estimate it."""
    with warnings.catch_warnings():
        # Plates of a small image have few pixels far from their edges.
        warnings.simplefilter("ignore", SceneWarning)
        given = {"poses": 0, "dark": 6, "flat": 6, "static": 4, **settings}
        made = simulate_capture(scene, folder / "capture", **given)
        plain = yaml.safe_load((made / "capture.yaml").read_text())
        plain["camera"]["focal_length_px"] = FOCAL_PX
        (made / "capture.yaml").write_text(yaml.safe_dump(plain))
        capture = load_capture(made)
        recording = import_capture(capture, output=folder / "run", calibration=calibration)
        save_store(estimate(recording.load(), "refined"), folder / "run" / "estimate.refined.zarr")
    return MeasuredCapture(capture, folder / "run", made / "truth" / "truth.zarr")


def shifted_recording(
    texture: np.ndarray[Any, Any], shift_px: float, noise: float, seed: int, count: int = 5
) -> xr.Dataset:
    """Return images of a wall at 500 mm, whose texture moves by whole pixels per position, with white noise.

    ``texture``: Radiances, with columns for all positions.
    """
    draw, middle = np.random.default_rng(seed), (count - 1) // 2
    reach = round(middle * shift_px)
    width = texture.shape[1] - 2 * reach
    images = []
    for s in range(count):
        first = reach + round((s - middle) * shift_px)
        images.append(texture[:, first : first + width])
    values = np.stack(images)[:, None] + noise * draw.standard_normal((count, 1, texture.shape[0], width))
    # f V / Z = shift.
    return make_recording(values.astype(np.float32), focal_length_px=1000.0, baseline_mm=0.5 * shift_px, full_scale=1.0)
