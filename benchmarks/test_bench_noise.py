"""How long noise textures take: to make one, and to look it up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from scenetruth.scene import load_scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.texture.band_limited_noise import BandLimitedNoise, make_band_limited_noise
from scenetruth.scene.texture.texture_kernels import spline_lookup

CUBE = load_scene(Path(__file__).parents[1] / "scenes" / "cube.yaml")
WAVELENGTH_MM = (0.8, 4.0)


def make_noise(size_mm: tuple[float, float]) -> BandLimitedNoise:
    return make_band_limited_noise(WAVELENGTH_MM, size_mm, np.random.default_rng(1))


@pytest.mark.parametrize("edge_mm", [50.0, 200.0])
def test_noise_of_a_square(benchmark: BenchmarkFixture, edge_mm: float) -> None:
    """Noise from 0.8 to 4 mm; 200 mm is close to the largest raster."""
    noise = benchmark.pedantic(make_noise, args=((edge_mm, edge_mm),), rounds=3, warmup_rounds=1)
    assert abs(float(noise.values.std()) - 1) < 1e-3


def test_world_of_the_cube(benchmark: BenchmarkFixture) -> None:
    """Mesh and texture of the cube, whose six sides have places of their own in one texture."""
    world = benchmark.pedantic(build_scene, args=(CUBE,), rounds=3, warmup_rounds=1)
    assert len(world.bodies) == 1


def test_lookup_of_a_million_points(benchmark: BenchmarkFixture) -> None:
    """Evaluate the spline at random points."""
    noise = make_noise((50.0, 50.0))
    uv = np.random.default_rng(2).uniform(-1, 2, (1_000_000, 2))
    spline_lookup(noise.coefficients, uv)  # compiles the kernel
    values = benchmark(spline_lookup, noise.coefficients, uv)
    assert np.isfinite(values).all()
