"""How long one estimate takes from five cameras and nine frames of 640 x 480 pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from pytest_benchmark.fixture import BenchmarkFixture

from scenetruth.estimate import estimate
from scenetruth.scene import load_scene
from scenetruth.simulate import simulate

SCENE = Path(__file__).parents[1] / "scenes" / "cube.yaml"


@pytest.fixture(scope="module")
def recording() -> xr.Dataset:
    """Return the recording of the cube, rendered with one ray per pixel to be quick."""
    made, _ = simulate(load_scene(SCENE, ["render.backend=raycast", "render.supersampling=1"]))
    return made


def test_structure_tensor(benchmark: BenchmarkFixture, recording: xr.Dataset) -> None:
    """Depth and motion of the middle frame, the working point found from the images."""
    assert recording["image"].shape == (5, 9, 480, 640)
    result = benchmark.pedantic(estimate, args=(recording,), rounds=5, warmup_rounds=1)
    assert result.sizes["t"] == 1
    assert np.isfinite(result["depth"]).mean() > 0.1
