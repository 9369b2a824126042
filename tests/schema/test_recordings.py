"""Recordings from plain arrays, and their masks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators import Needs
from scenetruth.schema import VARIABLES, Intrinsics, check_dataset, image_to_grey, label, read_intrinsics


def test_recording_has_coordinates_units_and_intrinsics() -> None:
    recording = st.make_recording(np.zeros((5, 9, 4, 6)), 5016, 5.0, frame_interval_s=60.0)
    assert recording["image"].dims == ("s", "t", "y", "x")
    assert recording["stage_x_mm"].values.tolist() == [-10, -5, 0, 5, 10]
    assert recording["time_s"].values.tolist() == [60.0 * t for t in range(-4, 5)]
    for variable in recording.variables.values():
        assert variable.attrs["units"]
        assert variable.attrs["long_name"]
    intrinsics = read_intrinsics(recording)
    assert intrinsics.principal_point_px == (2.5, 1.5)
    assert (intrinsics.focal_length_px, intrinsics.baseline_mm, intrinsics.frame_interval_s) == (5016, 5, 60)


@pytest.mark.parametrize(
    ("images", "expected"),
    [
        (np.array([0.0, 0.5, 1.0]), [-1, 0, 1]),
        (np.array([0, 255], dtype=np.uint8), [-1, 1]),
        (np.array([0, 65535], dtype=np.uint16), [-1, 1]),
    ],
)
def test_grey_values_of_the_paper(images: Any, expected: list[float]) -> None:
    recording = st.make_recording(images.reshape(1, 1, 1, -1), 1.0, 1.0)
    np.testing.assert_allclose(image_to_grey(recording).ravel(), expected, atol=1e-7)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"images": np.zeros((3, 4))}, "images: must be a non-empty array with the dimensions"),
        ({"images": np.zeros((0, 1, 2, 2))}, "images: must be a non-empty array"),
        ({"images": np.zeros((1, 1, 2, 2), dtype=complex)}, "images: must hold real numbers"),
        ({"focal_length_px": -1.0}, r"- focal_length_px: must be positive \(got -1\.0\)"),
        ({"focal_length_px": float("nan")}, "- focal_length_px: must be a finite number"),
        ({"baseline_mm": 0.0, "images": np.zeros((2, 1, 2, 2))}, "- baseline_mm: must not be zero"),
        ({"frame_interval_s": 0.0}, "- frame_interval_s: must be positive"),
        ({"principal_point_px": (1.0, float("inf"))}, r"- principal_point_px\.1: must be a finite number \(got inf\)"),
        ({"full_scale": 0.0}, "- full_scale: must be positive"),
        ({"stage_x_mm": [0.0, 1.0]}, "stage_x_mm: must hold one position for each of the 1 cameras"),
        ({"stage_x_mm": [float("nan")]}, "stage_x_mm: must be finite"),
        ({"stage_y_mm": [0.0]}, r"images: must be .* dimensions \(s_y, s, t, y, x\)"),
        (
            {"stage_y_mm": [0.0, 1.0], "images": np.zeros((1, 1, 1, 2, 2))},
            "stage_y_mm: must hold one position for each of the 1 rows",
        ),
        ({"stage_y_mm": [float("nan")], "images": np.zeros((1, 1, 1, 2, 2))}, "stage_y_mm: must be finite"),
    ],
)
def test_bad_recordings(changes: dict[str, Any], message: str) -> None:
    good = {"images": np.zeros((1, 1, 2, 2)), "focal_length_px": 1.0, "baseline_mm": 1.0}
    with pytest.raises(st.RecordingError, match=message):
        st.make_recording(**{**good, **changes})


@pytest.mark.parametrize("channels", [(), (3,)])
def test_cameras_in_a_grid(channels: tuple[int, ...]) -> None:
    images = np.random.default_rng(0).random((3, 2, 4, 5, 6, *channels))
    grid = st.make_recording(images, 100.0, 5.0, stage_y_mm=[-4, 0, 4])
    assert grid["image"].dims == ("s_y", "s", "t", "y", "x", "channel")[: images.ndim]
    assert grid["s_y"].values.tolist() == [-1, 0, 1]
    assert grid["stage_y_mm"].values.tolist() == [-4, 0, 4]
    assert all(coordinate.attrs["units"] and coordinate.attrs["long_name"] for coordinate in grid.coords.values())
    row = grid.sel(s_y=1)
    check_dataset(row, "recording")
    np.testing.assert_array_equal(row["image"], images[2])
    with pytest.raises(st.RecordingError, match="s_y: must be consecutive integers with 0 as the reference"):
        check_dataset(grid.isel(s_y=[0, 2]), "recording")
    with pytest.raises(st.RecordingError, match="stage_y_mm: is missing; coordinate required for the images"):
        check_dataset(grid.drop_vars("stage_y_mm"), "recording")


def test_all_problems_are_reported_at_once() -> None:
    with pytest.raises(st.RecordingError) as caught:
        st.make_recording(np.zeros((2, 1, 2, 2)), -1.0, 0.0, frame_interval_s=-1.0)
    assert len(caught.value.problems) == 3


def test_every_variable_of_the_table_has_units_and_long_name() -> None:
    for table in VARIABLES.values():
        for entry in table.values():
            assert entry.units
            assert entry.long_name


@pytest.mark.parametrize("held", [("depth",), ("disparity",), ("flow",), ("velocity",), ("depth", "disparity")])
def test_estimate_holds_what_its_method_gives(held: tuple[str, ...]) -> None:
    shapes = {"depth": (1, 2, 3), "disparity": (1, 2, 3), "flow": (2, 1, 2, 3), "velocity": (3, 1, 2, 3)}
    camera = Intrinsics(100.0, (1.0, 0.5), 5.0)
    estimate = label("estimate", {name: np.ones(shapes[name]) for name in held}, camera, t=[0])
    check_dataset(estimate, "estimate")
    with pytest.raises(st.RecordingError) as caught:
        check_dataset(estimate.drop_vars(held).assign(coherence=(("t", "y", "x"), np.ones((1, 2, 3)))), "estimate")
    assert [problem.path for problem in caught.value.problems] == ["variables"]
    assert "hold neither depth, velocity, disparity nor flow" in str(caught.value)
    assert "['coherence']" in str(caught.value)
    # A truth must have all.
    with pytest.raises(st.RecordingError, match="mixed: is missing; required in a truth"):
        check_dataset(estimate, "truth")


@pytest.mark.parametrize(("largest", "dtype"), [(255.0, np.float32), (1.01, np.float64)])
def test_floats_of_unknown_full_scale_are_refused(largest: float, dtype: type) -> None:
    images: np.ndarray = np.full((2, 1, 4, 4), 0.5, dtype=dtype)
    images[0, 0, 0, 0] = largest
    with pytest.raises(st.RecordingError, match=r"outside \[-1, 1\]: specify full_scale="):
        st.make_recording(images, 100.0, 5.0)
    assert st.make_recording(images, 100.0, 5.0, full_scale=255.0).attrs["full_scale"] == 255
    images[0, 0, 0, 0] = np.nan
    assert st.make_recording(images, 100.0, 5.0).attrs["full_scale"] == 1


IMAGES = np.zeros((2, 3, 4, 5))
SIZES = {"s": 2, "t": 3, "y": 4, "x": 5}


def masked(mask: Any, images: np.ndarray = IMAGES, **more: Any) -> xr.Dataset:
    return st.make_recording(images, 100.0, 5.0, exclusion_mask=mask, **more)


def any_mask(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).random(shape) < 0.5


@pytest.mark.parametrize(
    ("shape", "dims"),
    [
        ((4, 5), "yx"),
        ((2, 4, 5), "syx"),
        ((2, 3, 4, 5), "styx"),
        ((1, 3, 4, 5), "tyx"),
        ((2, 1, 4, 5), "syx"),
        ((1, 1, 4, 5), "yx"),
    ],
)
def test_a_mask_lacks_the_dimensions_along_which_it_is_the_same(shape: tuple[int, ...], dims: str) -> None:
    given = any_mask(*shape)
    mask = masked(given)["exclusion_mask"]
    assert mask.dims == tuple(dims)
    np.testing.assert_array_equal(mask.values.ravel(), given.ravel())
    assert mask.dtype == bool
    assert mask.attrs["flag_meanings"] == "usable masked"
    given[:] = True
    assert not mask.values.all()


def test_a_grid_has_its_rows_first_and_colours_share_a_mask() -> None:
    images = np.zeros((2, 2, 3, 4, 5))
    for shape, dims in (((2, 2, 4, 5), ("s_y", "s", "y", "x")), ((1, 1, 3, 4, 5), ("t", "y", "x"))):
        assert masked(any_mask(*shape), images, stage_y_mm=[0.0, 1.0])["exclusion_mask"].dims == dims
    assert masked(any_mask(2, 3, 4, 5), np.zeros((2, 3, 4, 5, 3)))["exclusion_mask"].dims == ("s", "t", "y", "x")


def test_a_named_mask_says_its_dimensions() -> None:
    """Where there are as many frames as cameras, an array of three dimensions is that of cameras."""
    frames = xr.DataArray(any_mask(4, 5, 3), dims=("y", "x", "t"))
    found = masked(frames)["exclusion_mask"]
    assert found.dims == ("t", "y", "x")
    np.testing.assert_array_equal(found, frames.transpose("t", "y", "x"))


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (np.zeros((4, 5)), "mask: must be boolean, True where a pixel must not be used"),
        (np.zeros(5, dtype=bool), r"mask: must have one of the shapes \(y, x\), \(s, y, x\), \(s, t, y, x\)"),
        (any_mask(3, 4, 5), r"mask: must have the shape \(2, 4, 5\) of the images in \('s', 'y', 'x'\)"),
        (any_mask(5, 4), r"mask: must have the shape \(4, 5\)"),
        ([[True], [True, False]], "mask: cannot be made into an array"),
        (xr.DataArray(any_mask(4, 5), dims=("y", "u")), "mask: must have the dimensions y and x"),
        (xr.DataArray(any_mask(2, 4), dims=("s", "y")), "mask: must have the dimensions y and x"),
    ],
)
def test_what_is_no_mask_is_refused(mask: Any, message: str) -> None:
    with pytest.raises(st.RecordingError, match=message):
        masked(mask)


@pytest.mark.parametrize(
    ("dims", "dtype", "message"),
    [(("x", "y"), bool, "in this order"), (("s", "y"), bool, "y and x"), (("y", "x"), np.uint8, "must be boolean")],
)
def test_a_mask_that_does_not_fit_is_found(dims: tuple[str, ...], dtype: type, message: str) -> None:
    recording = masked(None)
    shape = tuple(SIZES[dim] for dim in dims)
    with pytest.raises(st.RecordingError, match=f"mask: .*{message}"):
        check_dataset(recording.assign(exclusion_mask=(dims, np.zeros(shape, dtype))), "recording")


@pytest.mark.parametrize("shape", [(4, 5), (2, 4, 5), (2, 3, 4, 5), (1, 3, 4, 5)])
@pytest.mark.parametrize("name", ["recording.zarr", "recording.zarr.zip"])
def test_stores_keep_it_and_selections_cut_it(tmp_path: Path, shape: tuple[int, ...], name: str) -> None:
    recording = masked(any_mask(*shape))
    st.save_store(recording, tmp_path / name)
    xr.testing.assert_identical(st.load_store(tmp_path / name, kind="recording"), recording)
    part = {"x": slice(1, 4), "t": slice(1, 3)}
    cut = st.open_store(tmp_path / name).isel(part)
    check_dataset(cut, "recording")
    np.testing.assert_array_equal(cut["exclusion_mask"], recording["exclusion_mask"].isel(part, missing_dims="ignore"))


def test_methods_that_would_use_masked_pixels_refuse() -> None:
    recording = masked(any_mask(4, 5))

    def flat(recording: xr.Dataset) -> dict[str, Any]:
        return {"depth": np.full((3, 4, 5), 100.0)}

    for method in ("structure_tensor", "plane_sweep", flat):
        with pytest.raises(st.EstimateError, match=r"mask: is not supported .*drop_vars\('exclusion_mask'\)"):
            st.estimate(recording, method)
    st.estimate(recording.drop_vars("exclusion_mask"), flat)
    flat.needs = Needs(exclusion_mask=True)  # type: ignore[attr-defined]
    st.estimate(recording, flat)


@pytest.mark.parametrize("dtype", [np.int32, np.uint32, np.int64, np.uint64])
def test_integers_without_a_full_scale_ask_for_it(dtype: type) -> None:
    images: np.ndarray = np.full((2, 1, 4, 4), 200, dtype=dtype)
    with pytest.raises(st.RecordingError, match=r"integers of (32|64) bits.*full_scale=.*they reach 200"):
        st.make_recording(images, 100.0, 5.0)
    assert image_to_grey(st.make_recording(images, 100.0, 5.0, full_scale=400)).max() == 0.0


def numbered(*shape: int) -> np.ndarray:
    return np.arange(np.prod(shape), dtype=np.float64).reshape(shape) / np.prod(shape)


def test_labelled_arrays_are_put_in_order_by_their_names() -> None:
    images = numbered(2, 3, 4, 5)
    named = xr.DataArray(images, dims=("s", "t", "y", "x"))
    for dims in (("x", "t", "y", "s"), ("t", "s", "x", "y")):
        found = st.make_recording(named.transpose(*dims), 100.0, 5.0)["image"]
        np.testing.assert_array_equal(found.values, images)
        np.testing.assert_array_equal(st.make_recording(named.transpose(*dims).variable, 100.0, 5.0)["image"], images)
    assert st.make_recording(named.isel(t=0), 100.0, 5.0)["image"].shape == (2, 1, 4, 5)
    colours = xr.DataArray(numbered(3, 2, 3, 4, 5), dims=("channel", "s", "t", "y", "x"))
    assert st.make_recording(colours, 100.0, 5.0)["image"].shape == (2, 3, 4, 5, 3)
    with pytest.raises(st.RecordingError, match=r"images: must have the dimensions s, t, y, x, channel"):
        st.make_recording(named.rename(s="camera"), 100.0, 5.0)


def test_memory_maps_and_dask_arrays(tmp_path: Path) -> None:
    images = numbered(2, 3, 4, 5)
    np.save(tmp_path / "images.npy", images)
    mapped = np.load(tmp_path / "images.npy", mmap_mode="r")
    for copy in (True, False):
        np.testing.assert_array_equal(st.make_recording(mapped, 100.0, 5.0, copy=copy)["image"], images)
    dask = pytest.importorskip("dask.array")
    lazy = dask.from_array(images, chunks=(1, 1, 4, 5))
    np.testing.assert_array_equal(st.make_recording(lazy, 100.0, 5.0)["image"], images)
    named = xr.DataArray(lazy, dims=("s", "t", "y", "x")).transpose("x", "y", "t", "s")
    np.testing.assert_array_equal(st.make_recording(named, 100.0, 5.0)["image"], images)


def test_masked_arrays_bring_their_mask() -> None:
    hidden = any_mask(2, 3, 4, 5)
    images = np.ma.masked_array(numbered(2, 3, 4, 5), hidden)
    recording = st.make_recording(images, 100.0, 5.0)
    np.testing.assert_array_equal(recording["exclusion_mask"].transpose(*"styx"), hidden)
    more = any_mask(4, 5)[::-1]
    recording = st.make_recording(images, 100.0, 5.0, exclusion_mask=more)
    np.testing.assert_array_equal(recording["exclusion_mask"].transpose(*"styx"), hidden | more)
    colours = np.ma.masked_array(numbered(2, 3, 4, 5, 3), np.repeat(hidden[..., None], 3, axis=-1))
    np.testing.assert_array_equal(st.make_recording(colours, 100.0, 5.0)["exclusion_mask"], hidden)
    assert "exclusion_mask" not in st.make_recording(np.ma.masked_array(numbered(2, 3, 4, 5)), 100.0, 5.0)


def test_channels_come_last() -> None:
    with pytest.raises(st.RecordingError, match=r"would have 60 channels; .* np\.moveaxis\(images, 2, -1\)"):
        st.make_recording(np.zeros((2, 2, 3, 40, 60)), 100.0, 5.0)


def test_missing_images_are_named_by_position_and_frame() -> None:
    image = np.zeros((4, 5))
    rows: list[list[Any]] = [[image, image, image], [image, None, np.zeros((4, 6))]]
    expected = r"most have \(4, 5\).* \(s = 1, t = 1\) is missing; \(s = 1, t = 2\) has the shape \(4, 6\)"
    with pytest.raises(st.RecordingError, match=expected):
        st.make_recording(rows, 100.0, 5.0)
    with pytest.raises(st.RecordingError, match="cannot be made into an array"):
        st.make_recording([[image, image], [image]], 100.0, 5.0)
    with pytest.raises(st.RecordingError, match=r"number of images \(t\) .* most have 3, and s = 1 has 2\. Fill"):
        st.make_recording([[image] * 3, [image] * 2, [image] * 3], 100.0, 5.0)
    assert st.make_recording([[image, image], [image, image]], 100.0, 5.0)["image"].shape == (2, 2, 4, 5)


def test_16_bit_images_of_fewer_bits_are_asked_for_their_full_scale(recwarn: pytest.WarningsRecorder) -> None:
    images = np.zeros((2, 2, 48, 64), dtype=np.uint16)
    for largest in (4094, 65535):
        images[0, 0, 0, 0] = largest
        st.make_recording(images, 500.0, 5.0)
    images[0, 0, 0, 0] = 4095
    st.make_recording(images, 500.0, 5.0, full_scale=4095)
    assert not recwarn.list
    images[0, 0, 0, 0] = 4095
    with pytest.warns(st.SceneWarning, match="largest value of 12 bits; .* specify full_scale=4095"):
        st.make_recording(images, 500.0, 5.0)


@pytest.mark.parametrize(
    ("focal_px", "baseline_mm", "message"),
    [
        (12.0, 5.0, r"focal_length_px: 12 px for images of 64 x 48 px is a field of view of 139°; is it in mm\?"),
        (500.0, 0.005, r"baseline_mm: 0\.005 mm .* is it in m\?"),
        (500.0, 2e4, r"baseline_mm: 20000 mm .* is it in µm\?"),
    ],
)
def test_unlikely_units_are_asked_for(focal_px: float, baseline_mm: float, message: str) -> None:
    with pytest.warns(st.SceneWarning, match=message):
        st.make_recording(np.zeros((2, 2, 48, 64)), focal_px, baseline_mm)
