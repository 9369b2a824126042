"""Attributes of data sets, and their way through netCDF files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import gaussian_filter

import scenetruth as st
from scenetruth.estimators import list_methods
from scenetruth.schema import flat_attributes
from tests.helpers.scenes import cube


def through_netcdf(dataset: xr.Dataset, folder: Path) -> xr.Dataset:
    dataset.to_netcdf(folder / "written.nc", engine="scipy")
    with xr.open_dataset(folder / "written.nc", engine="scipy") as opened:
        return opened.load()


def assert_same(read: xr.Dataset, written: xr.Dataset) -> None:
    assert set(read.variables) == set(written.variables)
    for name, variable in written.variables.items():
        assert read[name].dims == variable.dims
        np.testing.assert_array_equal(read[name].values, variable.values, err_msg=str(name))
    assert set(read.attrs) == set(written.attrs)
    for name, value in written.attrs.items():
        np.testing.assert_array_equal(read.attrs[name], value, err_msg=str(name))


@pytest.fixture(scope="module")
def recording() -> xr.Dataset:
    texture = gaussian_filter(np.random.default_rng(0).standard_normal((80, 90)), 1.5)
    images = [[texture[10 : 50 + t, 10 + s : 66 + s][t:] for t in range(3)] for s in range(3)]
    return st.make_recording(
        np.asarray(images, dtype=np.float32), focal_length_px=1000, baseline_mm=1.0, attrs={"seed": 3}
    )


@pytest.mark.parametrize("method", [entry.name for entry in list_methods()])
def test_the_estimate_of_every_built_in_method_passes_through_netcdf(
    method: str, recording: xr.Dataset, tmp_path: Path
) -> None:
    found = st.estimate(recording, method)
    read = through_netcdf(found, tmp_path)
    assert_same(read, found)
    st.save_store(found, tmp_path / "stored.zarr")
    # Stores return the same attributes as netCDF.
    assert_same(st.load_store(tmp_path / "stored.zarr"), found)


def test_attributes_that_a_method_gives_nested_are_read_back_from_json(recording: xr.Dataset, tmp_path: Path) -> None:
    nested: dict[str, Any] = {
        "pairs": [[1, 2], [3, 4]],
        "none": [],
        "counts": {"dead": np.int64(2), "areas": np.arange(2)},
        "words": ["a", "b"],
        "nothing": None,
    }

    def mine(recording: xr.Dataset) -> xr.Dataset:
        made = st.make_estimate(recording=recording, disparity=np.ones((40, 56)))
        return made.assign_attrs(nested, plain=[1.5, 2.5], matrix=np.eye(2))

    read = through_netcdf(st.estimate(recording, mine), tmp_path).attrs
    assert {name: json.loads(read[name]) for name in nested} == {**nested, "counts": {"dead": 2, "areas": [0, 1]}}
    assert json.loads(read["matrix"]) == [[1, 0], [0, 1]]
    assert list(read["plain"]) == [1.5, 2.5]


def test_numbers_and_texts_stay_as_they_are() -> None:
    attrs = {"text": "a", "number": 2, "exact": 0.1, "flags": [True, False], "array": np.arange(3)}
    assert all(flat_attributes(attrs)[name] is value for name, value in attrs.items())


def test_simulated_data_pass_through_netcdf(tmp_path: Path) -> None:
    recording, truth = st.simulate(cube(camera={"width": 40, "height": 36, "focal_length_px": 600}))
    recording = recording.assign(image=recording["image"].astype(np.float32))
    found = st.estimate(recording)
    for dataset in (recording, truth, found):
        assert_same(through_netcdf(dataset, tmp_path), dataset)


def test_images_of_8_bits_pass_through_netcdf_in_the_documented_way(tmp_path: Path) -> None:
    images = np.random.default_rng(0).integers(0, 256, (2, 2, 30, 40)).astype(np.uint8)
    recording = st.make_recording(images, focal_length_px=500, baseline_mm=5)
    recording.to_netcdf(tmp_path / "written.nc", engine="scipy", encoding={"image": {"dtype": "int32"}})
    with xr.open_dataset(tmp_path / "written.nc", engine="scipy") as opened:
        np.testing.assert_array_equal(opened["image"].values, images)
