"""Leaves of plants: how they grow."""

from __future__ import annotations

from typing import Any

import pytest

from scenetruth.scene import Scene
from scenetruth.scene.deformation import Growth

PLANT: dict[str, Any] = {"kind": "seedling", "name": "plant", "position_mm": [0, 0, 400]}


def shares(growth: dict[str, Any], **changes: Any) -> set[float | None]:
    """Return the shares of growth along the midrib of all leaves."""
    plant = {**PLANT, "growth": {"kind": "growth", "rate_per_hour": 0.01, **growth}, **changes}
    rig = {"camera": {"width": 64, "height": 48, "focal_length_px": 900}, "stage": {"positions": 3, "baseline_mm": 2}}
    scene = Scene.from_dict({**rig, "frames": {"count": 3}, "plants": [plant]})
    return {entry.along_share for _, item in scene.parts for entry in item.deformation if isinstance(entry, Growth)}


@pytest.mark.parametrize(
    ("growth", "changes", "share"),
    [
        ({}, {}, 0.6),
        ({"along_share": 0.8}, {}, 0.8),
        ({}, {"along_share": None}, None),
        ({"solid": True}, {}, None),
    ],
)
def test_leaves_grow_along_their_midrib_more_than_across(
    growth: dict[str, Any], changes: dict[str, Any], share: float | None
) -> None:
    """Unless growth or plant define it; solids grow alike in all directions."""
    assert shares(growth, **changes) == {share}
