"""A scene with a gate that occludes a wall."""

from __future__ import annotations

from typing import Any

from scenetruth.scene import Scene

__all__ = ["gate"]


def gate(**changes: Any) -> Scene:
    """Return a turning plane behind a bar that crosses, with a cube that a part of both hides."""
    plain: dict[str, Any] = {
        "camera": {"width": 60, "height": 44, "focal_length_px": 400},
        "stage": {"positions": 3, "baseline_mm": 12.0},
        "frames": {"count": 3},
        "objects": [
            {
                "name": "wall",
                "mesh": {"kind": "plane", "size_mm": [100, 80]},
                "pose": {"position_mm": [3, 1, 660], "rotations": [{"axis": [0, 1, 0], "angle_deg": 40}]},
                "texture": {"kind": "uniform"},
                "motion": [{"kind": "rotation", "axis": [0, 1, 1], "rate_deg_per_frame": 9}],
            },
            {
                "name": "bar",
                "mesh": {"kind": "plane", "size_mm": [8, 90]},
                "pose": {"position_mm": [0, 0, 600], "rotations": [{"axis": [0, 0, 1], "angle_deg": 17}]},
                "texture": {"kind": "uniform"},
                "motion": [{"kind": "velocity", "velocity_mm_per_frame": [5, 0, -1]}],
            },
            {
                "name": "cube",
                "mesh": {"kind": "box", "size_mm": [20, 20, 20]},
                "pose": {"position_mm": [12, -5, 620], "rotations": [{"axis": [1, 2, 3], "angle_deg": 50}]},
                "texture": {"kind": "uniform"},
                "motion": [{"kind": "rotation", "axis": [1, 0, 0.3], "rate_deg_per_frame": 25}],
            },
        ],
        "render": {"backend": "raycast"},
    }
    return Scene.from_dict(plain | changes)
