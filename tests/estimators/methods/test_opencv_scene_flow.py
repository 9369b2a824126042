"""OpenCV's methods behind our contract: right sign, right units, right camera."""

from __future__ import annotations

import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators import find_method, opencv_common, prepare
from scenetruth.pipeline.runner import write_estimate
from scenetruth.storage import stored_array
from tests.helpers.analytic_plane import Plane
from tests.helpers.nightly import by_night

pytest.importorskip("cv2")

PLANE = Plane(velocity=(0.6, -0.4, 1.5), size=(120, 200), focal_length_px=1000.0, depth_mm=500.0)
BASELINE_MM = 10.0
"""20 px of disparity per step."""


@pytest.fixture(scope="module")
def recording() -> xr.Dataset:
    eight_bit = PLANE.recording([-BASELINE_MM, 0, BASELINE_MM], 3, BASELINE_MM)
    images = np.rint(255 * np.clip(eight_bit["image"].values, 0, 1)).astype(np.uint8)
    return st.make_recording(images, 1000.0, BASELINE_MM)


def inside(values: xr.DataArray) -> np.ndarray:
    """Leave out the border, which is not seen by the other camera, or has no window."""
    return np.asarray(values.values[..., 20:-20, 60:-60])


# A quarter of a pixel of disparity is what matching to sixteenths keeps on 8 bits; the bound is four times the error
# seen, and far below any slip of sign, camera or units.
@pytest.mark.parametrize("camera", [None, 1, -1])
@pytest.mark.parametrize("stereo", ["sgbm", "bm"])
def test_stereo_has_the_right_sign_with_either_neighbour(
    recording: xr.Dataset, camera: int | None, stereo: str
) -> None:
    found = st.estimate(recording, "opencv_stereo", camera=camera, stereo=stereo).sel(t=0)
    assert {"flow", "velocity"}.isdisjoint(found.data_vars)
    error = inside(found["disparity"]) - 20
    assert np.nanmedian(np.abs(error)) < 0.25
    assert np.isfinite(error).mean() > 0.9
    assert np.nanmedian(inside(found["depth"])) == pytest.approx(500, rel=0.01)


def test_disparity_is_per_step(recording: xr.Dataset) -> None:
    """Two steps apart, the images are shifted by twice the disparity."""
    images = recording["image"].values
    wide = st.make_recording(images, 1000.0, BASELINE_MM / 2, stage_x_mm=[-BASELINE_MM, 0.0, BASELINE_MM])
    found = st.estimate(wide, "opencv_stereo").sel(t=0)
    assert np.nanmedian(inside(found["disparity"])) == pytest.approx(10, abs=0.1)
    assert np.nanmedian(inside(found["depth"])) == pytest.approx(500, rel=0.01)


@pytest.mark.parametrize("flow", ["farneback", "dis"])
def test_flow_is_that_of_the_plane(recording: xr.Dataset, flow: str) -> None:
    found = st.estimate(recording, "opencv_flow", flow=flow)
    assert found["t"].values.tolist() == [-1, 0]
    error = inside(found["flow"].sel(t=0)) - PLANE.truth()["flow"][:, 20:-20, 60:-60]
    # From t to t + 1 the flow of a plane that recedes changes by 0.3 %.
    assert np.median(np.abs(error)) < 0.1


def test_windows_with_an_invalid_pixel_have_no_value(recording: xr.Dataset) -> None:
    """Blocks of 7 px, windows of 25 px; the right neighbour shows every point 20 px further to the left."""
    broken = recording.assign(image=recording["image"].astype(np.float32))
    broken["image"].values[1, 1, :5] = broken["image"].values[2, ..., :30] = np.nan
    disparity = st.estimate(broken, "opencv_stereo", camera=1).sel(t=0)["disparity"].values
    assert np.isnan(disparity[:8]).all()
    assert not (np.abs(disparity[:, : 30 + 20 + 2] - 20) < 1).any()
    assert (np.abs(disparity[8:, 30 + 20 + 5 : -10] - 20) < 1).mean() > 0.95
    before, here = (st.estimate(broken, "opencv_flow")["flow"].sel(t=t).values for t in (-1, 0))
    for flow in (before, here):
        assert np.isnan(flow[:, : 5 + 12 - 1]).all()
        assert np.isfinite(flow[:, 5 + 12 + 1 :]).all()


