"""Deformations and motions that cannot be are refused, by the field that is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import scenetruth as st
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.motion import MOTION_PRESETS
from tests.helpers.moving_sheets import sheet
from tests.helpers.scenes import cube


@pytest.fixture
def leaf(tmp_path: Path) -> Path:
    """A leaf of 40 x 24 mm in a file, 12 x 8 cells."""
    start = sheet(12, 8)
    flat = np.concatenate([start.material_mm, np.zeros((len(start.material_mm), 1))], axis=1)
    trimesh.Trimesh(flat, start.faces, process=False).export(tmp_path / "leaf.ply")
    return tmp_path / "leaf.ply"


def scene(leaf: Path, frames: dict[str, Any] | None = None, **changes: Any) -> st.Scene:
    item = {
        "name": "leaf",
        "mesh": {"kind": "file", "file": str(leaf)},
        "texture": {"kind": "uniform"},
        "pose": {"position_mm": [0, 0, 660]},
        **changes,
    }
    plain = cube().to_dict() | {"objects": [item], "frames": frames or {"count": 9, "frame_interval_s": 3600}}
    return Scene.from_dict(plain)


ROLL = {"kind": "unrolling", "length_mm": 40, "radius_mm": 3, "tightening": 0.05}
GROWTH = {"kind": "growth", "rate_per_hour": 0.03}


@pytest.mark.parametrize(
    ("deformation", "path", "message"),
    [
        (
            # 4 h before t = 0 the front has not reached the sheet: everything and 24 mm more are rolled up.
            ROLL | {"front_mm": {"kind": "linear", "start": 10, "rate_per_frame": 12}},
            "front_mm",
            r"self-intersecting unrolling: the radius falls to zero within 60 mm, but 78 mm .*at t = -4",
        ),
        (ROLL | {"length_mm": 30, "front_mm": 10}, "length_mm", r"is less than the end of the mesh, 40 mm"),
        (GROWTH | {"rate_per_hour": 6}, "rate_per_hour", r"grows or shrinks by a factor of exp\(24\)"),
        (GROWTH | {"rate_per_hour": -6}, "rate_per_hour", r"grows or shrinks by a factor of exp\(24\)"),
        (GROWTH | {"base_to_tip": [1, 2], "tip_mm": -5}, "tip_mm", "base and tip coincide"),
        ({"kind": "star", "amplitude_mm": 3, "period_mm": [7, 9]}, "", r"inverts or collapses \d+ of 192 triangles"),
        (
            {"kind": "bending", "angle_deg": 500, "length_mm": 30},
            "angle_deg",
            r"bends the sheet by 500 degrees, which self-intersects",
        ),
    ],
)
def test_deformations_that_cannot_be(leaf: Path, deformation: dict[str, Any], path: str, message: str) -> None:
    with pytest.raises(st.SceneError, match=message) as caught:
        build_scene(scene(leaf, deformation=[{"kind": "hinge", "angle_deg": 0.0}, deformation]))
    (problem,) = caught.value.problems
    assert problem.path == "objects.0.deformation.1" + (f".{path}" if path else "")


def test_sheets_too_far_from_their_plane_cannot_be_bent_or_rolled(leaf: Path) -> None:
    """A hinge stands the sheet up by 21 mm, more than the radius of the bend, and than the room in the roll."""
    hinge = {"kind": "hinge", "axis": [1, 0, 0], "angle_deg": 60}
    bend = {"kind": "bending", "angle_deg": 350, "length_mm": 30}
    roll = ROLL | {"radius_mm": 12, "front_mm": 0}
    for deformation, message in (
        (bend, r"deformation\.1\.angle_deg: the radius of the bend, 4\.91"),
        (roll, r"deformation\.1\.radius_mm: self-intersecting unrolling: the sheet extends over 20\.78"),
    ):
        with pytest.raises(st.SceneError, match=message):
            build_scene(scene(leaf, deformation=[hinge, deformation]))


def test_growth_may_not_turn_triangles_inside_out(leaf: Path) -> None:
    """The edges of a strip grow apart from its middle, and turn round by 5.9 rad; two triangles cannot follow that."""
    steep = GROWTH | {"rate_per_hour": 1, "base_to_tip": [-4.9, 4.9]}
    build_scene(scene(leaf, deformation=[steep]))
    with pytest.raises(st.SceneError, match=r"deformation\.0: inverts or collapses \d of 2 triangles"):
        build_scene(scene(leaf, deformation=[steep], mesh={"kind": "plane", "size_mm": [40, 24]}))


def test_growth_may_not_outgrow_a_roll(leaf: Path) -> None:
    rolled = ROLL | {"front_mm": 20}
    with pytest.raises(st.SceneError, match=r"deformation\.1\.length_mm: is less than the end of the mesh, 40\.6"):
        build_scene(scene(leaf, deformation=[GROWTH, rolled]))
    build_scene(scene(leaf, deformation=[GROWTH, rolled | {"length_mm": 43}]))


def test_every_wrong_deformation_is_named_once(leaf: Path) -> None:
    """The second shows itself at times at which the first still holds."""
    wrong = [
        GROWTH | {"rate_per_hour": 0.1, "base_to_tip": [60, 60]},
        {"kind": "bending", "angle_deg": {"kind": "linear", "rate_per_frame": 200}, "length_mm": 30},
    ]
    with pytest.raises(st.SceneError) as caught:
        build_scene(scene(leaf, deformation=wrong))
    assert [problem.path for problem in caught.value.problems] == [
        "objects.0.deformation.0.rate_per_hour",
        "objects.0.deformation.1.angle_deg",
    ]


def test_sound_movements_pass(leaf: Path) -> None:
    build_scene(
        scene(
            leaf,
            deformation=[
                GROWTH | {"base_to_tip": [1.5, 0.5], "diel_amplitude": 0.8},
                ROLL | {"length_mm": 45, "front_mm": {"kind": "linear", "start": 20, "rate_per_frame": 3}},
                {"kind": "bending", "angle_deg": 40, "length_mm": 30, "from_mm": 2},
                {"kind": "star", "amplitude_mm": 0.05, "period_mm": [5, 20]},
            ],
        )
    )


@pytest.mark.parametrize("interval", [60.0, 30.0])
def test_presets_per_frame_ask_for_one_frame_a_minute(leaf: Path, interval: float) -> None:
    motion = [
        {"kind": "shift", "preset": "leaf_movement", "direction": [0, 0, 1]},
        {"kind": "turn", "preset": "leaf_tilt", "axis": [0, 1, 0]},
        {"kind": "turn", "axis": [0, 1, 0], "angle_deg": 3},
    ]
    made = scene(leaf, {"count": 3, "frame_interval_s": interval}, motion=motion)
    if interval == 60:
        build_scene(made)
        return
    with pytest.raises(
        st.SceneError, match=r"requires one frame per minute, but frames\.frame_interval_s is 30"
    ) as caught:
        build_scene(made)
    assert [problem.path for problem in caught.value.problems] == [
        "objects.0.motion.0.preset",
        "objects.0.motion.1.preset",
    ]


KEYS: dict[str, Any] = {"kind": "keyframes", "times_frames": [0, 1, 2], "positions_mm": [[0, 0, 0]] * 3}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"motion": [KEYS | {"times_frames": [0, 2, 1]}]},
            r"motion\.0\.times_frames: .*keyframe times must be increasing.*1 after 2",
        ),
        ({"motion": [KEYS | {"times_frames": [0]}]}, r"motion\.0\.times_frames: .*at least two keyframes"),
        (
            {"motion": [KEYS | {"positions_mm": [[0, 0, 0]] * 2}]},
            r"motion\.0\.positions_mm: .*one entry for each of times_frames: 2 for 3",
        ),
        (
            {"motion": [KEYS | {"rotations_deg": [[0, 0, 0]] * 4}]},
            r"motion\.0\.rotations_deg: .*one entry for each of times_frames: 4 for 3",
        ),
        (
            {"motion": [KEYS | {"positions_mm": None}]},
            r"motion\.0\.rotations_deg: .*require positions_mm, rotations_deg",
        ),
        ({"motion": [{"kind": "turn", "axis": [0, 0, 0], "angle_deg": 1}]}, r"motion\.0\.axis: .*zero vector"),
        ({"motion": [{"kind": "shift", "direction": [0, 0, 0], "distance_mm": 1}]}, r"direction: .*zero vector"),
        ({"motion": [{"kind": "shift", "preset": "leaf_tilt", "direction": [0, 0, 1]}]}, r"motion\.0\.preset"),
        ({"motion": [{"kind": "turn", "axis": [0, 0, 1]}]}, r"motion\.0\.angle_deg"),
        (
            {
                "motion": [
                    {
                        "kind": "nutation",
                        "direction": [0, 0, -1],
                        "towards": [0, 0, 3],
                        "amplitudes_deg": [1, 1],
                        "period_frames": 5,
                    }
                ]
            },
            r"motion\.0\.towards: .*must not be parallel to direction",
        ),
        (
            {"motion": [{"kind": "nutation", "direction": [0, 0, 0], "towards": [0, 1, 0]}]},
            r"motion\.0\.direction: .*zero vector",
        ),
        ({"deformation": [GROWTH | {"base_mm": 3, "tip_mm": 2}]}, r"deformation\.0\.tip_mm: .*larger than base_mm, 3"),
        ({"deformation": [GROWTH | {"along_share": 2.2}]}, r"deformation\.0\.along_share"),
        (
            {"deformation": [GROWTH | {"solid": True, "along_share": 0.5}]},
            r"deformation\.0\.solid: .*uniform and isotropic",
        ),
        ({"deformation": [{"kind": "growth"}]}, r"deformation\.0\.rate_per_hour"),
        ({"deformation": [{"kind": "growth", "preset": "weed"}]}, r"deformation\.0\.preset"),
        (
            {"deformation": [{"kind": "bending", "angle_deg": 3, "length_mm": 3, "from_mm": -1, "across": True}]},
            r"deformation\.0\.across: .*from_mm must not be negative",
        ),
        (
            {"deformation": [ROLL | {"front_mm": 10, "tightening": 0.2}]},
            r"deformation\.0\.tightening: .*self-intersecting unrolling: the radius falls to zero within 15 mm",
        ),
        (
            {"deformation": [ROLL | {"front_mm": {"kind": "keyframes", "times_frames": [3, 1], "values": [0, 1]}}]},
            r"deformation\.0\.front_mm.*keyframe times must be increasing",
        ),
        ({"deformation": [{"kind": "star", "amplitude_mm": 1, "period_mm": [0, 3]}]}, r"deformation\.0\.period_mm"),
    ],
)
def test_fields_that_are_wrong(leaf: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(st.SceneError, match=message):
        scene(leaf, **changes)


def test_presets_fill_in_what_is_not_given(leaf: Path) -> None:
    deformation = [
        {"kind": "growth", "preset": "leaf_growth_1_percent"},
        {"kind": "growth", "preset": "leaf_growth_3_percent", "base_to_tip": [1, 1]},
    ]
    made = scene(leaf, deformation=deformation, motion=[{"kind": "turn", "preset": "leaf_tilt", "axis": [0, 1, 0]}])
    slow, fast = (entry.model_dump() for entry in made.objects[0].deformation)
    assert (slow["rate_per_hour"], slow["base_to_tip"], slow["peak_h"]) == (0.01, (1.5, 0.5), 6)
    assert (fast["rate_per_hour"], fast["base_to_tip"], fast["diel_amplitude"]) == (0.03, (1, 1), 0.5)
    turned = made.objects[0].motion[0].model_dump()
    assert turned["angle_deg"] == {"kind": "linear", "start": 0, "rate_per_frame": 0.2}
    assert Scene.from_dict(made.to_dict()) == made


def test_every_figure_of_a_preset_has_a_source_and_the_page_tells_them() -> None:
    page = (Path(__file__).parents[2] / "docs" / "how_to" / "scenes" / "motions.md").read_text(encoding="utf-8")
    for name, preset in MOTION_PRESETS.items():
        assert preset.values.keys() == preset.sources.keys()
        assert all(preset.sources.values())
        assert f"`{name}`" in page
        assert preset.title in page
