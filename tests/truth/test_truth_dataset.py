"""The complete truth: every map against another one, from where cameras really stood; objects that are all edge."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import scenetruth as st
from scenetruth.camera import Viewpoint
from scenetruth.errors import SceneWarning
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import BuiltScene, build_scene
from scenetruth.schema import VARIABLES
from scenetruth.simulation import make_truth
from scenetruth.truth import TruthPoses, TruthViews, interior_warnings
from tests.helpers.ball_mesh import ball
from tests.helpers.occluding_gate import gate
from tests.helpers.scenes import cube


@cache
def example() -> tuple[Scene, BuiltScene, xr.Dataset]:
    scene = gate()
    world = build_scene(scene)
    return scene, world, make_truth(scene, truth_views="all", truth_content="complete_with_light")


def points_at(world: BuiltScene, truth: xr.Dataset, time: float) -> NDArray[np.float64]:
    """Return where the surface points of one image's pixels are at some time, shape (n, 3)."""
    here = truth["object_id"].values >= 0
    face = world.face_offsets[truth["object_id"].values[here]] + truth["face_id"].values[here]
    corners = world.at(time).vertices_mm[world.faces[face]]
    b = truth["barycentric"].values[:, here].T
    return np.asarray(np.einsum("nc,ncx->nx", np.column_stack([1 - b.sum(axis=1), b]), corners))


def each_image() -> Any:
    scene, world, truth = example()
    for s in scene.stage.s.tolist():
        for t in scene.frames.t.tolist():
            image = truth.sel(s=s, t=t)
            yield scene, world, image, float(scene.stage.x_mm[list(scene.stage.s).index(s)]), t


def test_every_variable_of_a_truth_is_there() -> None:
    assert set(VARIABLES["truth"]) == set(map(str, example()[2].data_vars))


def test_displacements_and_finite_flow_are_those_of_the_surface_point() -> None:
    for scene, world, image, x_mm, t in each_image():
        here = image["object_id"].values >= 0
        now = points_at(world, image, t)
        pixels = scene.camera.pixel_grid()[here]
        np.testing.assert_allclose(scene.camera.project(now, x_mm), pixels, atol=1e-9)
        for way, step in (("next", 1.0), ("previous", -1.0)):
            then = points_at(world, image, t + step)
            np.testing.assert_allclose(image[f"displacement_{way}"].values[:, here].T, then - now, atol=1e-9)
            flow = scene.camera.project(then, x_mm) - pixels
            np.testing.assert_allclose(image[f"flow_{way}"].values[:, here].T, flow, atol=1e-9)


def test_acceleration_is_the_derivative_of_velocity() -> None:
    for _, world, image, _, t in each_image():
        here = image["object_id"].values >= 0
        h = 1e-3
        ahead, behind = points_at(world, image, t + h), points_at(world, image, t - h)
        second = (ahead - 2 * points_at(world, image, t) + behind) / h**2
        # Rounding of the second difference: 600 mm * 2e-16 * 4 / h^2.
        np.testing.assert_allclose(image["acceleration"].values[:, here].T, second, atol=1e-6)
        np.testing.assert_allclose(image["velocity"].values[:, here].T, (ahead - behind) / (2 * h), atol=1e-5)


def test_slope_is_that_of_neighbouring_depths() -> None:
    for scene, _, image, _, _ in each_image():
        depth, face = image["depth"].values, image["face_id"].values + 100 * image["object_id"].values
        x_mm = (scene.camera.pixel_grid()[..., 0] - scene.camera.principal_point[0]) / scene.camera.focal_px * depth
        # Along a row Y changes with Z only: on a plane dZ = Z_X dX + Z_Y dY exactly.
        y_mm = (scene.camera.pixel_grid()[..., 1] - scene.camera.principal_point[1]) / scene.camera.focal_px * depth
        same = (face[:, 1:] == face[:, :-1]) & (image["object_id"].values[:, 1:] >= 0)
        step = [np.diff(values, axis=1)[same] for values in (x_mm, y_mm, depth)]
        slope = image["slope"].values[:, :, 1:][:, same]
        np.testing.assert_allclose(slope[0] * step[0] + slope[1] * step[1], step[2], atol=1e-9)


