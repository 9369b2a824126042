"""Smooth surfaces that move: scenes, and the motion that they have."""

from __future__ import annotations

from typing import Any

import numpy as np

from scenetruth.scene import Scene

__all__ = ["POSITION", "SPEED", "SPIN_DEG", "TILT_DEG", "scene_of"]


POSITION, SPIN_DEG, SPEED, TILT_DEG = np.array([1.0, -2.0, 660.0]), 1.5, np.array([0.4, -0.3, 0.7]), (25.0, -20.0)


def scene_of(mesh: dict[str, Any], width: int = 80, height: int = 60) -> Scene:
    """Return a tilted object that shifts and turns about Z; 1 px is 1 mm at 660 mm."""
    return Scene.from_dict(
        {
            "camera": {"width": width, "height": height, "focal_length_px": 660},
            "stage": {"positions": 3, "baseline_mm": 5},
            "frames": {"count": 3},
            "objects": [
                {
                    "name": "thing",
                    "mesh": mesh,
                    "texture": {"kind": "uniform"},
                    "pose": {
                        "position_mm": POSITION.tolist(),
                        "rotations": [
                            {"axis": [0, 1, 0], "angle_deg": TILT_DEG[0]},
                            {"axis": [1, 0, 0], "angle_deg": TILT_DEG[1]},
                        ],
                    },
                    "motion": [
                        {"kind": "rotation", "axis": [0, 0, 1], "rate_deg_per_frame": SPIN_DEG},
                        {"kind": "velocity", "velocity_mm_per_frame": SPEED.tolist()},
                    ],
                }
            ],
        }
    )
