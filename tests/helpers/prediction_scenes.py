"""Small scenes for predictions."""

from __future__ import annotations

from typing import Any

__all__ = ["wall"]


def wall(**changes: Any) -> dict[str, Any]:
    """Return a textured wall seen from in front, as plain values."""
    thing = {
        "name": "wall",
        "mesh": {"kind": "plane", "size_mm": [170, 140]},
        "pose": {"position_mm": [0, 0, 600]},
        "texture": {"kind": "noise", "wavelength_mm": [3.0, 9.0]},
        "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.02, 0.01, -0.1]}],
    }
    plain: dict[str, Any] = {
        "camera": {"width": 96, "height": 72, "focal_length_px": 1200},
        "stage": {"positions": 5, "baseline_mm": 2.0},
        "frames": {"count": 5},
        "objects": [thing],
        "render": {"backend": "raycast", "supersampling": 2},
        "sensor": {"noise_std": 0.01, "bit_depth": None},
        "estimate": {"method": "refined"},
        "score": {"interior_margin_px": 10},
        "seed": 3,
    }
    own = {name: changes.pop(name) for name in ("mesh", "texture", "motion", "deformation", "pose") if name in changes}
    return plain | {"objects": [thing | own]} | changes
