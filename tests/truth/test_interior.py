"""The warning of objects that are all edge."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scenetruth as st
from scenetruth.errors import SceneWarning
from scenetruth.scene.built_scene import build_scene
from scenetruth.truth import interior_warnings
from tests.scene.mesh.test_file import ball
from tests.scenes import cube


def thing(name: str, mesh: dict[str, Any], x_mm: float = 0.0, z_mm: float = 660.0) -> dict[str, Any]:
    texture = {"kind": "uniform", "radiance": 0.5}
    return {"name": name, "mesh": mesh, "pose": {"position_mm": [x_mm, 0, z_mm]}, "texture": texture}


def scene_of(*objects: dict[str, Any], margin_px: float) -> st.Scene:
    return cube(objects=list(objects), frames={"count": 1}, score={"interior_margin_px": margin_px})


WALL = thing("wall", {"kind": "plane", "size_mm": [200, 200]}, z_mm=700.0)


def test_the_warning_names_the_objects_and_the_remedy(tmp_path: Path) -> None:
    file = str(ball(tmp_path / "ball.obj", normals=False))
    facets = thing("facets", {"kind": "file", "file": file, "crease_deg": 1.0}, -20.0)
    with pytest.warns(SceneWarning, match=r"^objects: 'facets' without interior pixels: .* less than 8 px") as caught:
        st.simulate(scene_of(facets, WALL, margin_px=8))
    assert "many pixels of 'facets' are mixed: use a larger crease_deg" in str(caught[0].message)
    assert "'wall'" not in str(caught[0].message)
    # By its own edges the ball is smooth: 38 px to its limb. With a larger margin only distance helps.
    smooth = thing("ball", {"kind": "file", "file": file}, -20.0)
    st.simulate(scene_of(smooth, WALL, margin_px=8))
    with pytest.warns(SceneWarning, match="'ball' without interior pixels") as caught:
        st.simulate(scene_of(smooth, WALL, margin_px=45))
    assert "crease_deg" not in str(caught[0].message)


def test_pixels_at_the_margin_are_interior_and_objects_that_are_not_seen_are_not_named() -> None:
    world = build_scene(scene_of(thing("one", WALL["mesh"]), thing("two", WALL["mesh"]), WALL, margin_px=2))
    bodies = np.array([[0, 0, 0, 1, 1, 1, -1]])
    distance = np.array([[2.0, 1.0, 0.0, 0.0, 1.0, 1.9, 9.0]])
    (message,) = interior_warnings(world, bodies, distance, 2.0)
    assert message.startswith("objects: 'two' without")
    (message,) = interior_warnings(world, bodies, distance, 2.1)
    assert message.startswith("objects: 'one', 'two' without")
    assert interior_warnings(world, bodies, distance, 1.9) == []
