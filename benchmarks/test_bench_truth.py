"""How long the truth of one frame takes, and the complete truth of many triangles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from scenetruth.camera import Viewpoint
from scenetruth.raycast import Topology
from scenetruth.scene import load_scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.simulation import make_truth
from scenetruth.truth import GeometryPass, truth_from_world, truth_maps

SCENES = Path(__file__).parents[1] / "scenes"
SCENE = load_scene(SCENES / "cube.yaml")


def test_truth_of_a_frame(benchmark: BenchmarkFixture) -> None:
    """All maps of the reference camera at one time, with the geometry made anew."""
    world = build_scene(SCENE)
    topology = Topology.of(world.at(0).vertices_mm, world.faces)
    baseline = SCENE.stage.baseline_mm

    def make(t: float = 0.0) -> dict[str, np.ndarray]:
        return truth_maps(GeometryPass(world, topology, t), SCENE.camera, Viewpoint.on_axis(0.0), baseline)

    make(1.0)  # compiles the kernels
    maps = benchmark(make)
    depth = maps["depth"]
    np.testing.assert_allclose(maps["disparity"], SCENE.camera.focal_px * baseline / depth, rtol=1e-15)
    assert np.isfinite(depth).any()


@pytest.mark.parametrize("resolution_mm", [1.6, 0.5, 0.158])
def test_complete_truth_of_a_rosette(benchmark: BenchmarkFixture, resolution_mm: float) -> None:
    """Nine frames of the reference camera; about ten thousand, a hundred thousand and a million triangles."""
    changes = [
        "plants.0.texture.texels_per_mm=5.1",
        f"plants.0.leaf.resolution_mm={resolution_mm}",
        "objects.0.mesh.resolution_mm=8",
        "objects.1.mesh.resolution_mm=8",
    ]
    scene = load_scene(SCENES / "rosette.yaml", overrides=changes)
    world = build_scene(scene)
    one = load_scene(SCENES / "rosette.yaml", overrides=[*changes, "frames.count=1"])
    make_truth(one, truth_content="complete")  # compiles the kernels
    arguments = (scene, world, "reference", "actual", "complete", {})
    truth = benchmark.pedantic(truth_from_world, arguments, rounds=1)
    benchmark.extra_info["triangles"] = len(world.faces)
    assert truth.sizes["t"] == scene.frames.count
    assert np.isfinite(truth["growth_rate"].values).any()
