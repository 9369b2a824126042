"""A small scene that tests share, and a window that fits into it."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from scenetruth.estimators import MethodSpec

METHOD = MethodSpec("structure_tensor", {"window_sigma_px": 3, "window_taps_px": 13})
DEPTH_MM = 500.0


def scene(**changes: Any) -> dict[str, Any]:
    """A textured wall across the optical axis, 64 x 48 px, 3 x 3 images."""
    wall = {
        "name": "wall",
        "mesh": {"kind": "plane", "size_mm": [200, 200]},
        "pose": {"position_mm": [0, 0, DEPTH_MM]},
        "texture": {"kind": "noise", "wavelength_mm": [6, 20]},
        "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.2, 0, 0.1]}],
    }
    plain = {
        "camera": {"width": 64, "height": 48, "focal_length_px": 500},
        "stage": {"positions": 3, "baseline_mm": 2},
        "frames": {"count": 3},
        "objects": [wall],
        "sensor": {"noise_std": 0.01},
        "render": {"backend": "raycast"},
        # Images without an edge are all interior.
        "score": {"interior_margin_px": 0},
        "seed": 5,
    }
    return plain | changes


def nearest(recording: xr.Dataset) -> dict[str, Any]:
    """Know the depth, and nothing of motion: a method that takes no time."""
    return {"depth": np.full(recording["image"].isel(s=0).shape, DEPTH_MM)}


def failing(recording: xr.Dataset) -> dict[str, Any]:
    msg = "no idea"
    raise ZeroDivisionError(msg)
