"""Light in scene files: what is refused, where lamps are, and whether they stand inside objects."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import scenetruth as st
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.lighting import Lighting
from scenetruth.scene.scene_report import check_scene, describe_scene, find_lighting_problems
from tests.helpers.mesh_files import gltf
from tests.helpers.scenes import SCENES, cube

CENTRE = (0.0, 0.0, 692.56)
POINT = {"kind": "point", "position_mm": [0, -80, 400], "irradiance": 1, "reference_distance_mm": 300}
SPOT = {**POINT, "kind": "spot", "target_mm": [0, 0, 660], "inner_angle_deg": 3, "outer_angle_deg": 7}
SUN = {"kind": "directional", "direction": [0, 0, 2], "irradiance": 1}


def lit(*lights: dict[str, Any], **lighting: Any) -> st.Scene:
    return cube(lighting={"lights": list(lights), **lighting})


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "lights.0.inner_angle_deg=8",
            r"lights\.0\.outer_angle_deg: must not be less than inner_angle_deg, 8 \(got 7\)",
        ),
        ("lights.0.irradiance=-1", r"lights\.0\.irradiance: .*greater than or equal to 0 \(got -1\)"),
        ("lights.0.reference_distance_mm=0", r"lights\.0\.reference_distance_mm: .*greater than 0"),
        ("lights.0.direction=[0, 0, 1]", r"lights\.0: specify either direction or target_mm"),
        ("lights.0.target_mm=null", r"lights\.0: specify either direction or target_mm"),
        ("lights.0.target_mm=[0, -80, 400]", r"lights\.0: target_mm must differ from position_mm"),
        ("lights.0.outer_angle_deg=181", r"lights\.0\.outer_angle_deg: .*less than or equal to 180"),
        ("lights.0.colour=red", r"lights\.0\.colour: unknown key"),
        ("lights.0.kind=laser", r"lights\.0: .*'laser'.*'directional', 'disc', 'ies', 'point'"),
        (
            "lights.0={kind: directional, direction: [0, 0, 0], irradiance: 1}",
            r"direction: must not be the zero vector",
        ),
        ("lights.0.motion.0.axis=[0, 0, 0]", r"lights\.0\.motion\.0\.axis: must not be the zero vector"),
        ("ambient=-0.1", r"lighting\.ambient: .*greater than or equal to 0"),
        ("flicker.amplitude=1", r"lighting\.flicker\.amplitude: .*less than 1"),
        ("drift_per_frame=.inf", r"lighting\.drift_per_frame: .*finite"),
    ],
)
def test_what_is_wrong_is_named(override: str, message: str) -> None:
    overrides = [f"lighting.{override}", *(["lighting.flicker.period_frames=3"] if "flicker" in override else [])]
    with pytest.raises(st.SceneError, match=message):
        st.load_scene(SCENES / "cube_spotlight.yaml", overrides=overrides)


def test_a_scene_without_lighting_is_unlit() -> None:
    assert not cube().lighting.lit
    assert not lit(drift_per_frame=0.1).lighting.lit
    assert lit(ambient=0).lighting.lit
    assert lit(SUN).lighting.lit


def test_brightness() -> None:
    assert Lighting().brightness(7.3) == 1.0
    changing = Lighting.model_validate(
        {"drift_per_frame": 0.01, "flicker": {"amplitude": 0.1, "period_frames": 8, "phase_deg": 90}}
    )
    assert changing.brightness(0) == pytest.approx(1.1)
    assert changing.brightness(4) == pytest.approx(1.04 - 0.1)
    assert changing.brightness(2) == pytest.approx(1.02)


def test_brightness_must_stay_positive() -> None:
    scene = lit(drift_per_frame=-0.25)
    with pytest.raises(st.SceneError, match=r"lighting\.drift_per_frame: brightness is 0 at frame 4"):
        check_scene(scene, build_scene(scene))


@settings(deadline=None)
@given(t=some.floats(-20, 20))
def test_lamps_move_as_one_rigid_body(t: float) -> None:
    turn = {"kind": "rotation", "axis": [0, 1, 0], "rate_deg_per_frame": 5, "point_mm": CENTRE}
    push = {"kind": "velocity", "velocity_mm_per_frame": [1, 2, 3]}
    moved = lit(*({**light, "motion": [turn, push]} for light in (SPOT, POINT, SUN))).lighting.lamps_at(t)
    rotation = Rotation.from_euler("y", 5 * t, degrees=True)
    start = np.array([0.0, -80.0, 400.0])
    position = rotation.apply(start - CENTRE) + CENTRE + t * np.array([1, 2, 3])
    target = rotation.apply(np.array([0, 0, 660]) - CENTRE) + CENTRE + t * np.array([1, 2, 3])
    for lamp in moved[:2]:
        assert lamp.position_mm is not None
        np.testing.assert_allclose(lamp.position_mm, position, atol=1e-9)
    np.testing.assert_allclose(moved[0].axis, (target - position) / np.linalg.norm(target - position), atol=1e-12)
    assert moved[2].position_mm is None
    np.testing.assert_allclose(moved[2].axis, rotation.apply([0, 0, 1]), atol=1e-12)


def test_lamps_turn_about_themselves_by_default() -> None:
    turn = {"kind": "rotation", "axis": [1, 0, 0], "rate_deg_per_frame": 90}
    spot = {**SPOT, "direction": [0, 0, 1], "motion": [turn]}
    del spot["target_mm"]
    (lamp,) = lit(spot).lighting.lamps_at(1.0)
    np.testing.assert_allclose(lamp.position_mm, [0, -80, 400], atol=1e-9)  # type: ignore[arg-type]
    np.testing.assert_allclose(lamp.axis, [0, -1, 0], atol=1e-12)


@pytest.mark.parametrize("command", ["check", "simulate"])
def test_a_light_inside_an_object_is_refused(command: str) -> None:
    scene = lit(SUN, {**POINT, "position_mm": [0, 0, 690]})
    with pytest.raises(
        st.SceneError, match=r"lights\.1\.position_mm: the light is inside 'cube' at frame -4"
    ) as caught:
        st.simulate(scene) if command == "simulate" else check_scene(scene, build_scene(scene))
    assert len(caught.value.problems) == 1


def test_a_light_that_moves_into_an_object_is_refused() -> None:
    into = {"kind": "velocity", "velocity_mm_per_frame": [0, 0, 40]}
    scene = lit({**POINT, "position_mm": [0, 0, 550], "motion": [into]})
    (problem,) = find_lighting_problems(scene, build_scene(scene))
    # The nearest edge is at 660 - t mm, the light at 550 + 40 t mm.
    assert problem.path == "lighting.lights.0.position_mm"
    assert "frame 3" in problem.message


@given(offset=some.tuples(*[some.floats(-40, 40)] * 3))
def test_inside_a_box_is_inside(offset: tuple[float, float, float]) -> None:
    item = cube().to_dict()["objects"][0] | {"motion": [], "texture": {"kind": "uniform"}}
    place = Rotation.from_rotvec([np.deg2rad(20), 0, 0]) * Rotation.from_rotvec([0, np.deg2rad(45), 0])
    position = place.apply(offset) + CENTRE
    light = {**POINT, "position_mm": position.tolist()}
    scene = cube(objects=[item], frames={"count": 1}, lighting={"lights": [light]})
    depth = 24.5 - np.abs(offset).max()
    if abs(depth) > 1e-6:
        assert bool(find_lighting_problems(scene, build_scene(scene))) == (depth > 0)


def test_meshes_whose_triangles_face_anywhere_have_an_inside_and_open_ones_none(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=20.0)
    faces = ball.faces.copy()
    faces[::3] = faces[::3, ::-1]
    trimesh.Trimesh(ball.vertices, faces, process=False).export(tmp_path / "ball.ply")
    trimesh.Trimesh(ball.vertices, faces[1:], process=False).export(tmp_path / "open.ply")
    item = cube().to_dict()["objects"][0] | {"motion": []}
    found = {}
    for name in ("ball", "open"):
        mesh = {"kind": "file", "file": str(tmp_path / f"{name}.ply")}
        for x in (0.0, 18.0, 21.0):
            light = {**POINT, "position_mm": [x, 1.0, 693]}
            scene = cube(objects=[{**item, "mesh": mesh}], frames={"count": 1}, lighting={"lights": [light]})
            found[name, x] = bool(find_lighting_problems(scene, build_scene(scene)))
    assert [key for key, value in found.items() if value] == [("ball", 0.0), ("ball", 18.0)]


DISC = {
    "kind": "disc",
    "position_mm": [0, -80, 100],
    "target_mm": [0, 0, 660],
    "radius_mm": 40,
    **{
        "irradiance": 1,
        "reference_distance_mm": 500,
    },
}
RING = {**DISC, "kind": "ring", "position_mm": [0, 0, 0], "inner_radius_mm": 30, "radius_mm": 60}
PANEL = {key: value for key, value in DISC.items() if key != "radius_mm"} | {"kind": "rectangle", "size_mm": [80, 20]}
BALL = {key: value for key, value in DISC.items() if key != "target_mm"} | {"kind": "sphere"}


def test_lamps_with_a_size_report_all_problems_at_once() -> None:
    wrong = [
        {**DISC, "radius_mm": 0},
        {**RING, "inner_radius_mm": 60},
        {**PANEL, "size_mm": [80, -1]},
        {**PANEL, "width_direction": [0, 8, 56]},
        {**BALL, "reference_distance_mm": 40},
        {**DISC, "direction": [0, 0, 1]},
    ]
    with pytest.raises(st.SceneError) as error:
        lit(*wrong)
    assert [problem.path for problem in error.value.problems] == [
        "lighting.lights.0.radius_mm",
        "lighting.lights.1.radius_mm",
        "lighting.lights.2.size_mm.1",
        "lighting.lights.3",
        "lighting.lights.4.reference_distance_mm",
        "lighting.lights.5",
    ]
    messages = "\n".join(str(problem) for problem in error.value.problems)
    assert "must be greater than inner_radius_mm, 60" in messages
    assert "width_direction must not be parallel to the axis of the lamp" in messages


@pytest.mark.parametrize(
    ("lamp", "message"),
    [
        # The centre is outside the cube, a part of the lamp inside.
        (
            {**DISC, "position_mm": [80, 0, 692], "direction": [0, 0, -1], "target_mm": None, "radius_mm": 70},
            "in part, inside 'cube'",
        ),
        ({**BALL, "position_mm": [0, 0, -30]}, "the camera is on or inside the lamp"),
        ({**DISC, "position_mm": [0, 0, 0]}, "the camera is on or inside the lamp"),
        ({**PANEL, "position_mm": [0, 0, 0]}, "the camera is on or inside the lamp"),
    ],
)
def test_lamps_with_a_size_in_objects_and_at_the_camera(lamp: dict[str, Any], message: str) -> None:
    scene = lit({key: value for key, value in lamp.items() if value is not None})
    problems = find_lighting_problems(scene, build_scene(scene))
    assert [problem.path for problem in problems] == ["lighting.lights.0.position_mm"]
    assert message in problems[0].message


def test_a_ring_around_the_camera_is_accepted() -> None:
    scene = lit(RING)
    assert not find_lighting_problems(scene, build_scene(scene))


@pytest.mark.parametrize(
    ("roughness", "radius_mm", "warned"), [(0.02, 400.0, True), (0.03, 400.0, False), (0.02, 20.0, False)]
)
def test_sharp_gloss_under_wide_lamps_is_warned_of(roughness: float, radius_mm: float, warned: bool) -> None:
    plain = lit({**RING, "radius_mm": radius_mm, "inner_radius_mm": 15.0}).to_dict()
    plain["objects"][0]["material"] = {"refractive_index": 1.5, "roughness": 0.5, "roughness_along": roughness}
    scene = st.Scene.from_dict(plain)
    depth = np.full((scene.camera.height, scene.camera.width), 660.0)
    found = [text for text in describe_scene(scene, build_scene(scene), depth).warnings if "roughness" in text]
    assert bool(found) == warned
    assert all("lighting.lights.0: the lamp is wider than its distance from 'cube'" in text for text in found)


def test_the_distance_of_a_lamp_is_that_of_the_surface(tmp_path: Path) -> None:
    """The corners of the plane are 56 mm from the lamp, its middle 40 mm; the file states its roughness."""
    sphere = {"kind": "sphere", "position_mm": [0, 0, 560], "radius_mm": 25, "irradiance": 0.1}
    plain = lit(sphere | {"reference_distance_mm": 600}).to_dict()
    plain["objects"][0] |= {"mesh": {"kind": "plane", "size_mm": [56, 56]}, "pose": {"position_mm": [0, 0, 600]}}
    plain["objects"][0]["material"] = {"refractive_index": 1.5, "roughness": 0.02}
    points = np.array([[-28, -28, 0], [28, -28, 0], [28, 28, 0], [-28, 28, 0]], dtype=np.float32)
    file = tmp_path / "plate.gltf"
    file.write_text(
        gltf(
            {"points": points, "index": np.array([0, 2, 1, 0, 3, 2], dtype=np.uint16)},
            {"attributes": {"POSITION": "@points"}, "indices": "@index", "material": 0},
            materials=[{"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.1}}],
        )
    )
    for mesh, material in (
        (plain["objects"][0]["mesh"], plain["objects"][0]["material"]),
        ({"kind": "file", "file": str(file), "unit_mm": 1}, {"from_file": True}),
    ):
        plain["objects"][0] |= {"mesh": mesh, "material": material}
        scene = st.Scene.from_dict(plain)
        with pytest.warns(st.SceneWarning, match="wider than its distance"):
            check_scene(scene, build_scene(scene))


def test_lamps_in_view_and_lamps_that_face_away_are_warned_of() -> None:
    scene = lit({**DISC, "position_mm": [0, 0, 300]}, {**RING, "target_mm": [0, 0, -9]}, RING)
    depth = np.full((scene.camera.height, scene.camera.width), 660.0)
    report = describe_scene(scene, build_scene(scene), depth)
    warnings = [text for text in report.warnings if text.startswith("lighting")]
    assert warnings == [
        "lighting.lights.0: the lamp is in the field of view; images do not show lamps",
        "lighting.lights.1: the lamp faces away from all objects; turn it by direction or target_mm",
    ]


@given(
    some.floats(0, 30),
    some.floats(40, 90),
    some.tuples(*(some.floats(-1, 1) for _ in range(3))).filter(lambda axis: np.linalg.norm(axis) > 0.1),
)
def test_frames_of_moving_lamps(inner: float, radius: float, axis: tuple[float, float, float]) -> None:
    turn = {"kind": "rotation", "axis": [1, 2, 0], "rate_deg_per_frame": 10.0}
    given_lamp = {**RING, "direction": list(axis), "inner_radius_mm": inner, "radius_mm": radius, "motion": [turn]}
    del given_lamp["target_mm"]
    lighting = Lighting.model_validate({"lights": [given_lamp]})
    for t in (0.0, 3.0):
        lamp = lighting.lamps_at(t)[0]
        assert lamp.area is not None
        assert lamp.position_mm is not None
        frame = np.stack([lamp.area.across, lamp.area.down, lamp.axis])
        assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-12)
        outline = np.linalg.norm(lamp.outline_mm() - lamp.position_mm, axis=1)
        assert outline.max() == pytest.approx(radius)
        assert outline.min() == pytest.approx(inner, abs=1e-9)


def turned(points: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    """Return points turned at random about the centre of the lamp below."""
    return np.asarray(points @ Rotation.random(random_state=seed).as_matrix().T + [7.0, -3.0, 50.0])


def crossing_points(triangle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points of the line in which a triangle crosses the plane z = 0, shape (points, 3); none if it does not."""
    ends = [
        start + (end - start) * start[2] / (start[2] - end[2])
        for start, end in zip(triangle, np.roll(triangle, -1, axis=0), strict=True)
        if start[2] * end[2] < 0
    ]
    return np.linspace(ends[0], ends[1], 20_000) if ends else np.empty((0, 3))


