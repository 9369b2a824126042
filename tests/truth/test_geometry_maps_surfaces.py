"""Truth of meshed surfaces against rays that meet the smooth surfaces themselves.

``python -m tests.truth.test_geometry_maps_surfaces`` prints the table of docs/results/rendering.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenetruth.camera import Viewpoint
from scenetruth.raycast import Topology
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.truth import GeometryPass, truth_maps
from tests.helpers.smooth_surfaces import POSITION, SPEED, SPIN_DEG, TILT_DEG, scene_of

Array = NDArray[np.float64]
Meet = Callable[[Array, Array], tuple[Array, Array]]
"""Rays (origin, directions) in the own frame to their lengths until the surface, and its unit normals there."""


def smooth_truth(scene: Scene, meet: Meet, x_mm: float, t: float) -> tuple[Array, Array, Array]:
    """Return depth, velocity and the cosine between ray and normal on the smooth surface itself."""
    turn = Rotation.from_euler("yx", TILT_DEG, degrees=True)
    turn = Rotation.from_euler("z", SPIN_DEG * t, degrees=True) * turn
    centre = POSITION + SPEED * t
    width, height, focal = scene.camera.width, scene.camera.height, scene.camera.focal_px
    y, x = np.mgrid[:height, :width]
    rays = np.stack([(x - (width - 1) / 2) / focal, (y - (height - 1) / 2) / focal, np.ones(x.shape)], axis=-1)
    origin = np.array([x_mm, 0.0, 0.0])
    depth, normal = meet(turn.inv().apply(origin - centre), turn.inv().apply(rays.reshape(-1, 3)))
    points = origin + rays.reshape(-1, 3) * depth[:, None]
    velocity = np.cross([0, 0, np.deg2rad(SPIN_DEG)], points - centre) + SPEED
    cosine = -np.einsum("ij,ij->i", turn.apply(normal), rays.reshape(-1, 3))
    return depth.reshape(y.shape), velocity.reshape(*y.shape, 3), cosine.reshape(y.shape)


def quadric(form: Any, linear: Any, constant: float, inside: Callable[[Array], Any]) -> Meet:
    """Return how rays meet x' diag(form) x + linear x + constant = 0, where ``inside``."""

    def meet(origin: Array, rays: Array) -> tuple[Array, Array]:
        a = rays**2 @ form
        b = 2 * (rays * origin) @ form + rays @ linear
        c = origin**2 @ form + origin @ linear + constant
        with np.errstate(invalid="ignore"):
            root = np.sqrt(b * b - 4 * a * c)
            roots = np.sort(np.stack([(-b - root) / (2 * a), (-b + root) / (2 * a)]), axis=0)
        hits = origin + rays * roots[..., None]
        roots[~inside(hits)] = np.nan
        depth = np.fmin(*roots)
        normal = 2 * (origin + rays * depth[:, None]) * form + linear
        # Towards the camera.
        normal *= -np.sign(np.einsum("ij,ij->i", normal, rays))[:, None]
        return depth, normal / np.linalg.norm(normal, axis=1, keepdims=True)

    return meet


def relief(
    amplitude: float, waves: tuple[float, float], phases: tuple[float, float], half: tuple[float, float]
) -> Meet:
    """Return how rays meet the waves, by Newton's method; slopes are small enough for one intersection."""
    kx, ky = 2 * np.pi / np.asarray(waves)
    px, py = np.deg2rad(phases)

    def meet(origin: Array, rays: Array) -> tuple[Array, Array]:
        depth = -origin[2] / rays[:, 2]
        for _ in range(60):
            x, y, z = (origin + rays * depth[:, None]).T
            height = -amplitude * np.cos(kx * x + px) * np.cos(ky * y + py)
            slope_x = amplitude * kx * np.sin(kx * x + px) * np.cos(ky * y + py)
            slope_y = amplitude * ky * np.cos(kx * x + px) * np.sin(ky * y + py)
            depth = depth - (z - height) / (rays[:, 2] - slope_x * rays[:, 0] - slope_y * rays[:, 1])
        depth = np.where((np.abs(x) < half[0]) & (np.abs(y) < half[1]), depth, np.nan)
        normal = np.column_stack([slope_x, slope_y, -np.ones(len(x))])
        return depth, normal / np.linalg.norm(normal, axis=1, keepdims=True)

    return meet