def test_rigid_bodies_turn_at_their_rate_and_do_not_grow() -> None:
    _, _, truth = example()
    cube = truth["object_id"].values == 2
    rate = np.deg2rad(25) * np.array([1, 0, 0.3]) / np.hypot(1, 0.3)
    np.testing.assert_allclose(truth["rotation_rate"].values[:, cube].T, np.tile(rate, (cube.sum(), 1)), atol=1e-12)
    surface = truth["object_id"].values >= 0
    assert np.abs(truth["growth_rate"].values[surface]).max() <= 1e-14
    assert np.abs(truth["principal_growth_rates"].values[:, surface]).max() <= 1e-14
    assert np.abs(truth["curvature"].values[:, surface]).max() <= 1e-14
    assert np.isnan(truth["principal_growth_direction"].values).all()


def test_coordinates_on_the_surface_lead_back_to_the_point() -> None:
    _, _, truth = example()
    wall = truth["object_id"].values == 0
    # A plane's chart is its own frame in mm, and its image coordinates run over it from 0 to 1.
    uv, chart = truth["uv"].values[:, wall], truth["material_coordinates_mm"].values[:, wall]
    np.testing.assert_allclose(uv, chart / np.array([[100], [80]]) + 0.5, atol=1e-12)


def test_boundary_distance_is_that_of_the_nearest_mixed_pixel() -> None:
    for _, _, image, _, _ in each_image():
        rows, columns = np.nonzero(image["mixed"].values)
        y, x = np.mgrid[: image.sizes["y"], : image.sizes["x"]]
        nearest = np.hypot(y[..., None] - rows, x[..., None] - columns).min(axis=-1)
        np.testing.assert_allclose(image["boundary_distance"].values, nearest, atol=1e-12)


def test_tracked_points_are_the_points_displaced() -> None:
    scene, world, truth = example()
    tracks = st.track_points(scene, truth, [0, 1, -1, 0.25])
    image = truth.sel(s=0, t=0)
    here = image["object_id"].values >= 0
    assert (np.isfinite(tracks).all(axis=(0, 1)) == here).all()
    for track, way in zip(tracks[1:3], ("next", "previous"), strict=True):
        step = image[f"displacement_{way}"].values[:, here]
        np.testing.assert_allclose((track - tracks[0])[:, here], step, atol=1e-9)
    np.testing.assert_allclose(tracks[3][:, here].T, points_at(world, image, 0.25), atol=1e-9)


def thing(name: str, mesh: dict[str, Any], x_mm: float = 0.0, z_mm: float = 660.0) -> dict[str, Any]:
    texture = {"kind": "uniform", "radiance": 0.5}
    return {"name": name, "mesh": mesh, "pose": {"position_mm": [x_mm, 0, z_mm]}, "texture": texture}


def scene_with_margin(*objects: dict[str, Any], margin_px: float) -> st.Scene:
    return cube(objects=list(objects), frames={"count": 1}, score={"interior_margin_px": margin_px})


WALL = thing("wall", {"kind": "plane", "size_mm": [200, 200]}, z_mm=700.0)


def test_the_warning_names_the_objects_and_the_remedy(tmp_path: Path) -> None:
    file = str(ball(tmp_path / "ball.obj", normals=False))
    facets = thing("facets", {"kind": "file", "file": file, "crease_deg": 1.0}, -20.0)
    with pytest.warns(SceneWarning, match=r"^objects: 'facets' without interior pixels: .* less than 8 px") as caught:
        st.simulate(scene_with_margin(facets, WALL, margin_px=8))
    assert "many pixels of 'facets' are mixed: use a larger crease_deg" in str(caught[0].message)
    assert "'wall'" not in str(caught[0].message)
    # By its own edges the ball is smooth: 38 px to its limb. With a larger margin only distance helps.
    smooth = thing("ball", {"kind": "file", "file": file}, -20.0)
    st.simulate(scene_with_margin(smooth, WALL, margin_px=8))
    with pytest.warns(SceneWarning, match="'ball' without interior pixels") as caught:
        st.simulate(scene_with_margin(smooth, WALL, margin_px=45))
    assert "crease_deg" not in str(caught[0].message)


