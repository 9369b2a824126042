"""The capture file: what it accepts, and every problem with its path."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from scenetruth.capture import CAPTURE_FILE, Capture, load_capture
from scenetruth.errors import CaptureError
from tests.helpers.nightly import nightly

EXAMPLE = Path(__file__).parents[2] / "docs" / "reference" / "examples" / "capture.yaml"
PLAIN: dict[str, Any] = {
    "camera": {"width": 64, "height": 48, "bit_depth": 12, "focal_length_px": 500},
    "stage": {"positions": 5, "baseline_mm": 5},
    "frames": {"count": 9},
    "files": {"images": "s{s:+d}_t{t:+d}.tif"},
}


def changed(**paths: Any) -> dict[str, Any]:
    """Return the plain values with fields changed, by path with double underscores; None removes."""
    plain = copy.deepcopy(PLAIN)
    for path, value in paths.items():
        *keys, last = path.split("__")
        place = plain
        for key in keys:
            place = place.setdefault(key, {})
        if value is None:
            place.pop(last)
        else:
            place[last] = value
    return plain


def problems_of(plain: dict[str, Any]) -> dict[str, str]:
    with pytest.raises(CaptureError) as caught:
        Capture.from_dict(plain)
    return {problem.path: problem.message for problem in caught.value.problems}


def test_example_of_the_reference_survives_a_round_trip() -> None:
    plain = yaml.safe_load(EXAMPLE.read_text(encoding="utf-8"))
    capture = Capture.from_dict(plain)
    assert Capture.from_dict(capture.to_dict()) == capture
    json.dumps(Capture.model_json_schema())


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"camera__hight": 3}, {"camera.hight": "did you mean 'height'"}),
        ({"fils": 3}, {"fils": "did you mean 'files'"}),
        ({"stage__errors": {"yaw": 3}}, {"stage.errors.yaw": "did you mean 'yaw_urad'"}),
        ({"camera__bit_depth": 7}, {"camera.bit_depth": "greater than or equal to 8"}),
        ({"camera__black_level_dn": 4095}, {"camera": "must be below full scale, 4095"}),
        ({"camera__focal_length_mm": 5}, {"camera": "specify either focal_length_px"}),
        ({"camera__plane": "red"}, {"camera": "set `bayer`"}),
        ({"camera__distortion": {"k1": -900.0}}, {"camera": "not invertible"}),
        ({"stage__baseline_mm": None}, {"stage.baseline_mm": "is missing"}),
        ({"stage__positions_mm": [1, 2, 4], "stage__positions": None}, {"stage.positions_mm": "must be 0"}),
        ({"files__images": "s{s}.tif"}, {"files": "lacks {t} for 9"}),
        ({"files__images": "{s}{t}.tif"}, {"files.images": "without a character between"}),
        ({"files__dark": "dark/{pose}.tif"}, {"files.dark": "unknown field {pose}"}),
        ({"files__board": "b{s}.tif"}, {"files.board": "lacks the field {pose}"}),
        ({"frames__times": "name"}, {"files": "lacks {time:FORMAT}"}),
        ({"frames__times": "file"}, {"frames": "`times_file` belongs to"}),
        ({"board": {"kind": "dots", "dots": [9, 7], "spacing_mm": 5, "diameter_mm": 2}}, {"": "give both or neither"}),
        ({"files__board": "b{pose}.tif"}, {"": "give both or neither"}),
        (
            {"files__board": "b{pose}.tif", "board": {"kind": "charuco", "squares": [12, 9], "spacing_mm": 2}},
            {"board": "lacks square_mm, marker_mm, dictionary and must not have spacing_mm"},
        ),
        (
            {"camera__width": -1, "frames__count": 0, "files__images": "{q}"},
            {"camera.width": "greater", "frames.count": "greater", "files.images": "unknown field"},
        ),
    ],
)
def test_each_problem_has_its_path_and_remedy(changes: dict[str, Any], expected: dict[str, str]) -> None:
    found = problems_of(changed(**changes))
    assert set(found) == set(expected)
    for path, text in expected.items():
        assert text in found[path]


def test_empty_fields_are_to_be_filled_in() -> None:
    plain = changed()
    plain["stage"]["baseline_mm"] = None
    assert "fill it in" in problems_of(plain)["stage.baseline_mm"]


def test_file_is_loaded_from_its_folder_with_overrides(tmp_path: Path) -> None:
    file = tmp_path / CAPTURE_FILE
    file.write_text(yaml.safe_dump(changed(files__mask="mask.png")), encoding="utf-8")
    for place in (tmp_path, file, str(file)):
        capture = load_capture(place)
        assert capture.folder == tmp_path
        assert capture.files.mask == str(tmp_path / "mask.png")
    assert load_capture(tmp_path, overrides=["camera.bit_depth=10"]).camera.bit_depth == 10
    again = load_capture(load_capture(tmp_path), overrides={"frames.count": 3})
    assert again.frames.count == 3
    assert again.folder == tmp_path


def test_problems_of_a_file_name_it(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="scenetruth capture init"):
        load_capture(tmp_path)
    (tmp_path / CAPTURE_FILE).write_text("camera: [", encoding="utf-8")
    with pytest.raises(CaptureError, match="line 2, column 1: is not valid YAML"):
        load_capture(tmp_path)
    (tmp_path / CAPTURE_FILE).write_text("3", encoding="utf-8")
    with pytest.raises(CaptureError, match="must be a mapping"):
        load_capture(tmp_path)
    with pytest.raises(CaptureError, match="no such file"):
        load_capture(tmp_path / "none.yaml")


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=6),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=5,
)


def paths_in(plain: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = plain.items() if isinstance(plain, dict) else enumerate(plain) if isinstance(plain, list) else ()
    found = [path]
    for key, value in items:
        found += paths_in(value, (*path, key))
    return found


WHOLE = yaml.safe_load(EXAMPLE.read_text(encoding="utf-8"))
# Problems of a whole section; stated errors of the stage are compared with its steps.
ELSEWHERE = ("", "files", "board", "stage.errors")


@nightly
@settings(max_examples=300, deadline=None)
@given(st.sampled_from(paths_in(WHOLE)[1:]), VALUES)
def test_any_value_anywhere_is_accepted_or_a_problem_with_a_path(path: tuple[Any, ...], value: Any) -> None:
    plain = copy.deepcopy(WHOLE)
    place = plain
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    try:
        capture = Capture.from_dict(plain)
    except CaptureError as error:
        found = error
    else:
        assert Capture.from_dict(capture.to_dict()) == capture
        return
    # The problem lies at the value or in the section that it belongs to.
    for problem in found.problems:
        keys = problem.path.split(".") if problem.path else []
        common = [str(key) for key in path][: len(keys)]
        assert keys[: len(common)] == common or keys == [str(path[0])] or problem.path in ELSEWHERE
