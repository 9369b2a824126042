"""How long one estimate takes beside a plain reading of the method, and how time and memory grow with the image."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from pytest_benchmark.fixture import BenchmarkFixture

from scenetruth.estimators import estimate
from scenetruth.estimators.method_settings import StructureTensorSettings
from scenetruth.scene import load_scene
from scenetruth.schema import make_recording
from scenetruth.simulation import simulate
from tests.helpers.plain_structure_tensor import estimate_plain

SCENE = Path(__file__).parents[1] / "scenes" / "cube.yaml"
ONE_POINT: dict[str, Any] = {"working_point_px": 37, "flow_working_point_px": (0, 0)}
RANDOM: dict[str, Any] = {"working_point_px": 0, "flow_working_point_px": (0, 0), "tau": 0.0}
# Parameters of mallopt (malloc.h).
_TRIM_THRESHOLD, _MMAP_MAX = -1, -4


@pytest.fixture(scope="module")
def recording() -> xr.Dataset:
    """Return the recording of the cube, rendered with one ray per pixel to be quick."""
    made, _ = simulate(load_scene(SCENE, overrides=["render.backend=raycast", "render.supersampling=1"]))
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
    settings = StructureTensorSettings(working_point_px=37)
    result = benchmark.pedantic(estimate_plain, args=(recording, settings), rounds=3)
    kernels = estimate(recording, **ONE_POINT).isel(t=0)
    inner = kernels.isel(y=slice(14, -14), x=slice(2 * 37 + 14, -2 * 37 - 14))
    both = (inner["status"].values == 2) & (result["above"] >= 3)
    assert np.abs(inner["disparity"].values - result["disparity"])[both].max() < 1e-3


SIZES = ((320, 240), (640, 480), (2048, 1536), (4096, 3072))


@pytest.fixture
def kept_memory() -> Iterator[None]:
    """Let the allocator keep what it has had: a virtual machine may take seconds to supply memory anew."""
    libc = ctypes.CDLL(None)
    libc.mallopt(_MMAP_MAX, 0)
    libc.mallopt(_TRIM_THRESHOLD, 2**31 - 1)
    yield
    libc.mallopt(_MMAP_MAX, 65536)
    libc.mallopt(_TRIM_THRESHOLD, 128 * 1024)


@pytest.mark.usefixtures("kept_memory")
def test_time_per_pixel(benchmark: BenchmarkFixture, capsys: pytest.CaptureFixture[str]) -> None:
    """Random images of several sizes in turn, each for about as long: time per pixel."""
    generator = np.random.default_rng(0)
    recordings = [
        make_recording(generator.integers(0, 255, (5, 9, height, width), dtype=np.uint8), 5016.0, 5.0)
        for width, height in SIZES
    ]
    repeats = (40, 12, 2, 1)
    seconds: list[list[float]] = [[] for _ in SIZES]

    def every_size() -> None:
        for recording, repeat, times in zip(recordings, repeats, seconds, strict=True):
            for _ in range(repeat):
                start = time.perf_counter()
                estimate(recording, **RANDOM)
                times.append(time.perf_counter() - start)

    every_size()
    for times in seconds:
        times.clear()
    benchmark.pedantic(every_size, rounds=7)
    per_pixel = [np.quantile(t, 0.5) / (w * h) * 1e9 for (w, h), t in zip(SIZES, seconds, strict=True)]
    benchmark.extra_info["ns_per_pixel"] = per_pixel
    with capsys.disabled():
        for (width, height), value in zip(SIZES, per_pixel, strict=True):
            print(f"\n{width} x {height}: {value:.0f} ns per pixel", end="")
        print(f"\nlargest over least: {max(per_pixel) / min(per_pixel):.2f}")


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_scratch(benchmark: BenchmarkFixture, capsys: pytest.CaptureFixture[str], width: int, height: int) -> None:
    """One estimate of random images in fresh memory; prints the memory beyond images and results."""
    images = np.random.default_rng(0).integers(0, 255, (5, 9, height, width), dtype=np.uint8)
    recording = make_recording(images, 5016.0, 5.0)
    result = benchmark.pedantic(estimate, args=(recording,), kwargs=RANDOM, rounds=2)
    scratch = _peak_memory(lambda: estimate(recording, **RANDOM)) - result.nbytes
    with capsys.disabled():
        print(f"\n{width} x {height}: peak scratch {scratch / 1e6:.0f} MB")
    assert scratch < 512e6


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