CASES: dict[str, tuple[dict[str, Any], Meet]] = {
    "sphere": (
        {"kind": "sphere", "radius_mm": 22},
        quadric(np.ones(3), np.zeros(3), -(22.0**2), lambda p: np.isfinite(p[..., 0])),
    ),
    "cap": (
        {"kind": "sphere", "radius_mm": 30, "cap_deg": 40},
        quadric(np.ones(3), np.zeros(3), -(30.0**2), lambda p: p[..., 2] < -30 * np.cos(np.deg2rad(40))),
    ),
    "cylinder": (
        {"kind": "cylinder", "radius_mm": 18, "length_mm": 36},
        quadric(np.array([1.0, 0, 1]), np.zeros(3), -(18.0**2), lambda p: np.abs(p[..., 1]) < 18),
    ),
    "saddle": (
        {"kind": "saddle", "size_mm": [40, 32], "curvature_per_mm": 0.02},
        quadric(
            np.array([0.01, -0.01, 0]),
            np.array([0.0, 0, -1]),
            0.0,
            lambda p: (np.abs(p[..., 0]) < 20) & (np.abs(p[..., 1]) < 16),
        ),
    ),
    "relief": (
        {
            "kind": "relief",
            "size_mm": [44, 36],
            "amplitude_mm": 0.8,
            "wavelength_mm": [16, 24],
            "phase_deg": [20, -40],
        },
        relief(0.8, (16, 24), (20, -40), (22, 18)),
    ),
}

# Where rays graze the surface, the depth of any mesh is off by the sagitta over the cosine.
LEAST_COSINE = 0.35


def errors(name: str, resolution_mm: float) -> tuple[float, float, float]:
    """Return rms and largest error of depth in mm, and largest error of velocity in mm per frame."""
    mesh, meet = CASES[name]
    scene = scene_of({**mesh, "resolution_mm": resolution_mm})
    world = build_scene(scene)
    topology = Topology.of(world.at(0).vertices_mm, world.faces)
    depths, speeds = [], []
    for x_mm, t in ((0.0, 0.0), (5.0, 1.0)):
        truth = truth_maps(GeometryPass(world, topology, t), scene.camera, Viewpoint.on_axis(x_mm), 5.0)
        depth, velocity, cosine = smooth_truth(scene, meet, x_mm, t)
        both = np.isfinite(truth["depth"]) & np.isfinite(depth) & (cosine > LEAST_COSINE)
        assert both.sum() > 500
        # By the faces' order: outwards, and of a sheet the upper side, which faces the camera.
        assert (truth["normal"][2][both] < 0).all()
        depths.append((truth["depth"] - depth)[both])
        speeds.append(np.abs(np.moveaxis(truth["velocity"], 0, -1) - velocity)[both])
    errors = np.concatenate(depths)
    return float(np.sqrt(np.mean(errors**2))), float(np.abs(errors).max()), float(np.concatenate(speeds).max())


def convergence(name: str, resolutions: tuple[float, ...]) -> tuple[Array, Array]:
    """Return `errors` for each resolution, and their order from the first to the last."""
    found = np.array([errors(name, resolution) for resolution in resolutions])
    # Over all of them; single steps scatter with where the rays of the pixels meet the triangles.
    return found, np.log2(found[0] / found[-1]) / np.log2(resolutions[0] / resolutions[-1])


@pytest.mark.parametrize("name", CASES)
def test_meshes_converge_to_the_smooth_surface_at_second_order(name: str) -> None:
    _, order = convergence(name, (2.0, 0.5))
    assert (order > 1.7).all()
    assert (order < 2.3).all()