@given(some.integers(0, 2**32 - 1), some.sampled_from(["disc", "ring", "rectangle", "sphere"]))
# A corner 0.2 mm in front of the lamp, and a triangle nearly parallel to it.
@example(1041, "disc")
@example(900, "rectangle")
def test_surfaces_that_cross_a_lamp(seed: int, kind: str) -> None:
    """Against points of the line in the plane of the lamp, or all over each triangle."""
    generator = np.random.default_rng(seed)
    triangle = generator.uniform(-80, 80, (3, 3))
    u, v = generator.uniform(0, 1, (2, 20_000))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    points = triangle[0] + u[:, None] * (triangle[1] - triangle[0]) + v[:, None] * (triangle[2] - triangle[0])
    # The lamp has the axis z before it is turned.
    x, y, _ = crossing_points(triangle).T
    sizes: dict[str, tuple[NDArray[np.float64], dict[str, Any]]] = {
        "disc": (np.hypot(x, y) - 40, {"radius_mm": 40}),
        "ring": (np.maximum(np.hypot(x, y) - 40, 25 - np.hypot(x, y)), {"inner_radius_mm": 25, "radius_mm": 40}),
        "rectangle": (np.maximum(np.abs(x) - 40, np.abs(y) - 15), {"size_mm": [80, 30]}),
        "sphere": (np.linalg.norm(points, axis=1) - 40, {"radius_mm": 40}),
    }
    beyond, fields = sizes[kind]
    axes = turned(np.eye(3), seed) - turned(np.zeros((1, 3)), seed)
    light: dict[str, Any] = {"kind": kind, "position_mm": turned(np.zeros((1, 3)), seed)[0].tolist(), **fields}
    light |= {"irradiance": 1, "reference_distance_mm": 300}
    if kind != "sphere":
        light["direction"] = axes[2].tolist()
    if kind == "rectangle":
        light["width_direction"] = axes[0].tolist()
    (lamp,) = Lighting.model_validate({"lights": [light]}).lamps_at(0.0)
    nearest = float(beyond.min(initial=np.inf))
    # Points are at most 3 mm apart on most triangles, and 0.02 mm on lines.
    if abs(nearest) > (8 if kind == "sphere" else 0.1):
        assert lamp.is_crossed_by(turned(triangle, seed)[None]) == (nearest < 0)


