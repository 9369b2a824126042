"""Masks of recordings: which forms they may have, and that they go where the images go."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators import Needs
from scenetruth.schema import check_dataset

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
    xr.testing.assert_identical(st.load_store(tmp_path / name, "recording"), recording)
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