def test_scene_flow_gives_velocity(recording: xr.Dataset) -> None:
    found = st.estimate(recording, "opencv_scene_flow").sel(t=0)
    for component, expected, tolerance in (("X", 0.6, 0.1), ("Y", -0.4, 0.1), ("Z", 1.5, 1.5)):
        assert np.nanmedian(inside(found["velocity"].sel(component=component))) == pytest.approx(
            expected, abs=tolerance
        )


def test_parts_of_images_give_what_the_whole_gives(recording: xr.Dataset) -> None:
    """A crop keeps its principal point; of every second pixel, disparity and flow are in pixels of the camera."""
    for part in (
        recording.isel(x=slice(40, None), y=slice(10, None)),
        recording.isel(x=slice(1, None, 2), y=slice(1, None, 2)),
    ):
        found = st.estimate(part, "opencv_scene_flow").sel(t=0)
        seen = found.sel(x=slice(80, 140), y=slice(30, 90))
        expected = xr.DataArray(
            PLANE.truth()["flow"], dims=("image_component", "y", "x"), coords={"x": range(200), "y": range(120)}
        )
        assert np.nanmedian(seen["disparity"]) == pytest.approx(20, abs=0.25)
        assert np.nanmedian(seen["depth"]) == pytest.approx(500, rel=0.0125)
        assert np.nanmedian(np.abs((seen["flow"] - expected).values)) < 0.2
        assert np.nanmedian(seen["velocity"].sel(component="X")) == pytest.approx(0.6, abs=0.1)


def test_images_of_more_than_8_bits_are_scaled_alike(recording: xr.Dataset) -> None:
    deep = st.make_recording(recording["image"].values.astype(np.uint16) * 16, 1000.0, BASELINE_MM)
    one, two = (st.estimate(data, "opencv_stereo").sel(t=0)["disparity"] for data in (recording, deep))
    assert np.nanmedian(np.abs(inside(one) - inside(two))) < 0.1


METHODS = ("opencv_stereo", "opencv_flow", "opencv_scene_flow")
DEPTHS = {"8 bits": (255, np.uint8), "16 bits": (4095, np.uint16), "real": (1.5, np.float64)}


@pytest.fixture(scope="module", params=DEPTHS)
def deep(request: pytest.FixtureRequest) -> xr.Dataset:
    """Five frames of three cameras, small."""
    full, dtype = DEPTHS[request.param]
    plane = Plane(velocity=(0.6, -0.4, 1.5), size=(40, 170), focal_length_px=1000.0, depth_mm=500.0)
    values = full * np.clip(plane.recording([-BASELINE_MM, 0, BASELINE_MM], 5, BASELINE_MM)["image"].values, 0, 1)
    images = np.rint(values) if dtype != np.float64 else values
    return st.make_recording(images.astype(dtype), 1000.0, BASELINE_MM, full_scale=full)


def at_once(recording: xr.Dataset, name: str) -> xr.Dataset:
    """The estimate from all images and all maps together, with the default settings."""
    settings: Any = find_method("opencv_scene_flow").settings()
    images = recording["image"].values
    if images.dtype != np.uint8:
        low, high = np.nanpercentile(images[..., ::4, ::4].astype(np.float64), (0.1, 99.9))
        images = np.rint(np.clip((images - low) * (255 / (high - low)), 0, 255)).astype(np.uint8)
    count = recording.sizes["t"]
    flow = [opencv_common.flow_between(images[1, n], images[1, n + 1], settings) for n in range(count - 1)]
    if name == "opencv_flow":
        return st.make_estimate(recording=recording, flow=np.stack(flow, axis=1), t=recording["t"].values[:-1])
    disparity = np.stack(
        [opencv_common.disparity_between(images[1, n], images[2, n], settings, to_the_right=True) for n in range(count)]
    )
    if name == "opencv_stereo":
        return st.make_estimate(recording=recording, disparity=disparity)
    flow.append(np.full_like(flow[0], np.nan))
    return st.make_estimate(recording=recording, disparity=disparity, flow=np.stack(flow, axis=1)).isel(
        t=slice(None, -1)
    )


