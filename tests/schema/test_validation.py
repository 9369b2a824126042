"""Attributes of the wrong type are named when a data set is checked, before anybody trips over them."""

from __future__ import annotations

import contextlib
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.schema import check_dataset, read_intrinsics, read_object_names, read_scene

RECORDING = st.make_recording(np.zeros((2, 3, 4, 5)), 100.0, 5.0, attrs={"scene": '{"description": "x"}', "seed": 3})


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("scene", "{", "attrs.scene: must be a mapping in JSON, but cannot be read"),
        ("scene", "[]", "attrs.scene: must be a mapping in JSON"),
        ("scene", {"a": 1}, "attrs.scene: must be a mapping in JSON"),
        ("scene", None, r"attrs.scene: must be a mapping in JSON \(got 'None'\)"),
        ("scene", "[" * 100_000, "attrs.scene: must be a mapping in JSON, but cannot be read: is nested too deeply"),
        ("scene", '{"a": ' + "[" * 60 + "]" * 60 + "}", "is nested more than"),
        ("scene", '{"estimate": 3}', r"attrs.scene.estimate: must be a mapping \(got 3\)"),
        ("scene", '{"description": []}', "attrs.scene.description: must be text"),
        ("scene", '{"seed": ' + "9" * 5000 + "}", "cannot be read"),
        ("settings", "3", "attrs.settings: must be a mapping"),
        ("versions", b"{}", "attrs.versions: must be a mapping"),
        ("object_names", '{"a": 1}', "attrs.object_names: must be a list of texts"),
        ("object_names", "[1]", "attrs.object_names: must be a list of texts"),
        ("scene_hash", 3, "attrs.scene_hash: must be text"),
        ("method", None, "attrs.method: must be text"),
        ("seed", "3", "attrs.seed: must be a non-negative integer"),
        ("seed", -1, "attrs.seed: must be a non-negative integer"),
        ("render_fallback_reason", 3, "attrs.render_fallback_reason: must be text"),
        ("distortion", "abc", "attrs.distortion: must be a list"),
        ("focal_length_px", "100", "attrs.focal_length_px: must be a finite number"),
        ("focal_length_px", [100.0], "attrs.focal_length_px: must be a finite number"),
        ("focal_length_px", 10**400, "attrs.focal_length_px: must be a finite number"),
        ("focal_length_px", True, "attrs.focal_length_px: must be a finite number"),
        ("principal_point_px", "ab", "attrs.principal_point_px: must be two finite numbers"),
        ("principal_point_px", np.array(1.0), "attrs.principal_point_px: must be two finite numbers"),
        ("principal_point_px", [[1, 2], [3, 4]], "attrs.principal_point_px: must be two finite numbers"),
        ("full_scale", "1", "attrs.full_scale: must be a positive number"),
    ],
)
def test_what_is_of_the_wrong_type_is_named(name: str, value: Any, message: str) -> None:
    with pytest.raises(st.RecordingError, match=message):
        check_dataset(RECORDING.assign_attrs({name: value}), "recording")


@pytest.mark.parametrize(
    ("name", "values"), [("t", ["a", "b", "c"]), ("s", [0.5, 1.5]), ("s", np.array(["2020", "2021"], "datetime64[ns]"))]
)
def test_coordinates_of_the_wrong_type_are_named(name: str, values: Any) -> None:
    with pytest.raises(st.RecordingError, match=f"- {name}: must hold integers"):
        check_dataset(RECORDING.assign_coords({name: (name, values)}), "recording")


def test_positions_that_are_no_numbers_are_named() -> None:
    with pytest.raises(st.RecordingError, match="stage_x_mm: must hold finite numbers"):
        check_dataset(RECORDING.assign_coords(stage_x_mm=("s", ["a", "b"])), "recording")


plain = some.recursive(
    some.none() | some.booleans() | some.integers() | some.floats() | some.text(max_size=3) | some.just("{}"),
    lambda inner: some.lists(inner, max_size=3) | some.dictionaries(some.text(max_size=3), inner, max_size=3),
    max_leaves=4,
)


@given(some.sampled_from([*RECORDING.attrs, "object_names", "settings", "method"]), plain, some.booleans())
def test_any_attribute_is_read_or_refused(name: str, value: Any, spelled: bool) -> None:
    changed = RECORDING.assign_attrs({name: json.dumps(value) if spelled else value})
    with contextlib.suppress(st.RecordingError):
        check_dataset(changed, "recording")
        assert read_intrinsics(changed).focal_length_px > 0
        assert isinstance(read_scene(changed), dict)
        assert isinstance(read_object_names(changed), list)
