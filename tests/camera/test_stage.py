"""The stage: any list of positions, rows of a grid, order of a scan, presets of errors; and what it refuses."""

from __future__ import annotations

from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.camera import Frames, Stage, StageErrors
from scenetruth.camera.stage import STAGE_PRESETS
from tests.helpers.scenes import SCENES, cube

LISTED = {"positions_mm": [-10, -4, 0, 5, 12]}


def stage(**plain: Any) -> Stage:
    return Stage.model_validate(plain)


def test_positions_come_as_a_list_too() -> None:
    listed = stage(**LISTED)
    assert listed.s.tolist() == [-2, -1, 0, 1, 2]
    assert listed.x_mm.tolist() == [-10, -4, 0, 5, 12]
    assert (listed.positions, listed.baseline_mm) == (5, 5.5)
    assert stage(**LISTED, baseline_mm=5).baseline_mm == 5
    assert stage(positions_mm=[3, 0, -4, -9]).baseline_mm == -4
    assert stage(positions_mm=[0], baseline_mm=2).x_mm.tolist() == [0]
    assert stage(positions_mm=[-5, 0, 5]).x_mm.tolist() == stage(positions=3, baseline_mm=5).x_mm.tolist()


@pytest.mark.parametrize("plain", [LISTED, {**LISTED, "errors": {"preset": "screw_stage", "yaw_urad": 3}}])
def test_a_list_survives_a_round_trip(plain: dict[str, Any]) -> None:
    scene = cube(stage=plain)
    assert st.Scene.from_dict(scene.to_dict()) == scene


def test_the_schema_knows_both_spellings() -> None:
    schema = Stage.model_json_schema()
    assert "required" not in schema
    assert [entry["required"] for entry in schema["anyOf"]] == [["positions", "baseline_mm"], ["positions_mm"]]


def test_rows_of_a_grid() -> None:
    grid = stage(positions=3, baseline_mm=5, rows=4, row_spacing_mm=2)
    assert grid.s_y.tolist() == [-1, 0, 1, 2]
    assert grid.y_mm.tolist() == [-2, 0, 2, 4]
    assert stage(positions=3, baseline_mm=5).y_mm.tolist() == [0]


def test_order_of_a_scan() -> None:
    grid = {"positions": 3, "baseline_mm": 5, "rows": 2, "row_spacing_mm": 2}
    there = [(0, -1), (0, 0), (0, 1), (1, -1), (1, 0), (1, 1)]
    serpentine = [(0, -1), (0, 0), (0, 1), (1, 1), (1, 0), (1, -1)]
    for t in (-2, -1, 0, 1):
        for scan, order in (("unidirectional", there), ("bidirectional", serpentine[:: 1 if t % 2 == 0 else -1])):
            item = stage(**grid, scan=scan)
            assert [item.number_in_scan(s, t, s_y) for s_y, s in order] == [0, 1, 2, 3, 4, 5]


@given(
    positions=some.integers(1, 6),
    rows=some.integers(1, 3),
    scan=some.sampled_from(["unidirectional", "bidirectional"]),
)
def test_scans_at_the_shortest_interval_follow_each_other(positions: int, rows: int, scan: str) -> None:
    item = stage(positions=positions, baseline_mm=1, rows=rows, row_spacing_mm=1, scan=scan, time_per_position_s=0.25)
    places = list(product(item.s_y.tolist(), item.s.tolist()))
    times = []
    for t in range(-2, 3):
        after = [item.number_in_scan(s, t, s_y) - item.number_in_scan(0, t) for s_y, s in places]
        times.append(t * item.scan_interval_s + 0.25 * np.array(after))
    gaps = np.array([later.min() - former.max() for former, later in pairwise(times)])
    # Quarters are exact in binary; the shortest gap is the time of one position.
    assert gaps.min() == 0.25


def test_presets_lie_in_the_range_of_their_kind() -> None:
    for name, (lengths, angles) in {
        "screw_stage": ((1, 10), (50, 200)),
        "air_bearing": ((0, 0.1), (2.5, 2.5)),
    }.items():
        for key, value in STAGE_PRESETS[name].items():
            low, high = lengths if key.endswith("_um") else angles
            assert low <= value <= high, (name, key)


