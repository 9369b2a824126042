"""What programs are given: images to the bit or to the stated step, numbers that fit them, and nothing of the scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators.estimation import is_in_memory
from scenetruth.estimators.external import write_recording
from tests.helpers.exchange_folders import camera_in, images_in, masks_in

pytest.importorskip("cv2")

Make = Callable[..., xr.Dataset]
FORMS = ("png", "tiff", "npy")
DIGITAL = [
    pytest.param(np.uint8, 0, 255, id="8 bit"),
    pytest.param(np.uint16, 0, 4095, id="12 bit"),
    pytest.param(np.uint16, 0, 65535, id="16 bit"),
    pytest.param(np.int16, -300, 30_000, id="negative"),
    pytest.param(np.int32, 1_000_000, 1_050_000, id="far from zero"),
]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("dtype", "low", "high"), DIGITAL)
def test_digital_numbers_are_written_as_they_are(
    dtype: Any, low: float, high: float, form: Literal["png", "tiff", "npy"], recording_of: Make, tmp_path: Path
) -> None:
    recording = recording_of(dtype, low, high)
    write_recording(recording, tmp_path / "in", form)
    assert np.array_equal(images_in(tmp_path / "in"), recording["image"].values)
    assert camera_in(tmp_path / "in")["image_scale"] == 1
    if np.dtype(dtype).itemsize <= 2:
        assert camera_in(tmp_path / "in")["image_lossless"]
        assert camera_in(tmp_path / "in")["image_offset"] == (min(low, 0) if form == "png" else 0)


@pytest.mark.parametrize("low", [-0.8, 0.2])
def test_floats_in_png_are_off_by_half_of_the_stated_step(low: float, recording_of: Make, tmp_path: Path) -> None:
    recording = recording_of(np.float32, low, 0.9)
    write_recording(recording, tmp_path / "in")
    camera = camera_in(tmp_path / "in")
    values = recording["image"].values.astype(np.float64)
    assert camera["image_scale"] == pytest.approx((values.max() - values.min()) / 65535)
    assert not camera["image_lossless"]
    # Half a step, and float64's rounding of offset + scale * number.
    assert np.abs(images_in(tmp_path / "in") - values).max() <= 0.5 * camera["image_scale"] * (1 + 1e-9)


@pytest.mark.parametrize("form", ["tiff", "npy"])
def test_floats_in_other_forms_are_exact(form: Literal["tiff", "npy"], recording_of: Make, tmp_path: Path) -> None:
    recording = recording_of(np.float32, -0.5, 1.0)
    write_recording(recording, tmp_path / "in", form)
    assert np.array_equal(images_in(tmp_path / "in"), recording["image"].values)
    assert camera_in(tmp_path / "in")["image_lossless"]


def test_images_of_one_value_or_none_are_written(recording_of: Make, tmp_path: Path) -> None:
    recording = recording_of(np.float32, 0.25, 0.25)
    write_recording(recording, tmp_path / "grey")
    assert np.array_equal(images_in(tmp_path / "grey"), recording["image"].values)
    unknown = recording.copy(deep=True)
    unknown["image"][:] = np.nan
    write_recording(unknown, tmp_path / "unknown")
    assert masks_in(tmp_path / "unknown").all()


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("dtype", "high"), [(np.uint8, 255), (np.uint16, 65535)])
def test_colours_are_kept(
    dtype: Any, high: int, form: Literal["png", "tiff", "npy"], recording_of: Make, tmp_path: Path
) -> None:
    recording = recording_of(dtype, 0, high, (3,))
    write_recording(recording, tmp_path / "in", form)
    assert np.array_equal(images_in(tmp_path / "in"), recording["image"].values)
    assert camera_in(tmp_path / "in")["channels"] == 3


def test_other_numbers_of_channels_go_where_they_can(recording_of: Make, tmp_path: Path) -> None:
    recording = recording_of(np.uint8, 0, 255, (5,))
    with pytest.raises(st.EstimateError, match="1 or 3 channels"):
        write_recording(recording, tmp_path / "png")
    write_recording(recording, tmp_path / "in", "npy")
    assert np.array_equal(images_in(tmp_path / "in"), recording["image"].values)
    single = recording_of(np.uint8, 0, 255, (1,))
    write_recording(single, tmp_path / "single")
    assert np.array_equal(images_in(tmp_path / "single"), single["image"].values[..., 0])


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("shape", [(36, 48), (3, 36, 48), (1, 3, 36, 48), (3, 3, 36, 48)])
def test_masks_and_values_that_are_no_numbers_are_told(
    shape: tuple[int, ...], form: Literal["png", "tiff", "npy"], recording_of: Make, tmp_path: Path
) -> None:
    mask = np.random.default_rng(3).random(shape) < 0.01
    recording = recording_of(np.float32, 0, 1, exclusion_mask=mask)
    recording["image"][0, 2, 5, 6] = np.nan
    recording["image"][2, 0, 7, 8] = np.inf
    write_recording(recording, tmp_path / "in", form)
    whole = mask[:, None] if mask.ndim == 3 else mask
    bad = np.broadcast_to(whole, (3, 3, 36, 48)) | ~np.isfinite(recording["image"].values)
    assert np.array_equal(masks_in(tmp_path / "in"), bad)
    step = camera_in(tmp_path / "in")["image_scale"]
    error = np.abs(images_in(tmp_path / "in")[~bad] - recording["image"].values[~bad])
    assert error.max() <= (step / 2 * (1 + 1e-9) if form == "png" else 0)


def test_images_without_a_mask_have_no_file_for_it(recording_of: Make, tmp_path: Path) -> None:
    write_recording(recording_of(np.uint8, 0, 255), tmp_path / "in")
    assert camera_in(tmp_path / "in")["exclusion_masks"] == []
    assert not list((tmp_path / "in").glob("mask*"))


PARTS = [
    pytest.param({}, id="whole"),
    pytest.param({"x": slice(5, 40), "y": slice(3, None)}, id="crop"),
    pytest.param({"x": slice(1, None, 2), "y": slice(4, None, 2)}, id="every second"),
    pytest.param({"t": slice(1, None), "s": slice(1, None)}, id="frames and cameras"),
]


@pytest.mark.parametrize("part", PARTS)
def test_the_camera_fits_the_images_of_a_part(part: dict[str, slice], recording_of: Make, tmp_path: Path) -> None:
    """A point is seen in the column that camera.json says, and that column has the pixel's coordinate."""
    recording = recording_of(np.uint8, 0, 255, principal_point_px=(20.25, 15.5)).isel(part)
    write_recording(recording, tmp_path / "in")
    camera = camera_in(tmp_path / "in")
    assert np.array_equal(images_in(tmp_path / "in"), recording["image"].values)
    assert (camera["height_px"], camera["width_px"]) == recording["image"].shape[2:]
    assert (camera["s"], camera["t"]) == (recording["s"].values.tolist(), recording["t"].values.tolist())
    assert camera["stage_x_mm"] == recording["stage_x_mm"].values.tolist()
    point = np.array([12.0, 7.0, 130.0])
    f, (c_x, c_y) = camera["focal_length_px"], camera["principal_point_px"]
    for stage_x in camera["stage_x_mm"]:
        column, row = f * (point[0] - stage_x) / point[2] + c_x, f * point[1] / point[2] + c_y
        x, y = 80.0 * (point[0] - stage_x) / point[2] + 20.25, 80.0 * point[1] / point[2] + 15.5
        first, step = camera["part"], camera["part"]["pixel_step_px"]
        # To rounding in float64.
        assert first["first_column_px"] + step * column == pytest.approx(x, rel=1e-12)
        assert first["first_row_px"] + step * row == pytest.approx(y, rel=1e-12)
    assert recording["x"].values[:2].tolist() == [
        camera["part"]["first_column_px"],
        camera["part"]["first_column_px"] + camera["part"]["pixel_step_px"],
    ]


