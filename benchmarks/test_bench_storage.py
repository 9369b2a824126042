"""How long stores take to be written and read."""

from __future__ import annotations

from pathlib import Path

import pytest
import xarray as xr
from pytest_benchmark.fixture import BenchmarkFixture

from scenetruth.scene import load_scene
from scenetruth.simulation import simulate
from scenetruth.storage import load_store, save_store

SCENE = Path(__file__).parents[1] / "scenes" / "cube.yaml"


@pytest.fixture(scope="module")
def made() -> dict[str, xr.Dataset]:
    """Return recording (13.8 MB) and truth (246 MB) of the cube."""
    recording, truth = simulate(load_scene(SCENE, overrides=["render.backend=raycast", "render.supersampling=1"]))
    return {"recording": recording, "truth": truth}


@pytest.mark.parametrize("kind", ["recording", "truth"])
def test_write(benchmark: BenchmarkFixture, made: dict[str, xr.Dataset], kind: str, tmp_path: Path) -> None:
    store = tmp_path / f"{kind}.zarr"
    benchmark.pedantic(save_store, args=(made[kind], store), kwargs={"overwrite": True}, rounds=3, warmup_rounds=1)
    assert store.is_dir()


@pytest.mark.parametrize("kind", ["recording", "truth"])
def test_read(benchmark: BenchmarkFixture, made: dict[str, xr.Dataset], kind: str, tmp_path: Path) -> None:
    store = tmp_path / f"{kind}.zarr"
    save_store(made[kind], store)
    result = benchmark.pedantic(load_store, args=(store,), rounds=3, warmup_rounds=1)
    assert result.equals(made[kind])
