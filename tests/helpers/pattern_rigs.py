"""A rig for tests of patterns: pixels of 0.2 mm, ten px of disparity."""

from __future__ import annotations

from typing import Any

from scenetruth.design.patterns import PatternRig

__all__ = ["FOCAL_PX", "Z_MM", "plain_rig"]

FOCAL_PX, Z_MM = 2000.0, 400.0


def plain_rig(**changes: Any) -> PatternRig:
    """Return a rig with a sensor whose noise is 1 % of full scale, without rounding."""
    values: dict[str, Any] = {
        "focal_length_px": FOCAL_PX,
        "distance_mm": Z_MM,
        "baseline_mm": 2.0,
        "positions": 3,
        "frames": 3,
        "sensor": {"noise_std": 0.01, "bit_depth": None},
    }
    return PatternRig.from_scene(**{**values, **changes})