def test_pixels_at_the_margin_are_interior_and_objects_that_are_not_seen_are_not_named() -> None:
    world = build_scene(scene_with_margin(thing("one", WALL["mesh"]), thing("two", WALL["mesh"]), WALL, margin_px=2))
    bodies = np.array([[0, 0, 0, 1, 1, 1, -1]])
    distance = np.array([[2.0, 1.0, 0.0, 0.0, 1.0, 1.9, 9.0]])
    (message,) = interior_warnings(world, bodies, distance, 2.0)
    assert message.startswith("objects: 'two' without")
    (message,) = interior_warnings(world, bodies, distance, 2.1)
    assert message.startswith("objects: 'one', 'two' without")
    assert interior_warnings(world, bodies, distance, 1.9) == []


Array = NDArray[np.float64]

# Much worse than any stage, so that a wrong sign or order shows.
ROUGH = {
    "repeatability_um": 100,
    "backlash_um": 500,
    "straightness_um": 500,
    "pitch_urad": 5e3,
    "yaw_urad": 5e3,
    "roll_urad": 2e4,
}
DISTORTED = {"width": 160, "height": 120, "focal_length_px": 1254, "distortion": {"k1": -0.2, "p1": 0.01}}


def scene_of(stage: dict[str, Any] | None = None, **changes: Any) -> Scene:
    return cube(**{"frames": {"count": 3}, **changes}, stage={"positions": 3, "baseline_mm": 5.0, **(stage or {})})


def truth_of(scene: Scene, views: TruthViews = "all", poses: TruthPoses = "actual") -> xr.Dataset:
    return make_truth(scene, truth_views=views, truth_poses=poses)


def viewpoint_of(truth: xr.Dataset, s: int, t: int) -> Viewpoint:
    """Read the pose of a camera from the truth alone."""
    at = {"s": s, "t": t}
    turn = Rotation.from_rotvec(truth["camera_rotation_rad"].sel(at).values).as_matrix()
    return Viewpoint(truth["camera_position_mm"].sel(at).values, turn)


@pytest.mark.parametrize("scan", ["unidirectional", "bidirectional"])
@pytest.mark.parametrize("camera", [None, DISTORTED], ids=["pinhole", "distorted"])
def test_identities_hold_in_turned_cameras(scan: str, camera: dict[str, Any] | None) -> None:
    stage = {"errors": ROUGH, "scan": scan, "time_per_position_s": 0.3}
    scene = scene_of(stage, **({} if camera is None else {"camera": camera}))
    truth, camera_model, baseline = truth_of(scene), scene.camera, scene.stage.baseline_mm
    for s in scene.stage.s.tolist():
        for t in scene.frames.t.tolist():
            view, maps = viewpoint_of(truth, s, t), truth.sel(s=s, t=t)
            seen = np.isfinite(maps["depth"].values)
            assert seen.sum() > 1000
            pixels = camera_model.pixel_grid()[seen]
            own = camera_model.ray_directions(pixels) * maps["depth"].values[seen][:, None]
            world = view.position_mm + own @ view.rotation.T
            velocity = maps["velocity"].values[:, seen].T @ view.rotation.T
            # The motion of the cube, known beforehand, comes back from the camera's frame.
            np.testing.assert_allclose(velocity, np.tile([0.1, -0.05, -1], (len(world), 1)), atol=1e-12)
            np.testing.assert_allclose(camera_model.project(view.to_camera(world)), pixels, atol=1e-9)
            aside = Viewpoint(view.position_mm + baseline * view.rotation[:, 0], view.rotation)
            shifted = camera_model.without_distortion().project(aside.to_camera(world))
            straight = camera_model.without_distortion().project(view.to_camera(world))
            np.testing.assert_allclose((straight - shifted)[:, 0], maps["disparity"].values[seen], atol=1e-9)
            np.testing.assert_allclose((straight - shifted)[:, 1], 0, atol=1e-9)
            # Central differences, extrapolated once: the rounding of the projection over the step is 1e-13 / 1e-3.
            coarse, fine = (
                (
                    camera_model.project(view.to_camera(world + h * velocity))
                    - camera_model.project(view.to_camera(world - h * velocity))
                )
                / (2 * h)
                for h in (2e-3, 1e-3)
            )
            np.testing.assert_allclose((4 * fine - coarse) / 3, maps["flow"].values[:, seen].T, atol=1e-9)


