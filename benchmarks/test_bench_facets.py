"""How long images and truth of a smooth sheet of many small facets take."""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from numpy.typing import NDArray
from pytest_benchmark.fixture import BenchmarkFixture

from scenetruth.camera import Viewpoint
from scenetruth.raycast import RayCaster, Topology
from scenetruth.raycast import ray_caster as caster_module
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import BuiltScene, build_scene
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.truth import GeometryPass, truth_maps

AXIS = Viewpoint.on_axis(0.0)


def sheet(cells: int, size_mm: float = 60.0) -> TriangleMesh:
    """Return a wavy sheet of 2 cells² facets, with angles of less than 60° between them."""
    a, b = np.meshgrid(np.linspace(-1, 1, cells + 1), np.linspace(-1, 1, cells + 1))
    height = 0.05 * (np.sin(3 * a + 2 * b) + np.sin(1 - 2 * a + 3 * b))
    index = np.arange(a.size).reshape(a.shape)
    corners = [part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])]
    faces = np.stack([np.stack([corners[k] for k in (0, n, n + 1)], axis=-1) for n in (1, 2)], axis=1)
    faces = faces.reshape(-1, 3).astype(np.int32)
    flat = np.stack([a, b], axis=-1).reshape(-1, 2)
    vertices = np.column_stack([flat, height.ravel()]) * size_mm / 2
    return TriangleMesh(vertices, faces, flat[faces] * size_mm / 2, (flat[faces] + 1) / 2, crease_deg=60.0)


@pytest.fixture(scope="module", params=[71, 224, 707], ids=["1e4", "1e5", "1e6"])
def case(request: pytest.FixtureRequest) -> tuple[Scene, BuiltScene, Topology]:
    scene = Scene.from_dict(
        {
            "camera": {"width": 640, "height": 480, "focal_length_px": 6500},
            "stage": {"positions": 5, "baseline_mm": 5.0},
            "frames": {"count": 9},
            "objects": [
                {
                    "name": "sheet",
                    "mesh": {"kind": "plane", "size_mm": [60, 60]},
                    "pose": {"position_mm": [0, 0, 660], "rotations": [{"axis": [0, 1, 0], "angle_deg": 17}]},
                    "texture": {"kind": "noise", "wavelength_mm": [1.0, 4.0]},
                    "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0, 0, -1]}],
                }
            ],
        }
    )
    world = build_scene(scene, meshes={"sheet": sheet(request.param)})
    return scene, world, Topology.of(world.at(0).vertices_mm, world.faces, world.crease_deg)


def given_up(_self: object, _view: object, pixels: NDArray[np.int64], *_rule: object) -> Any:
    """Walk nowhere: every sample is traced."""
    return np.zeros(len(pixels), dtype=np.bool_), np.zeros(len(pixels))


@pytest.mark.parametrize("way", ["walked", "cast", "embree"])
def test_image_of_the_next_frame(
    benchmark: BenchmarkFixture, case: tuple[Scene, BuiltScene, Topology], way: str
) -> None:
    """One image at a new time: by walks; with a ray for every sample; with these and all others asking Embree."""
    scene, world, topology = case
    renderer = RaycastRenderer(world, scene.camera, 0.0, 4, topology=topology)
    times = iter(range(1, 100_000))
    walk = RaycastRenderer._walk if way == "walked" else given_up
    most = 0 if way == "embree" else caster_module._MOST_RASTERED
    with patch.object(RaycastRenderer, "_walk", walk), patch.object(caster_module, "_MOST_RASTERED", most):
        image = benchmark.pedantic(lambda: renderer.render(1e-3 * next(times), AXIS), rounds=3, warmup_rounds=1)
    assert np.ptp(image) > 0.5


@pytest.mark.parametrize("way", ["cells", "tiles", "embree"])
def test_rays_of_the_next_frame(
    benchmark: BenchmarkFixture, case: tuple[Scene, BuiltScene, Topology], way: str
) -> None:
    """What all pixel centres meet, with the mesh placed anew."""
    scene, world, topology = case
    directions = scene.camera.ray_directions(scene.camera.pixel_grid()).reshape(-1, 3)
    vertices = world.at(0).vertices_mm
    limits = {"cells": (1 << 30, 0), "tiles": (1 << 30, 1 << 30), "embree": (0, 0)}[way]
    with (
        patch.object(caster_module, "_MOST_RASTERED", limits[0]),
        patch.object(caster_module, "_MOST_TILED", limits[1]),
    ):
        hits = benchmark.pedantic(
            lambda: RayCaster(vertices, topology).cast(np.zeros(3), directions, 640), rounds=3, warmup_rounds=1
        )
    assert (hits.face >= 0).mean() > 0.5


def test_truth_of_a_frame(benchmark: BenchmarkFixture, case: tuple[Scene, BuiltScene, Topology]) -> None:
    """All maps of the reference camera at one time, with the geometry made anew."""
    scene, world, topology = case
    times = iter(range(1, 100_000))
    maps = benchmark.pedantic(
        lambda: truth_maps(GeometryPass(world, topology, 1e-3 * next(times)), scene.camera, AXIS, 5.0),
        rounds=3,
        warmup_rounds=1,
    )
    assert np.isfinite(maps["depth"]).mean() > 0.5
