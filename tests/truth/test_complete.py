"""The complete truth: every map against another one, or against the motion itself."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import BuiltScene, build_scene
from scenetruth.schema import VARIABLES
from scenetruth.truth import make_truth
from tests.truth.test_visibility import gate


@cache
def example() -> tuple[Scene, BuiltScene, xr.Dataset]:
    scene = gate()
    world = build_scene(scene)
    return scene, world, make_truth(scene, truth_views="all", truth_content="complete")


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