def wall(velocity: tuple[float, float, float]) -> dict[str, Any]:
    return {
        "name": "wall",
        "mesh": {"kind": "plane", "size_mm": [600, 600]},
        "pose": {"position_mm": [0, 0, 660]},
        "texture": {"kind": "uniform"},
        "motion": [{"kind": "velocity", "velocity_mm_per_frame": velocity}],
    }


def test_every_pixel_of_a_turned_camera_sees_the_moving_wall_where_it_is_then() -> None:
    stage = {"errors": ROUGH, "time_per_position_s": 0.4, "rows": 2, "row_spacing_mm": 6.0}
    frames = {"count": 3, "frame_interval_s": 3.0}
    scene = scene_of(stage, objects=[wall((0.0, 0.0, -2.0))], frames=frames)
    truth = truth_of(scene)
    assert truth["depth"].dims == ("s_y", "s", "t", "y", "x")
    rays = scene.camera.ray_directions(scene.camera.pixel_grid())
    for s_y in (0, 1):
        for s in (-1, 0, 1):
            for t in (-1, 0, 1):
                maps = truth.sel(s_y=s_y, s=s, t=t)
                # Images are 0.4 s apart, row after row; the reference is the second.
                time = t + 0.4 * (3 * s_y + s) / 3.0
                assert maps["image_time_s"] == pytest.approx(3 * time, abs=1e-12)
                view = viewpoint_of(truth.sel(s_y=s_y), s, t)
                world = view.position_mm + (rays * maps["depth"].values[..., None]) @ view.rotation.T
                np.testing.assert_allclose(world[..., 2], 660 - 2 * time, atol=1e-9)
                normal = np.moveaxis(maps["normal"].values, 0, -1) @ view.rotation.T
                np.testing.assert_allclose(normal - [0, 0, -1], 0, atol=1e-12)


def test_depth_of_a_scan_changes_while_the_stage_travels() -> None:
    """A wall that comes nearer by 2 mm per frame, seen by positions 0.2 frames apart."""
    scene = scene_of({"time_per_position_s": 0.2}, objects=[wall((0.0, 0.0, -2.0))])
    real, planned = truth_of(scene)["depth"], truth_of(scene, poses="nominal")["depth"]
    for s in (-1, 0, 1):
        for t in (-1, 0, 1):
            np.testing.assert_allclose(real.sel(s=s, t=t), 660 - 2 * (t + 0.2 * s), atol=1e-9)
            np.testing.assert_allclose(planned.sel(s=s, t=t), 660 - 2 * t, atol=1e-9)


def test_what_passes_the_camera_during_the_last_scan_is_refused() -> None:
    fast = {"objects": [wall((0.0, 0.0, -500.0))], "frames": {"count": 3}}
    st.simulate(scene_of({"time_per_position_s": 0.3}, **fast))
    with pytest.raises(st.SceneError, match=r"objects\.0\.pose\.position_mm: 'wall' reaches behind the camera"):
        st.simulate(scene_of({"time_per_position_s": 1 / 3}, **fast))


@pytest.mark.parametrize("views", ["reference", "all"])
def test_planned_truth_is_that_of_a_perfect_stage(views: TruthViews) -> None:
    rough = scene_of({"errors": ROUGH, "time_per_position_s": 0.2})
    planned, perfect = truth_of(rough, views, "nominal"), truth_of(scene_of(), views)
    for name in ("depth", "velocity", "disparity", "flow", "normal", "object_id", "face_id", "mixed"):
        xr.testing.assert_identical(planned[name], perfect[name])
    assert (planned.attrs["truth_poses"], perfect.attrs["truth_poses"]) == ("nominal", "actual")


