"""How long one image of the cube takes, by backend and by samples per pixel."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from scenetruth.camera import Viewpoint
from scenetruth.errors import BackendUnavailableError
from scenetruth.render import Renderer
from scenetruth.render.pyrender_backend import PyrenderRenderer
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.scene import load_scene
from scenetruth.scene.built_scene import BuiltScene, build_scene

SCENE = load_scene(Path(__file__).parents[1] / "scenes" / "cube.yaml")


@pytest.fixture(scope="module")
def world() -> BuiltScene:
    return build_scene(SCENE)


@pytest.fixture(params=[1, 4], ids=["1x1", "4x4"])
def samples(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture(params=["raycast", "pyrender"])
def renderer(request: pytest.FixtureRequest, world: BuiltScene, samples: int) -> Iterator[Renderer]:
    """Yield a renderer that has its kernels compiled and its textures uploaded."""
    made: Renderer
    if request.param == "raycast":
        made = RaycastRenderer(world, SCENE.camera, SCENE.background, samples)
    else:
        try:
            made = PyrenderRenderer(world, SCENE.camera, SCENE.background, samples)
        except BackendUnavailableError as error:
            pytest.skip(str(error))
    with made as ready:
        ready.render(0.0, Viewpoint.on_axis(0.0))
        yield ready


def test_image_from_the_next_camera(benchmark: BenchmarkFixture, renderer: Renderer) -> None:
    """One image at the time of the one before: the scene is kept, only the camera moves."""
    image = benchmark(renderer.render, 0.0, Viewpoint.on_axis(SCENE.stage.baseline_mm))
    assert image.shape == (SCENE.camera.height, SCENE.camera.width)
    assert np.ptp(image) > 0.5


def test_image_of_the_next_frame(benchmark: BenchmarkFixture, renderer: Renderer) -> None:
    """One image at a new time: the meshes have moved."""
    times = iter(range(1, 100_000))
    image = benchmark(lambda: renderer.render(1e-3 * next(times), Viewpoint.on_axis(0.0)))
    assert np.ptp(image) > 0.5
