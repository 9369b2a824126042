from __future__ import annotations

import json

import numpy as np
import OpenEXR
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.schema import COMPONENTS
from tests.export.conftest import Export

IDS = ("object_id", "face_id")


def test_every_map_is_there_with_its_components(export: Export, recording: xr.Dataset, truth: xr.Dataset) -> None:
    done = export("exr")
    assert len(done.files) == 9
    file = OpenEXR.File(str(done.folder / "s+1_t-1.exr"), separate_channels=True)
    found = {name: channel.pixels for name, channel in file.channels().items()}
    np.testing.assert_array_equal(found.pop("Y"), recording.image.sel(s=1, t=-1).values.astype(np.float32))
    names = set(truth.data_vars) - {"visible", "camera_position_mm", "camera_rotation_rad", "image_time_s"}
    assert {name.split(".")[0] for name in found} == names
    for name, values in found.items():
        variable, label = name.split(".")
        expected = truth[variable].sel(s=1, t=-1)
        for dim in set(expected.dims) & set(COMPONENTS):
            expected = expected.isel({dim: list(map(str, COMPONENTS[dim])).index(label)})
        if variable in IDS:
            np.testing.assert_array_equal(values.astype(int) - 1, expected.values)
            assert (values == 0).any()
        else:
            np.testing.assert_array_equal(values, expected.values.astype(values.dtype))
    assert {"depth.Z", "velocity.Y", "flow_next.x", "normal.Z", "principal_growth_rates.2", "object_id.V"} <= set(found)
    assert np.isnan(found["depth.Z"]).any()


def test_units_and_intrinsics_are_in_the_header(recording: xr.Dataset, truth: xr.Dataset, tmp_path: str) -> None:
    part = {"x": slice(4, None, 2), "y": slice(6, None, 2)}
    done = st.export(
        (recording.isel(part), truth.isel(part)), "exr", output=f"{tmp_path}/exr", layers=["depth", "flow"]
    )
    file = OpenEXR.File(str(done.folder / "s+0_t+0.exr"), separate_channels=True)
    assert set(file.channels()) == {"Y", "depth.Z", "flow.x", "flow.y"}
    header = file.header()
    assert json.loads(header["units"]) == {"depth": "mm", "flow": "px/frame"}
    grid = [header[name] for name in ("first_column_px", "first_row_px", "step_px", "focal_length_px")]
    assert grid == [4, 6, 2, 80]


def test_colours_are_named_red_green_blue(tmp_path: str) -> None:
    images = np.random.default_rng(0).random((2, 1, 6, 8, 3)).astype(np.float32)
    recording = st.make_recording(images, focal_length_px=50, baseline_mm=2)
    estimate = st.make_estimate(depth=np.full((1, 6, 8), 90.0), recording=recording)
    done = st.export((recording, estimate), "exr", output=f"{tmp_path}/exr")
    file = OpenEXR.File(str(done.folder / "s+0_t+0.exr"), separate_channels=True)
    for index, name in enumerate("RGB"):
        np.testing.assert_array_equal(file.channels()[name].pixels, images[0, 0, :, :, index])


def test_a_map_that_is_not_there_is_refused(export: Export) -> None:
    with pytest.raises(st.ExportError, match=r"layers: is not a map of the data; available maps are depth, .*'shape'"):
        export("exr", layers=["depth", "shape"])
