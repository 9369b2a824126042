"""A run whose stores are zip files, and whose truth is narrow."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.simulation import simulate_into
from scenetruth.truth import TruthOptions
from tests.helpers.scenes import cube

SMALL = {
    "camera": {"width": 48, "height": 40, "focal_length_px": 700},
    "frames": {"count": 5},
    "render": {"backend": "raycast"},
}
PACKED = {"storage": {"form": "zip", "truth": "float32"}}


def test_all_stores_of_a_run_are_zip_files(tmp_path: Path) -> None:
    results = st.run_scene(cube(**SMALL, **PACKED), output=tmp_path / "x", stages=("render", "estimate", "score"))
    names = {"scene.yaml", "recording.zarr.zip", "truth.zarr.zip", "estimate.zarr.zip", "score.csv", "score.json"}
    assert {path.name for path in (tmp_path / "x").iterdir()} == names
    assert {verdict.problem for verdict in st.verify(tmp_path / "x")} == {""}
    assert st.RunDirectory(tmp_path / "x").estimated() == ["structure_tensor"]
    assert not results.failures
    with pytest.raises(st.OutputExistsError):
        st.run_scene(cube(**SMALL, **PACKED), output=tmp_path / "x", stages=("render",))
    st.run_scene(cube(**SMALL), output=tmp_path / "x", stages=("render",), overwrite=True)
    assert {path.name for path in (tmp_path / "x").iterdir()} == {"scene.yaml", "recording.zarr", "truth.zarr"}


def streamed_simulation(
    scene: st.Scene, folder: Path, truth: TruthOptions, *, save_radiance: bool = False
) -> tuple[xr.Dataset, xr.Dataset]:
    """Recording and truth that were written image by image."""
    folder.mkdir()
    simulate_into(folder, scene, truth, save_radiance=save_radiance)
    recording, measured = (next(folder.glob(f"{name}.zarr*")) for name in ("recording", "truth"))
    return st.open_store(recording), st.open_store(measured)


def test_what_is_streamed_is_what_is_kept_in_memory(tmp_path: Path) -> None:
    scene = cube(**SMALL)
    kept = st.simulate(scene, truth_views="all", truth_content="complete", save_radiance=True)
    streamed = streamed_simulation(scene, tmp_path / "x", TruthOptions("all", "actual", "complete"), save_radiance=True)
    for one, other in zip(kept, streamed, strict=True):
        xr.testing.assert_identical(other.load(), one)


def test_a_narrow_truth_is_the_truth_rounded(tmp_path: Path) -> None:
    scene = cube(**SMALL, **PACKED)
    _, wide = st.simulate(scene)
    _, narrow = streamed_simulation(scene, tmp_path / "x", TruthOptions("reference", "actual", "standard"))
    assert {str(narrow[name].dtype) for name in ("depth", "velocity", "flow", "disparity")} == {"float32"}
    for name, item in wide.data_vars.items():
        expected = item.values.astype(np.float32) if "y" in item.dims and item.dtype == np.float64 else item.values
        assert narrow[name].values.tobytes() == expected.tobytes(), name
        assert narrow[name].attrs == item.attrs
    # What is in memory stays exact, and the images do not depend on how they are stored.
    assert wide["depth"].dtype == np.float64
    assert wide.attrs["scene_hash"] == st.simulate(cube(**SMALL))[1].attrs["scene_hash"]
