"""Exact truth against an analytic ray and box, against itself, and row by row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

from scenetruth.camera import Viewpoint
from scenetruth.raycast import Topology
from scenetruth.scene import Scene, load_scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.simulation import make_truth
from scenetruth.truth import GeometryPass, truth_by_rows, truth_maps
from scenetruth.truth.geometry_maps import boundary_distance
from tests.helpers.nightly import NIGHTLY, nightly
from tests.helpers.scenes import LIBRARY, SCENES, cube, small

Array = NDArray[np.float64]


# Geometry does not ask what a surface looks like, and a noise texture of these scenes takes two seconds to make.
PLAIN = "objects.0.texture={kind: uniform}"


def analytic_box_depth(scene: Scene, x_mm: float, t: float) -> Array:
    """Intersect rays with the three slabs of the cube, in the cube's own frame; written without the package's code."""
    half = 49 / 2
    a, b = np.deg2rad(45), np.deg2rad(20)
    about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    turn = about_x @ about_y
    velocity = np.asarray(scene.objects[0].motion[0].velocity_mm_per_frame)  # type: ignore[attr-defined]
    centre = np.array([0, 0, 692.56]) + velocity * t
    width, height, focal = scene.camera.width, scene.camera.height, scene.camera.focal_px
    y, x = np.mgrid[:height, :width]
    rays = np.stack([(x - (width - 1) / 2) / focal, (y - (height - 1) / 2) / focal, np.ones(x.shape)], axis=-1)
    origin = turn.T @ (np.array([x_mm, 0, 0]) - centre)
    local = rays @ turn
    one, two = (-half - origin) / local, (half - origin) / local
    enter = np.minimum(one, two).max(axis=-1)
    leave = np.maximum(one, two).min(axis=-1)
    return np.where(enter <= leave, enter, np.nan)


# In the whole image, 14 million pixels; and by day in one of a quarter of its height and width, with the same view.
@pytest.mark.parametrize(
    "size",
    [
        ["camera.width=160", "camera.height=120", "camera.focal_length_px=1254"],
        pytest.param(["camera.width=640"], marks=nightly),
    ],
    ids=["small", "whole"],
)
def test_cube_against_the_analytic_box_for_every_camera_and_frame(size: list[str]) -> None:
    scene = load_scene(SCENES / "cube.yaml", overrides=[*size, "sensor=ideal", PLAIN])
    world = build_scene(scene)
    topology = Topology.of(world.at(0).vertices_mm, world.faces, world.crease_deg)
    unsure = worst = 0.0
    for t in scene.frames.t:
        geometry = GeometryPass(world, topology, float(t))
        for x_mm in scene.stage.x_mm:
            viewpoint = Viewpoint.on_axis(float(x_mm))
            truth = truth_maps(geometry, scene.camera, viewpoint, scene.stage.baseline_mm, "standard")
            expected = analytic_box_depth(scene, float(x_mm), float(t))
            seen = np.isfinite(expected)
            different = np.isfinite(truth["depth"]) != seen
            unsure += different.sum()
            both = seen & ~different
            worst = max(worst, float(np.abs(truth["depth"][both] - expected[both]).max()))
            speed = truth["velocity"][:, both] - np.array([[0], [0], [-1.0]])
            assert np.abs(speed).max() <= 1e-12
    # Two float64 formulas can differ about a pixel centre that a silhouette meets within rounding: none of 14 million.
    assert unsure <= 1
    assert worst <= 1e-9


def identities(scene: Scene, *, every: bool = True) -> dict[str, float]:
    """Return the largest disagreements in px between depth, disparity, flow, velocity and reprojection.

    They are those of ``every`` camera and frame, or of the first, the middle and the last of both.
    """
    world = build_scene(scene)
    topology = Topology.of(world.at(0).vertices_mm, world.faces, world.crease_deg)
    camera, baseline = scene.camera, scene.stage.baseline_mm
    worst = {"reprojection": 0.0, "disparity": 0.0, "flow": 0.0}
    step = 1e-3
    times, places = (
        values if every else sorted({values[0], values[len(values) // 2], values[-1]})
        for values in (list(scene.frames.t), list(scene.stage.x_mm))
    )
    for t in times:
        geometry = GeometryPass(world, topology, float(t))
        for x_mm in places:
            truth = truth_maps(geometry, camera, Viewpoint.on_axis(float(x_mm)), baseline)
            seen = np.isfinite(truth["depth"])
            pixels = camera.pixel_grid()[seen]
            points = camera.ray_directions(pixels) * truth["depth"][seen][:, None] + [x_mm, 0, 0]
            velocity = truth["velocity"][:, seen].T
            deviations = {"reprojection": camera.project(points, float(x_mm)) - pixels}
            # Disparity is that of the image without distortion, where it lies along x.
            pinhole = camera.without_distortion()
            other = pinhole.project(points, float(x_mm) + baseline) - pinhole.project(points, float(x_mm))
            deviations["disparity"] = other + np.stack([truth["disparity"][seen], np.zeros(seen.sum())], axis=-1)
            # Central differences of the projection, extrapolated once (Richardson): error of fourth order in the step.
            coarse, fine = (
                (
                    camera.project(points + h * velocity, float(x_mm))
                    - camera.project(points - h * velocity, float(x_mm))
                )
                / (2 * h)
                for h in (2 * step, step)
            )
            deviations["flow"] = (4 * fine - coarse) / 3 - truth["flow"][:, seen].T
            for name, values in deviations.items():
                worst[name] = max(worst[name], float(np.abs(values).max(initial=0)))
    return worst


SMALL = ["camera.width=160", "camera.height=120", "sensor=ideal", PLAIN]


@pytest.mark.parametrize(
    ("file", "changes"),
    [
        ("cube.yaml", [*SMALL, "camera.focal_length_px=1254"]),
        (
            "cube.yaml",
            [*SMALL, "camera.focal_length_px=1254", "camera.principal_point_px=[40.3, 99.6]", "stage.baseline_mm=-3"],
        ),
        ("plane.yaml", [*SMALL, "camera.focal_length_px=1254"]),
        (
            "plane.yaml",
            [*SMALL, "camera.focal_length_px=1254", "camera.distortion={k1: -9, k2: 300, p1: 0.05, p2: -0.02, k4: 1}"],
        ),
        ("plaid.yaml", []),
    ],
)
def test_depth_disparity_flow_and_reprojection_agree(file: str, changes: list[str]) -> None:
    worst = identities(load_scene(SCENES / file, overrides=changes))
    assert worst["reprojection"] <= 1e-9
    assert worst["disparity"] <= 1e-9
    # The central difference itself loses rounding / step: 1e-13 px * 1e3.
    assert worst["flow"] <= 1e-9


@nightly
@pytest.mark.parametrize("file", LIBRARY, ids=lambda file: file.stem)
def test_every_scene_of_the_library_agrees_with_itself(file: Path) -> None:
    # All cameras and frames of the library are tried at night.
    worst = identities(small(file, parts=8), every=NIGHTLY)
    assert worst["reprojection"] <= 1e-9
    assert worst["disparity"] <= 1e-9
    assert worst["flow"] <= 1e-9


def test_velocity_of_a_turning_plane_moves_the_surface_points() -> None:
    scene = load_scene(SCENES / "plane.yaml", overrides=[*SMALL, "camera.focal_length_px=1254"])
    world = build_scene(scene)
    before, now, after = (world.at(t) for t in (-1e-4, 0.0, 1e-4))
    difference = (after.vertices_mm - before.vertices_mm) / 2e-4
    np.testing.assert_allclose(now.velocities, difference, atol=1e-8)


def all_views() -> xr.Dataset:
    scene = cube(frames={"count": 2})
    return make_truth(scene, truth_views="all")


def test_all_cameras_have_s_before_t_and_the_reference_is_the_same() -> None:
    scene = cube(frames={"count": 2})
    every, reference = all_views(), make_truth(scene)
    assert every["depth"].dims == ("s", "t", "y", "x")
    assert every["velocity"].dims == ("component", "s", "t", "y", "x")
    for name in reference.data_vars:
        if "s" in reference[name].dims:
            # Poses of all cameras are in both.
            xr.testing.assert_identical(every[name], reference[name])
            continue
        xr.testing.assert_identical(every[name].sel(s=0).drop_vars(["s", "stage_x_mm"]), reference[name])


def test_normals_are_unit_and_face_the_camera() -> None:
    truth = all_views()
    normal = np.moveaxis(truth["normal"].values, 0, -1)
    seen = np.isfinite(truth["depth"].values)
    np.testing.assert_allclose(np.linalg.norm(normal[seen], axis=-1), 1, rtol=1e-14)
    assert (normal[seen][:, 2] < 0).all()
    # Three sides of the cube are seen, so there are three normals.
    assert len(np.unique(normal[seen].round(9), axis=0)) == 3


def test_what_is_not_seen_is_marked() -> None:
    truth = all_views()
    nothing = np.isnan(truth["depth"].values)
    assert nothing.any()
    for name in ("disparity", "velocity", "flow", "normal"):
        values: Any = truth[name].values
        assert (np.isnan(values) == nothing).all()
    for name in ("object_id", "face_id"):
        assert ((truth[name].values == -1) == nothing).all()


def test_stores_are_float64() -> None:
    truth = all_views()
    for name in ("depth", "velocity", "disparity", "flow", "normal"):
        assert truth[name].dtype == np.float64


@settings(max_examples=60, deadline=None)
@given(seed=some.integers(0, 10_000), height=some.integers(1, 40), width=some.integers(1, 40), share=some.floats(0, 1))
def test_distances_to_marked_pixels_are_exact(seed: int, height: int, width: int, share: float) -> None:
    generator = np.random.default_rng(seed)
    marked = generator.random((height, width)) < share**3
    found = boundary_distance(marked)
    if not marked.any():
        assert np.isinf(found).all()
        return
    places = np.argwhere(marked)
    pixels = np.stack(np.meshgrid(np.arange(height), np.arange(width), indexing="ij"), axis=-1)
    # Squares of distances are integers: only the root is rounded, in the same way.
    squares = ((pixels[:, :, None] - places) ** 2).sum(axis=-1).min(axis=2)
    assert (found == np.sqrt(squares)).all()


def test_each_row_is_that_of_an_image_at_its_time() -> None:
    scene = cube(camera={"width": 80, "height": 24, "focal_length_px": 600, "distortion": {"k1": -2.0}})
    world = build_scene(scene)
    topology = Topology.of(world.at(0).vertices_mm, world.faces)
    times = np.linspace(-0.4, 0.4, 24)
    places = [Viewpoint.on_axis(float(3 * t)) for t in times]
    found = truth_by_rows(world, topology, scene.camera, times, places, 5.0)
    for row, (time, place) in enumerate(zip(times, places, strict=True)):
        whole = truth_maps(GeometryPass(world, topology, float(time)), scene.camera, place, 5.0)
        # Distances are measured in the image's own boundaries, whose rows have times of their own.
        del whole["boundary_distance"]
        for name, values in whole.items():
            # The cut camera's principal point differs by a whole number of rows: roundings of it.
            np.testing.assert_allclose(
                found[name][..., row, :].astype(float), values[..., row, :].astype(float), rtol=1e-11, atol=1e-11
            )


def test_rows_of_one_time_are_the_ordinary_truth() -> None:
    scene = cube(camera={"width": 80, "height": 24, "focal_length_px": 600})
    world = build_scene(scene)
    topology = Topology.of(world.at(0).vertices_mm, world.faces)
    place = Viewpoint.on_axis(5.0)
    found = truth_by_rows(world, topology, scene.camera, np.zeros(24), [place] * 24, 5.0)
    whole = truth_maps(GeometryPass(world, topology, 0.0), scene.camera, place, 5.0)
    for name, values in whole.items():
        np.testing.assert_allclose(found[name].astype(float), values.astype(float), rtol=1e-11, atol=1e-11)