def test_a_field_overrides_the_preset() -> None:
    errors = StageErrors.model_validate({"preset": "screw_stage", "backlash_um": 0, "yaw_urad": 7})
    assert (errors.backlash_um, errors.yaw_urad) == (0, 7)
    assert errors.pitch_urad == STAGE_PRESETS["screw_stage"]["pitch_urad"]
    assert StageErrors() == StageErrors.model_validate({})
    assert not any(value for value in StageErrors().model_dump().values())


NO_NUMBER = ["stage.positions=null", "stage.baseline_mm=null"]


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["stage.positions_mm=[-5, 0, 0, 5]"], r"stage\.positions_mm: positions coincide: list each position once"),
        (["stage.positions_mm=[-5, 0, -5]"], r"stage\.positions_mm: positions coincide"),
        (["stage.positions_mm=[-5, 0, 7, 5, 9]"], r"stage\.positions_mm: must increase or decrease"),
        (
            ["stage.positions_mm=[-4, 1, 6]"],
            r"stage\.positions_mm: the reference is the middle position, index 1, .* subtract 1 from all",
        ),
        (["stage.positions_mm=[]"], r"stage\.positions_mm: .*at least 1 item"),
        (["stage.positions_mm=5"], r"stage\.positions_mm: must be a list; .* \(got 5\)"),
        (["stage.positions_mm=[-5, zero, 5]"], r"stage\.positions_mm\.1: .*valid number.* \(got 'zero'\)"),
        (["stage.positions_mm=[-.inf, 0, 5]"], r"stage\.positions_mm\.0: .*finite"),
        (
            ["stage.positions=5", "stage.positions_mm=[-5, 0, 5]"],
            r"stage\.positions_mm: has 3 positions, but 'positions' is 5: omit 'positions'",
        ),
        (
            ["stage.baseline_mm=5", "stage.positions_mm=[5, 0, -5]"],
            r"stage\.positions_mm: contradicts the sign of baseline_mm",
        ),
        (["stage.positions_mm=[0]"], r"stage\.baseline_mm: is missing"),
        (["stage.rows=3"], r"stage\.row_spacing_mm: is required with more than one row"),
        (["stage.rows=3", "stage.row_spacing_mm=0"], r"stage\.row_spacing_mm: must not be zero"),
        (["stage.scan=random"], r"stage\.scan: .*'unidirectional' or 'bidirectional'"),
        (["stage.time_per_position_s=-1"], r"stage\.time_per_position_s: .*greater than or equal to 0"),
        (
            ["stage.time_per_position_s=0.21"],
            r"frames: the stage needs 1\.05 s per frame, more than frame_interval_s = 1 s: increase it",
        ),
        (["stage.errors.preset=screw"], r"stage\.errors\.preset: .*'screw_stage' or 'air_bearing'"),
        (["stage.errors.yaw_urad=100001"], r"stage\.errors\.yaw_urad: must be at most 100000 µrad"),
        (["stage.errors.pitch_urad=-1"], r"stage\.errors\.pitch_urad: .*greater than or equal to 0"),
        (["stage.errors.straightness=1"], r"stage\.errors\.straightness: unknown key; did you mean 'straightness_um'"),
        (["stage.poses=[{}, {}]"], r"stage\.poses: must be one pose per position: 2 poses are listed for 5 positions"),
        (["stage.poses=[]"], r"stage\.poses: must be one pose per position: 0 poses"),
        (["stage.poses=[{x_um: 20000}, {}, {}, {}, {}]"], r"stage\.poses\.0\.x_um: must be at most 10000 µm"),
        (["stage.poses=[{}, {}, {}, {}, {roll_urad: -2.0e5}]"], r"stage\.poses\.4\.roll_urad: must be at most 1"),
        (["stage.poses=[{}, {x_um: 5000.1}, {}, {}, {}]"], r"stage\.poses: x_um of poses 1 and 2 change the order"),
        (["stage.poses=[{visits: [{}]}, {}, {}, {}, {}]"], r"frames: .* must be 9: stage\.poses\.0\.visits \(1\)"),
        (["stage.poses=[{yaw: 3}, {}, {}, {}, {}]"], r"stage\.poses\.0\.yaw: unknown key; did you mean 'yaw_urad'"),
        (["stage.axis_tilt_urad=[0, 2.0e5]"], r"stage\.axis_tilt_urad: must be at most 100000 µrad"),
        (["stage.errors.repeatability_um=1000"], r"stage\.errors: .* 4 mm, more than half the smallest step of 5 mm"),
    ],
)
def test_what_no_stage_can_do_is_named(overrides: list[str], message: str) -> None:
    listed = any("positions_mm" in text for text in overrides)
    with pytest.raises(st.SceneError, match=message) as caught:
        st.load_scene(SCENES / "cube.yaml", overrides=[*(NO_NUMBER if listed else []), *overrides])
    assert len(caught.value.problems) == 1