def tread_rays(scene: Scene, treads: list[int], width: float, height: float, risers: bool, x_mm: float) -> Array:
    """Return the depth at which a camera at the side meets stairs that are not tilted: treads, then risers."""
    y, x = np.mgrid[: scene.camera.height, : scene.camera.width]
    slope_x, slope_y = (x - (scene.camera.width - 1) / 2) / 660, (y - (scene.camera.height - 1) / 2) / 660
    depth = np.full(x.shape, np.inf)
    for index, z in enumerate(treads):
        left = (index - len(treads) / 2) * width
        inside = (x_mm + slope_x * z > left) & (x_mm + slope_x * z < left + width) & (np.abs(slope_y * z) < height / 2)
        depth = np.where(inside & (z < depth), z, depth)
        if risers and index + 1 < len(treads):
            at = (left + width - x_mm) / slope_x
            low, high = sorted((z, treads[index + 1]))
            inside = (at > low) & (at < high) & (np.abs(slope_y * at) < height / 2)
            depth = np.where(inside & (at < depth), at, depth)
    return np.where(np.isfinite(depth), depth, np.nan)


@pytest.mark.parametrize("risers", [True, False])
def test_stairs_are_exact(risers: bool) -> None:
    mesh = {"kind": "stairs", "tread_mm": [16, 40], "steps_mm": [30, -60, 40], "risers": risers}
    scene = scene_of(mesh, width=96, height=64)
    item = scene.objects[0].model_copy(update={"pose": {"position_mm": (0.0, 0.0, 660.0)}, "motion": ()})
    scene = Scene.from_dict({**scene.to_dict(), "objects": [item.model_dump(warnings=False)]})
    world = build_scene(scene)
    topology = Topology.of(world.at(0).vertices_mm, world.faces)
    # Treads at 0, 30, -30, 10 mm: the middle between the nearest and the farthest is the origin.
    treads = [660, 690, 630, 670]
    for x_mm in (-40.3, 0.0, 40.3):
        truth = truth_maps(GeometryPass(world, topology, 0.0), scene.camera, Viewpoint.on_axis(x_mm), 5.0)
        expected = tread_rays(scene, treads, 16, 40, risers, x_mm)
        np.testing.assert_allclose(truth["depth"], expected, rtol=1e-13)
        facing = np.abs(truth["normal"][2]) > 0.5
        assert (truth["normal"][2][facing] == -1).all()
        rises = np.isfinite(expected) & ~facing
        if not risers:
            assert not rises.any()
        elif x_mm != 0:
            assert rises.any()
        # Risers face the free space in front of the farther tread.
        assert (np.sign(truth["normal"][0][rises]) == -np.sign((np.argwhere(rises)[:, 1] - 47.5) / 660)).all()


def test_a_plane_with_more_triangles_is_the_same_plane() -> None:
    maps = []
    for resolution in (None, 3.0):
        scene = scene_of({"kind": "plane", "size_mm": [50, 40], "resolution_mm": resolution})
        world = build_scene(scene)
        topology = Topology.of(world.at(0).vertices_mm, world.faces)
        maps.append(truth_maps(GeometryPass(world, topology, 1.0), scene.camera, Viewpoint.on_axis(0.0), 5.0))
    for name in ("depth", "velocity", "flow", "normal"):
        np.testing.assert_allclose(maps[1][name], maps[0][name], rtol=1e-11, atol=1e-13)
    assert len(world.faces) == 2 * 17 * 14


def main() -> None:
    """Print how errors fall with the size of the triangles."""
    resolutions = (2.0, 1.0, 0.5, 0.25)
    print("| surface | triangles, mm | depth rms, mm | depth max, mm | velocity max, mm/frame |\n|---|---|---|---|---|")
    for name in CASES:
        found, order = convergence(name, resolutions)
        for resolution, row in zip(resolutions, found, strict=True):
            print(f"| {name} | {resolution:g} | " + " | ".join(f"{value:.1e}" for value in row) + " |")
        print("| | order | " + " | ".join(f"{value:.2f}" for value in order) + " |")


if __name__ == "__main__":
    main()
