"""How long the truth of one frame takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pytest_benchmark.fixture import BenchmarkFixture

from scenetruth.camera import Viewpoint
from scenetruth.raycast import Topology
from scenetruth.scene import load_scene
from scenetruth.scene.world import build_world
from scenetruth.truth import GeometryPass, truth_maps

SCENE = load_scene(Path(__file__).parents[1] / "scenes" / "cube.yaml")


def test_truth_of_a_frame(benchmark: BenchmarkFixture) -> None:
    """All maps of the reference camera at one time, with the geometry made anew."""
    world = build_world(SCENE)
    topology = Topology.of(world.at(0).vertices_mm, world.faces)
    baseline = SCENE.stage.baseline_mm

    def make(t: float = 0.0) -> dict[str, np.ndarray]:
        return truth_maps(GeometryPass(world, topology, t), SCENE.camera, Viewpoint.on_axis(0.0), baseline)

    make(1.0)  # compiles the kernels
    maps = benchmark(make)
    depth = maps["depth"]
    np.testing.assert_allclose(maps["disparity"], SCENE.camera.focal_px * baseline / depth, rtol=1e-15)
    assert np.isfinite(depth).any()