@pytest.mark.parametrize("lamp", [DISC, RING, PANEL, BALL], ids=lambda lamp: lamp["kind"])
def test_lamps_of_every_shape_in_sheets_and_rods_are_refused(lamp: dict[str, Any]) -> None:
    """A sheet has no inside, and a rod may pass between the points of an outline."""
    at = [0, -80, 400]
    sheet: dict[str, Any] = {
        "name": "sheet",
        "mesh": {"kind": "plane", "size_mm": [300, 300]},
        "texture": {"kind": "uniform"},
    }
    steep = {"position_mm": at, "rotations": [{"axis": [1, 0.2, 0], "angle_deg": 80}]}
    rod: dict[str, Any] = {"name": "rod", "mesh": {"kind": "cylinder", "radius_mm": 2, "length_mm": 200, "caps": True}}
    rod |= {"texture": {"kind": "uniform"}, "pose": {**steep, "position_mm": [37, -72, 400]}}
    placed = {**lamp, "position_mm": at, "direction": [0, 0, 1]}
    placed.pop("target_mm", None)
    if lamp["kind"] == "sphere":
        placed.pop("direction")
    scene = cube(lighting={"lights": [placed]}, objects=[{**sheet, "pose": steep}, rod])
    problems = find_lighting_problems(scene, build_scene(scene))
    assert {problem.path for problem in problems} == {"lighting.lights.0.position_mm"}
    assert any("the lamp is crossed by 'sheet' at frame" in problem.message for problem in problems)
    assert any("'rod' at frame" in problem.message for problem in problems)
