"""The key of a recording: the same wherever it comes from, another for whatever a method could see."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators.external import recording_key

Make = Callable[..., xr.Dataset]


def test_neither_attributes_nor_the_way_here_count(simulated: xr.Dataset, tmp_path: Path) -> None:
    key = recording_key(simulated)
    st.save_store(simulated, tmp_path / "recording.zarr")
    assert recording_key(st.open_store(tmp_path / "recording.zarr", kind="recording")) == key
    attrs = simulated.attrs
    own = st.make_recording(
        simulated["image"].values,
        attrs["focal_length_px"],
        attrs["baseline_mm"],
        principal_point_px=attrs["principal_point_px"],
        frame_interval_s=attrs["frame_interval_s"],
        full_scale=attrs["full_scale"],
    )
    assert recording_key(own) == key
    assert len(key) == 16
    assert int(key, 16) >= 0


def test_the_order_of_bytes_does_not_count(recording_of: Make) -> None:
    recording = recording_of(np.uint16, 0, 4095)
    turned = recording.assign(image=recording["image"].astype(recording["image"].dtype.newbyteorder("S")))
    assert recording_key(turned) == recording_key(recording)


def one_pixel(recording: xr.Dataset) -> xr.Dataset:
    changed = recording.copy(deep=True)
    changed["image"][1, 2, 35, 47] += 1
    return changed


CHANGES = {
    "one pixel": one_pixel,
    "focal length": lambda recording: recording.assign_attrs(focal_length_px=81.0),
    "full scale": lambda recording: recording.assign_attrs(full_scale=256.0),
    "distortion": lambda recording: recording.assign_attrs(distortion=[0.1] + 7 * [0.0]),
    "crop": lambda recording: recording.isel(x=slice(1, None)),
    "moved crop": lambda recording: recording.assign_coords(x=recording["x"] + 1),
    "frames": lambda recording: recording.isel(t=slice(1, None)),
    "stage": lambda recording: recording.assign_coords(stage_x_mm=recording["stage_x_mm"] + 1),
    "mask": lambda recording: recording.assign(exclusion_mask=(("y", "x"), np.eye(36, 48) > 0)),
    "type": lambda recording: recording.assign(image=recording["image"].astype(np.uint16)),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES.keys())
def test_everything_that_a_method_sees_counts(change: Callable[[xr.Dataset], xr.Dataset], recording_of: Make) -> None:
    recording = recording_of(np.uint8, 0, 200)
    assert recording_key(change(recording)) != recording_key(recording)
