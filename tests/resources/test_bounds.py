"""Bounds of scenes: what passes them is told of at once, before anything is made, and can be allowed."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as some
from PIL import Image

import scenetruth as st
from scenetruth.resources.enforcement import refuse_beyond_limits
from scenetruth.resources.limits import Limits, limits_from
from tests.scenes import cube

CUBE = cube(frames={"count": 3}).to_dict()


def scene(**sections: Any) -> st.Scene:
    return st.Scene.from_dict({**CUBE, **sections})


def item(**fields: Any) -> dict[str, Any]:
    return {**CUBE["objects"][0], "texture": {"kind": "uniform"}, **fields}


ROSETTE = {"kind": "rosette", "position_mm": [0, 0, 600], "leaves": 40, "leaf": {"kind": "leaf"}}
BEYOND: dict[str, tuple[st.Scene, str, str]] = {
    "frames": (scene(frames={"count": 10_001}), "frames.count", "10,001"),
    "images": (scene(stage={"positions": 999, "baseline_mm": 5}, frames={"count": 101}), "stage", "100,899"),
    "pixels": (scene(camera={"width": 10_000, "height": 8_000, "focal_length_px": 9e4}), "camera", "80,000,000"),
    "samples": (
        scene(shutter={"exposure_time_s": 0.5, "samples": 300}, render={"supersampling": 4}),
        "render.supersampling",
        "4,800",
    ),
    "vertices": (
        scene(objects=[item(mesh={"kind": "plane", "size_mm": [90, 90], "resolution_mm": 0.06})]),
        "objects.0.mesh",
        "2,253,001",
    ),
    "objects": (scene(objects=[item(name=f"cube-{number}") for number in range(401)]), "objects", "401"),
    "leaves": (scene(plants=[{**ROSETTE, "name": f"plant-{n}"} for n in range(3)]), "plants", "120"),
    "texels": (
        scene(
            objects=[
                item(
                    mesh={"kind": "leaf", "length_mm": 80},
                    texture={"kind": "leaf", "texels_per_mm": 79, "mottling_wavelength_mm": [0.8, 5]},
                )
            ]
        ),
        "objects.0.texture",
        "",
    ),
}


@pytest.mark.parametrize("name", BEYOND)
def test_every_bound_is_told_with_its_place_and_can_be_allowed_as_it_says(name: str) -> None:
    beyond, path, value = BEYOND[name]
    limits = Limits(texels=3e7) if name == "texels" else Limits()
    started = time.process_time()
    with pytest.raises(st.SceneError) as caught:
        refuse_beyond_limits(beyond, limits)
    assert time.process_time() - started < 1
    (problem,) = caught.value.problems
    assert problem.path == path
    assert value in problem.message
    words = re.search(rf"--limit ({name}=\d+)$", problem.message)
    assert words is not None
    refuse_beyond_limits(beyond, limits_from([words[1]]))


def test_all_bounds_are_told_at_once_and_the_calls_keep_them() -> None:
    much = scene(camera={"width": 10_000, "height": 8_000, "focal_length_px": 9e4}, frames={"count": 20_000})
    for call in (st.simulate, st.make_truth):
        with pytest.raises(st.SceneError, match=r"frames\.count: results in 20,000 frames") as caught:
            call(much)
        assert [problem.path for problem in caught.value.problems] == ["frames.count", "camera"]


def test_a_large_picture_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    Image.new("1", (12_000, 12_000)).save(tmp_path / "large.png")
    plane = {"kind": "plane", "size_mm": [90, 90]}
    large = scene(objects=[item(mesh=plane, texture={"kind": "image", "file": str(tmp_path / "large.png")})])
    started = time.process_time()
    with pytest.raises(st.SceneError, match=r"objects\.0\.texture\.file: results in 144,000,000 pixels, more than 64"):
        st.simulate(large)
    assert time.process_time() - started < 1
    refuse_beyond_limits(large, Limits(image_pixels=2e8))


def test_what_is_wrong_with_textures_is_told_beside_bounds(tmp_path: Path) -> None:
    missing = item(name="other", texture={"kind": "image", "file": str(tmp_path / "none.png")})
    fine = item(mesh={"kind": "plane", "size_mm": [90, 90], "resolution_mm": 0.06})
    with pytest.raises(st.SceneError) as caught:
        refuse_beyond_limits(scene(objects=[fine, missing]))
    assert [problem.path for problem in caught.value.problems] == ["objects.1.texture.file", "objects.0.mesh"]


@given(some.dictionaries(some.sampled_from(["frames", "texels", "memory_gb", "hours"]), some.integers(1, 10**9)))
def test_limits_are_those_of_the_words(changes: dict[str, int]) -> None:
    found = limits_from(f"{name}={value}" for name, value in changes.items())
    assert found == Limits(**{name: float(value) for name, value in changes.items()})


def test_words_that_are_no_limits_are_told_all_at_once() -> None:
    with pytest.raises(st.SceneError) as caught:
        limits_from(["frame=3", "frames", "frames=", "texels=-1", "pixels=nan", "hours=0", "images=1e999", "images=3"])
    assert len(caught.value.problems) == 7
    assert "the names are frames, images" in str(caught.value)
