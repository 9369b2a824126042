"""Small recipes that are drawn in milliseconds and made in fractions of a second."""

from __future__ import annotations

from typing import Any

SCENE: dict[str, Any] = {
    "camera": {"width": 48, "height": 36, "focal_length_px": 80},
    "stage": {"positions": 3, "baseline_mm": 5},
    "frames": {"count": 3},
    "objects": [
        {
            "name": "wall",
            "mesh": {"kind": "plane", "size_mm": [200, 200]},
            "texture": {"kind": "noise", "wavelength_mm": [6, 20], "mean": 0.5},
            "pose": {"position_mm": [0, 0, 120]},
        },
        {
            "name": "tile",
            "mesh": {"kind": "plane", "size_mm": [20, 20]},
            "texture": {"kind": "noise", "wavelength_mm": [6, 20], "mean": 0.5},
            "pose": {"position_mm": [0, 0, 100]},
            "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0, 0, -1]}],
        },
    ],
    "sensor": {"noise_std": 0.01, "bit_depth": 8},
    "render": {"backend": "raycast", "supersampling": 1},
}
RECIPE: dict[str, Any] = {
    "name": "tiles",
    "base": [{"scene": SCENE}],
    "samples": 4,
    "seed": 11,
    "distributions": {"objects.1.pose.position_mm.2": {"kind": "uniform", "low": 90, "high": 110, "name": "z"}},
}
