"""The reference scene from which the cases are derived."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

__all__ = ["DISTANCE_MM", "apply_changes", "build_reference_scene", "build_wall"]

FOCAL_PX = 720.0
DISTANCE_MM = 720.0
"""Equal in mm to the focal length in px: in the image centre 1 px corresponds to 1 mm."""
_MARGIN_MM = 40.0
_TEXTURE = {"kind": "noise", "wavelength_mm": [4, 20], "rms_contrast": 0.15}


def build_wall(
    name: str = "sheet",
    *,
    distance_mm: float = DISTANCE_MM,
    velocity: tuple[float, float, float] = (0.3, -0.2, 0.1),
    size_mm: tuple[float, float] = (144 + 2 * _MARGIN_MM, 108 + 2 * _MARGIN_MM),
    centre_mm: tuple[float, float] = (0.0, 0.0),
) -> dict[str, Any]:
    """Return a textured plane perpendicular to the optical axis; ``velocity`` is (U_X, U_Y, U_Z) in mm/frame."""
    return {
        "name": name,
        "mesh": {"kind": "plane", "size_mm": list(size_mm)},
        "pose": {"position_mm": [*centre_mm, distance_mm]},
        "texture": copy.deepcopy(_TEXTURE),
        "motion": [{"kind": "velocity", "velocity_mm_per_frame": list(velocity)}],
    }


def build_reference_scene(
    changes: Mapping[str, Any] | None = None, *, baseline_mm: float = 4.3, seed: int = 1
) -> dict[str, Any]:
    """Return the reference scene of all cases: five positions, five frames, an ideal sensor.

    ``baseline_mm``: Distance of neighbouring positions, numerically equal to the disparity in px/step.
    """
    scene = {
        "camera": {"width": 144, "height": 108, "focal_length_px": FOCAL_PX},
        "stage": {"positions": 5, "baseline_mm": baseline_mm},
        "frames": {"count": 5, "frame_interval_s": 60.0},
        "objects": [build_wall()],
        "sensor": "ideal",
        # Requires no system library, and is reproducible byte for byte on every machine.
        "render": {"backend": "raycast"},
        "seed": seed,
    }
    return apply_changes(scene, changes or {})


def apply_changes(scene: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a scene with other values at the given paths; missing fields are added."""
    found: dict[str, Any] = copy.deepcopy(dict(scene))
    for path, value in changes.items():
        *above, last = path.split(".")
        place: Any = found
        for key in above:
            place = place[int(key)] if isinstance(place, list) else place.setdefault(key, {})
        place[int(last) if isinstance(place, list) else last] = copy.deepcopy(value)
    return found
