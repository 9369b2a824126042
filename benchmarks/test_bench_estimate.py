"""How long one estimate takes beside a plain reading of the method, and how time and memory grow with the image."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

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
ONE_POINT: dict[str, Any] = {"working_point_px": 37, "flow_working_point_px": (0, 0)}


@pytest.fixture(scope="module")
def recording() -> xr.Dataset:
    """Return the recording of the cube, rendered with one ray per pixel to be quick."""
    made, _ = simulate(load_scene(SCENE, ["render.backend=raycast", "render.supersampling=1"]))
    return made


@pytest.mark.parametrize(
    "settings",
    [ONE_POINT, {"working_point_px": "auto"}, {}, {"pyramid_levels": 1}],
    ids=["given", "auto", "per pixel", "coarse to fine"],
)
def test_structure_tensor(benchmark: BenchmarkFixture, recording: xr.Dataset, settings: dict[str, Any]) -> None:
    """Depth and motion with their error bars of the middle frame, for every way to choose working points."""
    assert recording["image"].shape == (5, 9, 480, 640)
    result = benchmark.pedantic(estimate, args=(recording,), kwargs=settings, rounds=7, warmup_rounds=1)
    assert result.sizes["t"] == 1
    assert np.isfinite(result["depth"]).mean() > 0.1


def test_plain_reading(benchmark: BenchmarkFixture, recording: xr.Dataset) -> None:
    """The same at one working point and without error bars by NumPy and SciPy, as the tests read the method."""
    settings = EstimateSettings(working_point_px=37)
    result = benchmark.pedantic(estimate_plain, args=(recording, settings), rounds=3)
    kernels = estimate(recording, **ONE_POINT).isel(t=0)
    inner = kernels.isel(y=slice(14, -14), x=slice(2 * 37 + 14, -2 * 37 - 14))
    both = (inner["kind"].values == 2) & (result["above"] >= 3)
    assert np.abs(inner["disparity"].values - result["disparity"])[both].max() < 1e-3


@pytest.mark.parametrize(("width", "height"), [(320, 240), (640, 480), (2048, 1536), (4096, 3072)])
def test_time_per_pixel(
    benchmark: BenchmarkFixture, capsys: pytest.CaptureFixture[str], width: int, height: int
) -> None:
    """Random images of several sizes: time per pixel, and the memory beyond images and results."""
    images = np.random.default_rng(0).integers(0, 255, (5, 9, height, width), dtype=np.uint8)
    recording = make_recording(images, 5016.0, 5.0)
    settings = {"working_point_px": 0, "flow_working_point_px": (0, 0), "tau": 0.0}
    result = benchmark.pedantic(estimate, args=(recording,), kwargs=settings, rounds=5, warmup_rounds=1)
    per_pixel = benchmark.stats["median"] / (width * height) * 1e9
    scratch = _peak_memory(lambda: estimate(recording, **settings)) - result.nbytes
    benchmark.extra_info |= {"ns_per_pixel": per_pixel, "scratch_mb": scratch / 1e6}
    with capsys.disabled():
        print(f"\n{width} x {height}: {per_pixel:.0f} ns per pixel, peak scratch {scratch / 1e6:.0f} MB")
    assert result.sizes["t"] == 1


def _peak_memory(work: Any) -> int:
    """Return by how many bytes the process's resident memory rises at most while it works (Linux)."""
    # What the allocator still holds would hide what is needed.
    ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")
    before = _status("VmRSS")
    kept = work()
    del kept
    return _status("VmHWM") - before


def _status(name: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(name))
