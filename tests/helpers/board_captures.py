"""A simulated capture with images of a board, small enough to be calibrated in seconds."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml

from scenetruth.capture import simulate_capture
from scenetruth.schema import label, read_intrinsics

__all__ = ["BOARD_SCENE", "changed_capture", "constant_depth", "make_board_capture", "true_values"]

BOARD_SCENE: dict[str, Any] = {
    "camera": {
        "width": 240,
        "height": 180,
        "focal_length_px": 1900,
        "principal_point_px": [122.4, 86.1],
        "distortion": {"k1": -0.3, "k2": 1.5, "p1": 1e-3, "p2": -8e-4},
    },
    "optics": {"psf": {"kind": "gaussian", "sigma_px": 0.6}},
    "stage": {
        "positions": 3,
        "baseline_mm": 5.0,
        "axis_tilt_urad": [900, -2000],
        "errors": {"preset": "screw_stage"},
    },
    "frames": {"count": 3, "frame_interval_s": 60},
    "sensor": {"kind": "emva1288", "preset": "industrial_cmos"},
    "objects": [
        {
            "name": "wall",
            "mesh": {"kind": "plane", "size_mm": [160, 160]},
            "texture": {"kind": "noise", "wavelength_mm": [0.9, 4.0]},
            "pose": {"position_mm": [0, 0, 660], "rotations": [{"axis": [0, 1, 0], "angle_deg": 15}]},
            "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.05, 0.02, 0.2]}],
        }
    ],
    "seed": 5,
}


BOARD = {"kind": "charuco", "squares": [8, 6], "square_mm": 9.5, "marker_mm": 7.0, "dictionary": "4X4_250"}
"""Squares are large enough for windows between edge and marker, which are few in the small image."""


def make_board_capture(folder: Path, **settings: Any) -> Path:
    """Simulate the capture of a slanted, moving wall with images of a board in five poses."""
    return simulate_capture(BOARD_SCENE, folder, **{"board": BOARD, "poses": 5, **settings})


def constant_depth(recording: xr.Dataset) -> xr.Dataset:
    """Return an estimate without any work: the depth of the wall, with its standard deviation."""
    sizes = recording["image"].sizes
    shape = (sizes["t"], sizes["y"], sizes["x"])
    maps = {"depth": np.full(shape, 660.0), "depth_std": np.full(shape, 0.05)}
    return label("estimate", maps, read_intrinsics(recording), t=recording["t"].values)


def true_values(folder: Path) -> dict[str, float]:
    """Return the true values of parameters of a simulated capture by the names of a calibration."""
    true = yaml.safe_load((folder / "truth" / "parameters.yaml").read_text(encoding="utf-8"))
    c_x, c_y = true["camera"]["principal_point_px"]
    lens = {name: value for name, value in true["camera"]["distortion"].items() if value}
    return {
        "f": true["camera"]["focal_length_px"], "c_x": c_x, "c_y": c_y, **lens,
        "step_scale": true["stage"]["step_scale"], "board.scale": true["board"]["scale"],
    }  # fmt: skip


def changed_capture(folder: Path, copy: Path, **sections: dict[str, Any]) -> Path:
    """Return a copy of a capture without its truth, whose file has other fields; None removes a field."""
    shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("truth", "*.json", ".*"))
    file = copy / "capture.yaml"
    plain = yaml.safe_load(file.read_text(encoding="utf-8"))
    for section, fields in sections.items():
        for name, value in fields.items():
            if value is None:
                plain[section].pop(name, None)
            else:
                plain[section][name] = value
        if not plain[section]:
            del plain[section]
    file.write_text(yaml.safe_dump(plain), encoding="utf-8")
    return copy
