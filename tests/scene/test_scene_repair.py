"""A wrong value hides no other problem, and what takes its place causes none."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.resources import Limits, load_checked_scene
from tests.helpers.nightly import by_night, nightly
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
    # Without a band of the camera, all values by band are wrong.
    assume("bands" not in plain["camera"] or where[0] != "camera" or (len(where) == 3 and where[1] != "bands"))
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
    "picture of an object whose material has errors": (
        {
            "objects.0.texture": {"kind": "image", "file": "none.png"},
            "objects.0.material": {"reflectance": {"red": 0.5, "nir": 1.5}},
        },
        ["objects.0.material.reflectance.nir", "objects.0.texture.file"],
    ),
    "a texture of one band, and bands that the camera lacks": (
        {
            "objects.0.texture": {
                "kind": "by_band",
                "textures": {"red": {"kind": "uniform", "radiance": 2.0}, "blue": {"kind": "uniform"}},
            },
        },
        ["objects.0.texture.textures.red.radiance", *["objects.0.texture.textures"] * 2],
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


WRONG: dict[str, tuple[type | tuple[type, ...], Callable[[Any], Any]]] = {
    "type": (object, lambda value: "x" if isinstance(value, dict) else {"x": 1}),
    "negative": ((int, float), lambda value: -abs(value) - 1),
    "not a number": ((int, float), lambda _: float("nan")),
    "infinite": ((int, float), lambda _: float("inf")),
    "huge": ((int, float), lambda value: value * 10**15),
    "with unit": ((int, float), lambda value: f"{value} mm"),
    "decimal comma": ((int, float), lambda value: f"{value},5"),
    "too short": (list, lambda value: value[:-1]),
    "too long": (list, lambda value: value + value[-1:]),
    "equal items": (list, lambda value: value[:1] * len(value)),
    "in a list": ((int, float, str, dict), lambda value: [value]),
    "empty": (object, lambda _: None),
    "boolean": ((int, float, str), lambda _: True),
}


def corrupted(plain: dict[str, Any], where: tuple[str | int, ...], kind: str) -> bool:
    """Replace, remove or misspell a field; return whether the kind of mistake exists for it."""
    owner: Any = plain
    for key in where[:-1]:
        owner = owner[key]
    last = where[-1]
    if kind in (DELETED, "misspelt"):
        if not isinstance(owner, dict):
            return False
        value = owner.pop(last)
        if kind == "misspelt":
            owner[f"{last}x"] = value
        return True
    types, wrong = WRONG[kind]
    if not isinstance(owner[last], types):
        return False
    owner[last] = wrong(owner[last])
    return True


def part_of(where: tuple[str | int, ...]) -> str:
    """Return the part of a scene that is validated as a whole."""
    if where[0] in ("objects", "plants"):
        return ".".join(map(str, where[:2]))
    return "time" if where[0] in ("stage", "frames") else str(where[0])


@nightly
@pytest.mark.parametrize("source", sorted(SCENES.glob("*.yaml")), ids=lambda file: file.stem)
@settings(
    max_examples=30,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.filter_too_much],
    deadline=None,
)
@given(data=some.data())
def test_two_mistakes_have_the_problems_of_each(
    source: Path, data: some.DataObject, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Any mistakes in two parts of a bundled scene: no problem is hidden, and none is added."""
    monkeypatch.chdir(SCENES)
    whole = yaml.safe_load(source.read_text(encoding="utf-8"))
    draw = some.tuples(some.sampled_from(list(paths_in(whole))), some.sampled_from([DELETED, "misspelt", *WRONG]))
    one, two = data.draw(draw), data.draw(draw)
    assume(part_of(one[0]) != part_of(two[0]))
    # A whole list has parts.
    assume(one[0][0] != two[0][0] or min(len(one[0]), len(two[0])) > 1)
    found = []
    for mistakes in ([one], [two], [one, two]):
        plain = copy.deepcopy(whole)
        assume(all(corrupted(plain, *mistake) for mistake in mistakes))
        found.append({problem.path for problem in problems_of(plain)})
    first, second, both = found
    if first and second:
        assert both == first | second