def test_all_problems_of_listed_poses_are_named_together() -> None:
    poses = [{"x_um": 2e4, "visits": [{"yaw_urad": 3e5}]}, {"pitch_urad": 1e6}, {}, {}, {}]
    with pytest.raises(st.SceneError) as caught:
        cube(stage={"positions": 5, "baseline_mm": 5, "poses": poses})
    assert [problem.path for problem in caught.value.problems] == [
        "stage.poses.0.x_um",
        "stage.poses.0.visits.0.yaw_urad",
        "stage.poses.1.pitch_urad",
    ]


def test_listed_poses_survive_a_round_trip_and_leave_no_trace_where_absent() -> None:
    poses = [{"x_um": 1.5}, {"visits": [{"pitch_urad": 3}] * 9}, {"roll_urad": -7}]
    scene = cube(stage={"positions": 3, "baseline_mm": 5, "poses": poses, "axis_tilt_urad": [300, -200]})
    assert st.Scene.from_dict(scene.to_dict()) == scene
    assert not {"poses", "axis_tilt_urad"} & cube().to_dict()["stage"].keys()


def test_tolerances_of_listed_poses_are_their_rms_values() -> None:
    poses = [{"x_um": 3, "z_um": 2, "yaw_urad": 30, "visits": [{"x_um": 1}, {"x_um": -1}]}, {"pitch_urad": 40}, {}]
    listed = {"positions": 3, "baseline_mm": 5, "poses": poses, "axis_tilt_urad": [400, 0]}
    # z is 2 at one of three positions; y is 5 mm of 400 µrad at two; both count for straightness.
    assert stage(**listed).stated_tolerances() == pytest.approx({
        "accuracy_um": np.sqrt(9 / 3),
        "straightness_um": np.sqrt((2**2 + 2 * 2**2) / 6),
        "repeatability_um": 1.0,
        "pitch_urad": 40 / np.sqrt(3),
        "yaw_urad": 30 / np.sqrt(3),
    })  # fmt: skip
    assert stage(**listed, errors={"yaw_urad": 5}).stated_tolerances() == {"yaw_urad": 5}
    assert stage(positions=3, baseline_mm=5).stated_tolerances() == {}


def test_a_scan_may_take_all_the_time_there_is() -> None:
    scene = st.load_scene(SCENES / "cube.yaml", overrides=["stage.time_per_position_s=0.2", "stage.scan=bidirectional"])
    assert scene.stage.scan_interval_s == scene.frames.frame_interval_s
    slow = ["stage.time_per_position_s=9", "frames.count=1"]
    assert st.load_scene(SCENES / "cube.yaml", overrides=slow).stage.time_per_position_s == 9


@pytest.mark.parametrize(("count", "expected"), [(1, [0]), (2, [0, 1]), (5, [-2, -1, 0, 1, 2])])
def test_stage_and_frames_count_from_the_reference(count: int, expected: list[int]) -> None:
    assert Frames(count=count).t.tolist() == expected
    assert Stage(positions=count, baseline_mm=2.5).x_mm.tolist() == [2.5 * value for value in expected]
