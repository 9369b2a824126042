"""How long one estimate takes from five cameras and nine frames of 640 x 480 pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from pytest_benchmark.fixture import BenchmarkFixture
from tests.estimate.plain import estimate_plain

from scenetruth.estimate import estimate
from scenetruth.recording import make_recording
from scenetruth.scene import load_scene
from scenetruth.settings import EstimateSettings
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


def test_plain_reading(benchmark: BenchmarkFixture, recording: xr.Dataset) -> None:
    """The same by NumPy and SciPy, as the tests read the method, with the working point given."""
    settings = EstimateSettings(working_point_px=37)
    result = benchmark.pedantic(estimate_plain, args=(recording, settings), rounds=2)
    kernels = estimate(recording, working_point_px=37).isel(t=0)
    median = np.nanmedian(kernels["disparity"].values[kernels["kind"].values == 2])
    assert abs(np.median(result["disparity"][result["above"] >= 3]) - median) < 1e-3


@pytest.mark.parametrize(("width", "height"), [(320, 240), (640, 480), (2048, 1536), (4096, 3072)])
def test_time_per_pixel(benchmark: BenchmarkFixture, width: int, height: int) -> None:
    """Random images of several sizes; divide the times by the number of pixels."""
    images = np.random.default_rng(0).integers(0, 255, (5, 9, height, width), dtype=np.uint8)
    recording = make_recording(images, 5016.0, 5.0)
    settings = {"working_point_px": 0, "tau": 0.0}
    result = benchmark.pedantic(estimate, args=(recording,), kwargs=settings, rounds=3, warmup_rounds=1)
    benchmark.extra_info["ns_per_pixel"] = benchmark.stats["median"] / (width * height) * 1e9
    assert result.sizes["t"] == 1
