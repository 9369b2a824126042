from __future__ import annotations

import cv2
import imageio.v3 as imageio
import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from tests.export.conftest import Export
from tests.export.readers import read_flo, sampled


def test_flow_is_the_displacement_to_the_next_frame(export: Export, truth: xr.Dataset) -> None:
    done = export("flo")
    # Three cameras, and the last of three frames has no flow.
    assert sorted(name for name in done.files if name.endswith(".flo")) == sorted(
        f"flow/s{s:+d}_t{t:+d}.flo" for s in (-1, 0, 1) for t in (-1, 0)
    )
    for s in (-1, 0, 1):
        file = done.folder / "flow" / f"s{s:+d}_t+0.flo"
        expected = np.moveaxis(truth.flow_next.sel(s=s, t=0).values, 0, -1)
        missing = np.isnan(expected).any(axis=-1)
        assert 0 < missing.sum() < missing.size / 2
        for found in (read_flo(file), cv2.readOpticalFlow(str(file))):
            np.testing.assert_array_equal(found[~missing], expected[~missing].astype(np.float32))
            assert (found[missing] > 1e9).all()


def test_the_next_image_at_the_flow_is_this_image(export: Export, truth: xr.Dataset) -> None:
    done = export("flo", image_bits=16)
    first, second = (imageio.imread(done.folder / f"images/s+0_t{t:+d}.png") / 65535 for t in (0, 1))
    flow = read_flo(done.folder / "flow/s+0_t+0.flo")
    y, x = np.mgrid[:48, :64].astype(float)
    there = truth.boundary_distance.sel(s=0, t=0).values > 3
    fits = there & truth.visible.sel(s=0, t=1).values
    warped = sampled(second, x + np.where(fits, flow[..., 0], 0), y + np.where(fits, flow[..., 1], 0))
    fits &= np.isfinite(warped) & ~_near_edges_of_next(truth, x + flow[..., 0], y + flow[..., 1])
    error = (warped - first)[fits]
    still = (second - first)[fits]
    assert fits.sum() > 600
    # The cubic leaves a few thousandths of a texture with waves of five pixels and more (measured: 0.0004 rms, 0.0024
    # at most). Without the flow, images differ by 0.08 rms; at dx/dt, which is no displacement, the tile by 0.036.
    assert np.abs(error).max() < 0.005
    assert np.sqrt((error**2).mean()) < 0.001
    assert np.sqrt((still**2).mean()) > 0.05
    steady = truth.flow.sel(s=0, t=0).values
    elsewhere = sampled(second, x + np.where(fits, steady[0], 0), y + np.where(fits, steady[1], 0)) - first
    assert np.sqrt((elsewhere[fits & (truth.object_id.sel(s=0, t=0).values == 1)] ** 2).mean()) > 0.02


def _near_edges_of_next(truth: xr.Dataset, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    distance = truth.boundary_distance.sel(s=0, t=1).values
    column = np.clip(np.rint(np.nan_to_num(x, posinf=0)), 0, 63).astype(int)
    row = np.clip(np.rint(np.nan_to_num(y, posinf=0)), 0, 47).astype(int)
    return np.asarray(distance[row, column] <= 3)


def test_instantaneous_flow_is_asked_for_and_told(export: Export, truth: xr.Dataset) -> None:
    done = export("flo", flow="instantaneous")
    found = read_flo(done.folder / "flow/s+0_t+0.flo")
    expected = np.moveaxis(truth.flow.sel(s=0, t=0).values, 0, -1).astype(np.float32)
    known = np.isfinite(expected).all(axis=-1)
    np.testing.assert_array_equal(found[known], expected[known])
    # Along a curved path they differ by far more than float32 holds.
    assert np.abs(expected - np.moveaxis(truth.flow_next.sel(s=0, t=0).values, 0, -1))[known].max() > 0.1
    assert "instantaneous" in done.notes[0]
    assert "instantaneous" in (done.folder / "export.json").read_text()


def test_a_part_of_the_pixels_counts_in_its_own_columns(
    recording: xr.Dataset, truth: xr.Dataset, tmp_path: pytest.TempPathFactory
) -> None:
    part = {"x": slice(10, None, 2), "y": slice(4, None, 2)}
    done = st.export((recording.isel(part), truth.isel(part)), "flo", output=f"{tmp_path}/part")
    found = read_flo(done.folder / "flow/s+0_t+0.flo")
    expected = np.moveaxis(truth.isel(part).flow_next.sel(s=0, t=0).values, 0, -1) / 2
    known = np.isfinite(expected)
    np.testing.assert_array_equal(found[known], expected[known].astype(np.float32))
