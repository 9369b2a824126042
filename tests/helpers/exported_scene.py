"""One small scene with everything that formats must tell: depth steps, hidden points, curved paths, empty pixels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import scenetruth as st
from scenetruth.exporters import ExportResult
from scenetruth.scene import Scene

Export = Callable[..., ExportResult]
"""What writes the scene in a format, into a folder of that name."""


def scene(**changes: Any) -> Scene:
    """Return a tilted tile that turns and comes nearer in front of a wall that ends inside the image."""
    texture = {"kind": "noise", "wavelength_mm": [6.0, 30.0]}
    wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [72, 90]}, "texture": texture}
    tile = {"name": "tile", "mesh": {"kind": "plane", "size_mm": [28, 24]}, "texture": texture}
    moving = {"kind": "acceleration", "velocity_mm_per_frame": [3, 1, -2], "acceleration_mm_per_frame2": [1, 0, -1]}
    turning = {"kind": "rotation", "axis": [0, 1, 1], "rate_deg_per_frame": 4}
    plain: dict[str, Any] = {
        "camera": {"width": 64, "height": 48, "focal_length_px": 80},
        "stage": {"positions": 3, "baseline_mm": 4.0},
        "frames": {"count": 3},
        "objects": [
            wall | {"pose": {"position_mm": [-10, 0, 100], "rotations": [{"axis": [0, 1, 0], "angle_deg": 10}]}},
            tile
            | {
                "pose": {"position_mm": [-2, 0, 78], "rotations": [{"axis": [1, 1, 0], "angle_deg": 15}]},
                "motion": [turning, moving],
            },
        ],
        "render": {"backend": "raycast", "supersampling": 4},
        "seed": 3,
    }
    return st.Scene.from_dict(plain | changes)
