"""A scene with an animated mesh."""

from __future__ import annotations

from typing import Any

import scenetruth as st
from tests.helpers.scenes import cube

__all__ = ["scene_with"]


def scene_with(mesh: dict[str, Any], *deformations: dict[str, Any], frames: int = 9, **changes: Any) -> st.Scene:
    item = {
        "name": "thing",
        "mesh": mesh,
        "texture": {"kind": "uniform"},
        "pose": {"position_mm": [0, 0, 660]},
        "deformation": list(deformations),
    }
    return cube(objects=[item], frames={"count": frames, "frame_interval_s": 0.5}, **changes)