def test_both_truths_carry_the_real_poses_of_all_cameras() -> None:
    scene = scene_of({"errors": ROUGH, "time_per_position_s": 0.2})
    real, planned = truth_of(scene, "reference"), truth_of(scene, "reference", "nominal")
    assert real["depth"].dims == ("t", "y", "x")
    assert real["camera_position_mm"].dims == real["camera_rotation_rad"].dims == ("s", "t", "component")
    assert real["image_time_s"].dims == ("s", "t")
    for name in ("camera_position_mm", "camera_rotation_rad", "image_time_s"):
        xr.testing.assert_identical(real[name], planned[name])
        assert np.ptp(real[name].values) > 0
    assert abs(real["depth"] - planned["depth"]).max() > 1e-3
    xr.testing.assert_identical(truth_of(scene)["depth"].sel(s=0).drop_vars(["s", "stage_x_mm"]), real["depth"])


def test_a_perfect_stage_is_recorded_as_such() -> None:
    truth = truth_of(scene_of(), "reference")
    position = truth["camera_position_mm"]
    assert (position.sel(component="X") == truth["stage_x_mm"]).all()
    assert not position.sel(component=["Y", "Z"]).any()
    assert not truth["camera_rotation_rad"].any()
    assert (truth["image_time_s"] == truth["time_s"]).all()


def test_rows_of_a_grid_see_the_wall_displaced_by_its_disparity() -> None:
    """The truth of a lower row is that of the reference row from further down."""
    scene = scene_of({"rows": 3, "row_spacing_mm": 5.0})
    truth = truth_of(scene)
    assert truth["stage_y_mm"].values.tolist() == [-5, 0, 5]
    rays = scene.camera.ray_directions(scene.camera.pixel_grid())
    for s_y in (-1, 0, 1):
        maps = truth.sel(s_y=s_y, s=1, t=0)
        seen = np.isfinite(maps["depth"].values)
        world = rays[seen] * maps["depth"].values[seen][:, None] + [5, 5 * s_y, 0]
        # The same surface from everywhere: the cube's faces in its own frame.
        turn = Rotation.from_rotvec([np.deg2rad(20), 0, 0]) * Rotation.from_rotvec([0, np.deg2rad(45), 0])
        own = turn.inv().apply(world - [0, 0, 692.56])
        np.testing.assert_allclose(np.abs(own).max(axis=1), 24.5, atol=1e-9)
    ordinary = truth_of(scene_of())
    for name in ("depth", "flow", "normal", "camera_position_mm"):
        row = truth[name].sel(s_y=0).drop_vars(["s_y", "stage_y_mm"])
        xr.testing.assert_identical(row, ordinary[name])


def test_a_truth_of_a_grid_can_be_scored(tmp_path: Any) -> None:
    stage = {"rows": 3, "row_spacing_mm": 2.0}
    scene = scene_of(stage, frames={"count": 2})
    recording, truth = st.simulate(scene, truth_views="all")
    for dataset, name in ((recording, "recording"), (truth, "truth")):
        st.save_store(dataset, tmp_path / name)
        xr.testing.assert_identical(st.load_store(tmp_path / name, kind=name), dataset)  # type: ignore[arg-type]
    with pytest.raises(st.EstimateError, match=r"stage\.rows: a grid is not supported .* recording\.sel\(s_y=0\)"):
        st.estimate(recording)
    plain, reference = st.simulate(scene_of(frames={"count": 2}))
    np.testing.assert_array_equal(recording["image"].sel(s_y=0), plain["image"])
    estimate = st.estimate(recording.sel(s_y=0))
    xr.testing.assert_identical(estimate.drop_attrs(), st.estimate(plain).drop_attrs())
    score = st.score(estimate, truth)
    with pytest.raises(st.MismatchError, match="belongs to another recording than truth"):
        st.score(estimate, reference)
    expected = st.score(estimate, reference, allow_mismatch=True)
    # Further regions tell which points all cameras see, of which a grid has more.
    assert all(score.regions[name] == expected.regions[name] for name in ("all", "interior"))
    assert score.regions["all"]["depth"]["count"]


def test_truth_is_computed_with_one_thread_of_blas() -> None:
    # Its tasks run in threads of their own: those of BLAS took 4 to 7 % of the time to wait for each other.
    from threadpoolctl import threadpool_info, threadpool_limits

    counts: list[int] = []

    def progress(what: str, done: int, total: int) -> None:
        counts.extend(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")

    with threadpool_limits(2, user_api="blas"):
        make_truth(cube(frames={"count": 1}, stage={"positions": 3, "baseline_mm": 5.0}), progress=progress)
    assert set(counts) == {1}
