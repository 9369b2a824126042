"""A wrong value hides no other problem, and what takes its place causes none."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.resources import Limits, load_checked_scene
from tests.helpers.nightly import by_night
from tests.helpers.scenes import SCENES, bright_scene

DELETED = "deleted"


def paths_in(value: Any, above: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield (*above, key)
        yield from paths_in(item, (*above, key))


def problems_of(plain: dict[str, Any]) -> list[st.Problem]:
    try:
        load_checked_scene(plain, limits=Limits())
    except st.SceneError as error:
        return list(error.problems)
    return []


@pytest.mark.parametrize("source", ["lamps", *by_night("cube", "rosette")])
@settings(max_examples=5, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(data=some.data())
def test_one_wrong_value_causes_no_problem_elsewhere(source: str, data: some.DataObject, tmp_path: Path) -> None:
    plain = bright_scene(tmp_path) if source == "lamps" else st.load_scene(SCENES / f"{source}.yaml").to_dict()
    where = data.draw(some.sampled_from(sorted(paths_in(plain), key=str)))
    # Without bands of the camera, all values by band are wrong.
    assume(where[0] != "camera" or len(where) == 3 or "bands" not in plain["camera"])
    owner: Any = plain
    for key in where[:-1]:
        owner = owner[key]
    wrong: Any = data.draw(some.sampled_from([DELETED, "x", -1e30, {}, None]))
    if wrong == DELETED and isinstance(owner, dict):
        del owner[where[-1]]
    else:
        owner[where[-1]] = wrong
    # Objects and plants, and stage and frames, are validated together.
    near = {str(where[0]), "plants", "frames"}
    for problem in problems_of(plain):
        assert problem.path.split(".")[0] in near, problem
        if len(where) > 2:
            assert problem.path.split(".")[: len(where) - 2] == [str(key) for key in where[: len(where) - 2]], problem


CHANGED: dict[str, tuple[dict[str, Any], list[str]]] = {
    "names twice, lamp in an object": (
        {"objects.1.name": "box", "lighting.lights.0.position_mm": [-60, 0, 420]},
        ["objects", "lighting.lights.0.position_mm"],
    ),
    "camera without bands": ({"camera.bands": ["Red"], "seed": -1}, ["camera.bands.0", "seed"]),
    "camera behind its own error": (
        {"camera.width": 0, "camera.focal_length_mm": 8.0, "shutter.exposure_time_s": 7.0},
        ["camera.width", "camera", "shutter.exposure_time_s"],
    ),
    "frames": (
        {"frames.count": 0, "lighting.lights.1.position_mm": [0, 0, 0]},
        ["frames.count", "lighting.lights.1.position_mm"],
    ),
    "lamp without distance in an object": (
        {"lighting.lights.1.position_mm": [-60, 0, 420], "lighting.lights.1.reference_distance_mm": "far"},
        ["lighting.lights.1.reference_distance_mm", "lighting.lights.1.position_mm"],
    ),
    "no objects": (
        {"objects": "none", "lighting.lights.1.position_mm": [0, 0, 0]},
        ["objects", "lighting.lights.1.position_mm"],
    ),
    "not a scene": ({"lighting": 3, "stage": 0, "objects.0.mesh": {}}, ["stage", "objects.0.mesh", "lighting"]),
    "texture and tint of one object": (
        {"objects.0.texture.radiance": 2.0, "objects.0.tint": {"red": 1.0}},
        ["objects.0.texture.radiance", "objects.0.tint"],
    ),
}


@pytest.mark.parametrize("name", CHANGED)
def test_values_hide_no_problem_that_does_not_depend_on_them(name: str, tmp_path: Path) -> None:
    changes, paths = CHANGED[name]
    with pytest.raises(st.SceneError) as caught:
        load_checked_scene(bright_scene(tmp_path), overrides=changes, limits=Limits())
    assert [problem.path for problem in caught.value.problems] == paths


def test_values_of_an_error_are_those_given(tmp_path: Path) -> None:
    """Not those that took the place of others."""
    camera = {"width": -1, "height": 48}
    with pytest.raises(st.SceneError, match=r"specify focal_length_px.*\(got {'width': -1, 'height': 48}\)"):
        load_checked_scene(bright_scene(tmp_path) | {"camera": camera})


def test_overrides_that_cannot_be_applied_hide_no_other_problem(tmp_path: Path) -> None:
    plain = bright_scene(tmp_path)
    plain["seed"] = -1
    plain["camera"]["width"] = 0
    with pytest.raises(st.SceneError) as caught:
        st.load_scene(plain, overrides=["objects.9.name=a", "camera.width=[1", "stage.positions=0"])
    paths = [problem.path for problem in caught.value.problems]
    # The second would have replaced the width.
    assert paths == ["--set objects.9.name", "--set camera.width", "stage.positions", "seed"]
