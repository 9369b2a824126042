"""Plain archives and images, OpenEXR, flow and PFM files, read back by other means."""

from __future__ import annotations

import json

import cv2
import imageio.v3 as imageio
import numpy as np
import OpenEXR
import pytest
import tifffile
import xarray as xr

import scenetruth as st
from scenetruth.schema import COMPONENTS
from tests.helpers.exported_scene import Export
from tests.helpers.format_readers import opencv_image, read_flo, read_pfm, read_settings, sampled


@pytest.mark.parametrize("compress", [True, False])
def test_archives_hold_every_variable(export: Export, recording: xr.Dataset, truth: xr.Dataset, compress: bool) -> None:
    done = export("npz", compress=compress)
    for name, dataset in (("recording", recording), ("truth", truth)):
        with np.load(done.folder / f"{name}.npz") as found:
            assert set(found) == {"meta", *map(str, dataset.variables)}
            for key, item in dataset.variables.items():
                np.testing.assert_array_equal(found[str(key)], item.values)
                assert found[str(key)].dtype.kind in "fiubU"
            meta = json.loads(str(found["meta"]))
    assert meta["variables"]["flow_next"] == {
        "dims": ["image_component", "s", "t", "y", "x"],
        "units": "px",
        "long_name": "where the surface point is in the camera's image of t + 1, minus the pixel",
    }
    assert meta["attributes"]["focal_length_px"] == 80
    assert meta["attributes"]["principal_point_px"] == [31.5, 23.5]


def test_images_as_16_bit_png_and_float_tiff(export: Export, recording: xr.Dataset) -> None:
    png, tiff = export("png"), export("tiff")
    assert len(png.files) == len(tiff.files) == 9
    for s, t in ((-1, 0), (1, 1)):
        expected = recording.image.sel(s=s, t=t).values
        values = opencv_image(png.folder / "images" / f"s{s:+d}_t{t:+d}.png")
        assert values.dtype == np.uint16
        assert np.abs(values / 65535 - expected).max() <= 0.5 / 65535 + 1e-7
        np.testing.assert_array_equal(imageio.imread(tiff.folder / "images" / f"s{s:+d}_t{t:+d}.tiff"), expected)


def test_colours_are_written_as_far_as_formats_take_them(tmp_path: str) -> None:
    images = np.random.default_rng(0).random((2, 1, 6, 8, 3)).astype(np.float32)
    recording = st.make_recording(images, focal_length_px=50, baseline_mm=2)
    estimate = st.make_estimate(depth=np.full((1, 6, 8), 90.0), recording=recording)
    with pytest.raises(st.ExportError, match=r"image: has colours.*use tiff"):
        st.export((recording, estimate), "png", output=f"{tmp_path}/png")
    with pytest.raises(st.ExportError, match="image_bits: must be 8 for colours"):
        st.export((recording, estimate), "pfm", output=f"{tmp_path}/pfm", image_bits=16)
    done = st.export((recording, estimate), "tiff", output=f"{tmp_path}/tiff")
    np.testing.assert_array_equal(imageio.imread(done.folder / "images" / "s+0_t+0.tiff"), images[0, 0])
    # Five channels are one page, not six pages of rows.
    many = st.make_recording(np.repeat(images[..., :1], 5, axis=-1), focal_length_px=50, baseline_mm=2)
    done = st.export((many, estimate), "tiff", output=f"{tmp_path}/many")
    with tifffile.TiffFile(done.folder / "images" / "s+0_t+0.tiff") as file:
        assert [page.shape for page in file.pages] == [(6, 8, 5)]
    done = st.export((recording, estimate), "pfm", output=f"{tmp_path}/pfm")
    found = imageio.imread(done.folder / "t+0" / "im0.png")
    assert np.abs(found / 255 - images[0, 0]).max() <= 0.5 / 255 + 1e-6


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


F, BASELINE = 80.0, 4.0


def test_disparity_and_depth_of_both_cameras(export: Export, truth: xr.Dataset) -> None:
    done = export("pfm")
    for t in (-1, 0, 1):
        for number, s in enumerate((0, 1)):
            depth = truth.depth.sel(s=s, t=t).values
            missing = np.isnan(depth)
            assert missing.any()
            place = done.folder / f"t{t:+d}"
            for name, expected in ((f"disp{number}", F * BASELINE / depth), (f"depth{number}", depth)):
                found = read_pfm(place / f"{name}.pfm")
                assert np.isposinf(found[missing]).all()
                # Float32 holds 6e-8 of the value.
                np.testing.assert_allclose(found[~missing], expected[~missing], rtol=6e-8)
                np.testing.assert_array_equal(found, opencv_image(place / f"{name}.pfm"))


def test_calibration_gives_the_depth(export: Export, truth: xr.Dataset) -> None:
    done = export("pfm", left=-1)
    told = read_settings(done.folder / "t+0" / "calib.txt")
    f, c_x = (float(told["cam0"].strip("[]").replace(";", "").split()[index]) for index in (0, 2))
    disparity = read_pfm(done.folder / "t+0" / "disp0.pfm")
    depth = float(told["baseline"]) * f / (disparity + float(told["doffs"]))
    expected = truth.depth.sel(s=-1, t=0).values
    known = np.isfinite(expected)
    np.testing.assert_allclose(depth[known], expected[known], rtol=1.2e-7)
    assert (c_x, told["width"], told["height"]) == (31.5, "64", "48")
    # Middlebury: a conservative bound, so that every disparity is below it.
    assert disparity[known].max() < int(told["ndisp"]) < disparity[known].max() + 3


def test_the_right_image_at_the_disparity_is_the_left_one(export: Export, truth: xr.Dataset) -> None:
    done = export("pfm", image_bits=16)
    left, right = (imageio.imread(done.folder / "t+0" / f"im{number}.png") / 65535 for number in (0, 1))
    disparity = read_pfm(done.folder / "t+0" / "disp0.pfm")
    y, x = np.mgrid[:48, :64].astype(float)
    near = truth.boundary_distance.sel(s=0, t=0).values <= 3
    seen = truth.visible.sel(s=1, t=0).values & ~near
    column = np.clip(np.rint(x - np.where(seen, disparity, 0)), 0, 63).astype(int)
    seen &= truth.boundary_distance.sel(s=1, t=0).values[y.astype(int), column] > 3
    warped = sampled(right, np.where(seen, x - disparity, -9), y)
    seen &= np.isfinite(warped)
    assert seen.sum() > 600
    error = (warped - left)[seen]
    # As for the flow, what the cubic leaves of the texture (measured: 0.0012 rms, 0.004 at most; unmoved: 0.18 rms).
    assert np.abs(error).max() < 0.008
    assert np.sqrt((error**2).mean()) < 0.0025
    assert np.sqrt(((right - left)[seen] ** 2).mean()) > 0.1
