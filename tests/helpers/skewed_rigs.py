"""Calibrations of a rig with errors, and images that its cameras take of a textured plane, in closed form."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
import yaml
from numpy.typing import NDArray

from scenetruth.camera import Camera, Distortion
from scenetruth.capture import RigCalibration

__all__ = ["CAMERA", "POSITIONS_MM", "plane_image", "skewed_rig", "write_folder"]

Array = NDArray[np.float64]

CAMERA = Camera(
    width=96, height=72, focal_length_px=1000, principal_point_px=(49.2, 34.1),
    distortion=Distortion(k1=-0.8, k2=5.0, p1=1e-3, p2=-2e-3),
)  # fmt: skip
POSITIONS_MM = (-4.0, 0.0, 4.0)


def skewed_rig(
    seed: int = 0, size: float = 1.0, std: Mapping[str, float] | None = None, *, aspect: float = 0.0
) -> RigCalibration:
    """Return a calibration with an inclined axis and errors of all positions, times a factor."""
    plain = RigCalibration.from_camera(CAMERA, POSITIONS_MM, std=std)
    values, generator = plain.values.copy(), np.random.default_rng(seed)
    for name, value in {"axis_y": 3e-3, "axis_z": -4e-3, "step_scale": 2e-3, "aspect": aspect}.items():
        values[plain.names.index(name)] = size * value
    start = plain.layout.first_position
    moved = generator.normal(size=(len(POSITIONS_MM), 6)) * [3e-4, 3e-4, 1e-3, 0.002, 0.02, 0.02]
    values[start : start + moved.size] = size * moved.ravel()
    return RigCalibration(
        plain.width, plain.height, plain.positions_mm, plain.reference, plain.names, values, plain.covariance,
        plain.prior_std,
    )  # fmt: skip


def plane_image(points_mm: Array, seed: int = 0) -> Array:
    """Return grey values from 0.1 to 0.9 of points on a plane: waves of 3 to 8 mm in X and Y."""
    generator = np.random.default_rng(seed)
    total = np.zeros(points_mm.shape[:-1])
    for _ in range(24):
        angle, phase, length = generator.uniform(0, 2 * np.pi), generator.uniform(0, 2 * np.pi), generator.uniform(3, 8)
        along = np.cos(angle) * points_mm[..., 0] + np.sin(angle) * points_mm[..., 1]
        total += np.cos(2 * np.pi * along / length + phase)
    return np.asarray(0.5 + 0.06 * total / np.sqrt(12))


def write_folder(folder: Path, images: Array, depth_mm: float | None, **changes: Any) -> dict[str, Any]:
    """Write a capture folder of images, shape (s, t, y, x), in 16 bits; return its capture file."""
    plain: dict[str, Any] = {
        "camera": {"width": images.shape[-1], "height": images.shape[-2], "bit_depth": 16},
        "stage": {"positions": len(images), "baseline_mm": 4.0},
        "frames": {"count": images.shape[1]},
        "files": {"images": "s{s:+d}_t{t:+d}.tif"},
    }
    if depth_mm is not None:
        plain["distance_mm"] = depth_mm
    for section, values in changes.items():
        plain[section] |= values
    folder.mkdir(parents=True, exist_ok=True)
    middle = (len(images) - 1) // 2, (images.shape[1] - 1) // 2
    for s, t in np.ndindex(images.shape[:2]):
        name = f"s{s - middle[0]:+d}_t{t - middle[1]:+d}.tif"
        tifffile.imwrite(folder / name, np.rint(65535 * images[s, t]).astype(np.uint16))
    (folder / "capture.yaml").write_text(yaml.safe_dump(plain), encoding="utf-8")
    return plain