@pytest.mark.parametrize("name", ["opencv_scene_flow", *by_night("opencv_flow", "opencv_stereo")])
def test_frame_by_frame_from_a_store_is_all_at_once_to_the_bit(deep: xr.Dataset, tmp_path: Path, name: str) -> None:
    st.save_store(deep, tmp_path / "recording.zarr")
    lazy = st.open_store(tmp_path / "recording.zarr")
    told: dict[str, list[tuple[int, int]]] = {}

    def progress(what: str, done: int, total: int) -> None:
        told.setdefault(what, []).append((done, total))

    write_estimate(prepare(lazy, name, progress=progress), tmp_path / "estimate.zarr")
    found = st.load_store(tmp_path / "estimate.zarr", kind="estimate")
    xr.testing.assert_identical(found, st.estimate(deep, name))
    xr.testing.assert_identical(found.drop_attrs(), at_once(deep, name).drop_attrs())
    assert ("velocity" in found) == (name == "opencv_scene_flow")
    # Each kind of work tells of every frame, from none to all.
    counts = {"stereo": 5, "flow": 4}
    assert told == {what: [(n, counts[what]) for n in range(counts[what] + 1)] for what in told}
    assert set(told) == {what for what in counts if what in name or "scene" in name}


@pytest.mark.parametrize("name", ["opencv_scene_flow", *by_night("opencv_flow", "opencv_stereo")])
def test_images_are_read_one_by_one_and_few_are_held(
    deep: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    st.save_store(deep, tmp_path / "recording.zarr")
    lazy = st.open_store(tmp_path / "recording.zarr")
    held: set[int] = set()
    most, sizes = [0], list[int]()
    plain = stored_array.StoredArray.read

    def counting(self: Any, key: tuple[Any, ...]) -> Any:
        found = plain(self, key)
        if found.ndim > 1:
            number = len(sizes)
            held.add(number)
            weakref.finalize(found, held.discard, number)
            sizes.append(found.size)
            most[0] = max(most[0], len(held))
        return found

    monkeypatch.setattr(stored_array.StoredArray, "read", counting)
    write_estimate(prepare(lazy, name), tmp_path / "estimate.zarr")
    assert set(sizes) == {deep.sizes["y"] * deep.sizes["x"]}
    # Every image that is looked at is read once, and all of them once before where their range must be known.
    looked_at = deep.sizes["t"] * (1 if name == "opencv_flow" else 2)
    assert len(sizes) == looked_at + (0 if deep["image"].dtype == np.uint8 else 3 * deep.sizes["t"])
    # Two frames of two cameras, and the one just read.
    assert most[0] <= 5


def test_a_grid_of_one_row_is_a_row(recording: xr.Dataset) -> None:
    row = recording.assign(image=recording["image"].expand_dims("s_y"))
    row = row.assign_coords(s_y=("s_y", [0]), stage_y_mm=("s_y", [0.0]))
    for name in METHODS:
        xr.testing.assert_identical(st.estimate(row, name), st.estimate(recording, name))


def test_a_camera_that_is_not_there_is_refused(recording: xr.Dataset) -> None:
    with pytest.raises(st.EstimateError, match=r"estimate\.camera: must be one of the positions \[-1, 1\]"):
        st.estimate(recording, "opencv_stereo", camera=4)
    with pytest.raises(st.EstimateError, match="stereo_block_px must be odd"):
        st.estimate(recording, "opencv_stereo", stereo_block_px=4)


def test_without_opencv_the_remedy_is_named(recording: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(st.EstimateError, match=r"pip install 'scenetruth\[opencv\]'"):
        st.estimate(recording, "opencv_flow")