def test_nothing_of_the_scene_is_written(simulated: xr.Dataset, tmp_path: Path) -> None:
    write_recording(simulated, tmp_path / "in")
    names = {f"s{s:+d}_t{t:+d}.png" for s in (-1, 0, 1) for t in (-1, 0, 1)}
    assert {path.name for path in (tmp_path / "in").iterdir()} == {*names, "camera.json"}
    told = (tmp_path / "in" / "camera.json").read_text()
    assert {"scene", "scene_hash", "recording_hash"} <= set(simulated.attrs)
    for secret in (simulated.attrs["scene_hash"], simulated.attrs["recording_hash"], "wall", "tile", "scene_", "seed"):
        assert secret not in told


@pytest.mark.parametrize("form", FORMS)
def test_a_store_is_read_frame_by_frame(
    form: Literal["png", "tiff", "npy"], simulated: xr.Dataset, tmp_path: Path
) -> None:
    st.save_store(simulated, tmp_path / "recording.zarr")
    opened = st.open_store(tmp_path / "recording.zarr", kind="recording")
    seen = []
    write_recording(opened, tmp_path / "in", form, progress=lambda *told: seen.append(told))
    assert not is_in_memory(opened.variables["image"])
    assert np.array_equal(images_in(tmp_path / "in"), simulated["image"].values)
    assert seen == [("images", done, 3) for done in (1, 2, 3)]


def test_distortion_is_told(recording_of: Make, tmp_path: Path) -> None:
    lens = [0.1, 0.0, 0.001, 0.0, 0.0, 0.0, 0.0, 0.0]
    write_recording(recording_of(np.uint8, 0, 255, attrs={"distortion": lens}), tmp_path / "in")
    assert camera_in(tmp_path / "in")["distortion_k1_k2_p1_p2_k3_k4_k5_k6"] == lens


def test_what_cannot_be_written_is_refused(recording_of: Make, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "note.txt").write_text("mine")
    with pytest.raises(st.OutputExistsError, match="not empty"):
        write_recording(recording_of(np.uint8, 0, 255), tmp_path / "full")
    with pytest.raises(st.EstimateError, match="'png' or 'tiff' or 'npy'"):
        write_recording(recording_of(np.uint8, 0, 255), tmp_path / "in", "jpeg")  # type: ignore[arg-type]
    grid = st.make_recording(np.zeros((2, 3, 3, 36, 48)), 80.0, 5.0, stage_y_mm=[0.0, 5.0])
    with pytest.raises(st.EstimateError, match=r"recording\.sel\(s_y=0\)"):
        write_recording(grid, tmp_path / "in")
    write_recording(grid.sel(s_y=[0]), tmp_path / "row")
    assert images_in(tmp_path / "row").shape == (3, 3, 36, 48)
