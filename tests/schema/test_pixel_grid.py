"""Parts of an image keep the camera's pixel indices."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.errors import RecordingError
from scenetruth.schema import Intrinsics, PixelGrid, check_dataset, compute_pixel_grid, label


@pytest.fixture
def recording() -> xr.Dataset:
    return st.make_recording(np.zeros((3, 5, 40, 60), dtype=np.float32), 500.0, 2.0)


def test_whole_images_start_at_zero(recording: xr.Dataset) -> None:
    assert compute_pixel_grid(recording) == PixelGrid(0.0, 0.0, 1.0)
    assert compute_pixel_grid(recording.drop_vars(["x", "y"])) == PixelGrid(0.0, 0.0, 1.0)


def test_crops_and_strides_are_read_from_the_coordinates(recording: xr.Dataset) -> None:
    part = recording.isel(x=slice(20, 50, 3), y=slice(4, 40, 3))
    assert compute_pixel_grid(part) == PixelGrid(20.0, 4.0, 3.0)
    check_dataset(part, "recording")
    binned = recording.coarsen(x=2, y=2).mean()
    assert compute_pixel_grid(binned) == PixelGrid(0.5, 0.5, 2.0)


def test_one_column_has_the_step_of_the_rows(recording: xr.Dataset) -> None:
    assert compute_pixel_grid(recording.isel(x=[7], y=slice(None, None, 2))) == PixelGrid(7.0, 0.0, 2.0)


def test_intrinsics_in_columns_see_along_the_same_rays() -> None:
    camera = Intrinsics(500.0, (29.5, 19.5), 2.0)
    grid = PixelGrid(20.0, 4.0, 3.0)
    columns = grid.in_columns(camera)
    column, row = 5, 7
    x, y = grid.first_x + grid.step_px * column, grid.first_y + grid.step_px * row
    (c_x, c_y), (d_x, d_y) = camera.principal_point_px, columns.principal_point_px
    assert (column - d_x) / columns.focal_length_px == pytest.approx((x - c_x) / camera.focal_length_px, rel=1e-14)
    assert (row - d_y) / columns.focal_length_px == pytest.approx((y - c_y) / camera.focal_length_px, rel=1e-14)


def test_uneven_pixels_are_refused_with_their_names(recording: xr.Dataset) -> None:
    for part, names in (
        (recording.isel(x=[0, 1, 3, 4]), {"x"}),
        (recording.isel(y=slice(None, None, -1)), {"y"}),
        (recording.isel(x=[0, 1, 3], y=[5, 5, 6]), {"x", "y"}),
        (recording.assign_coords(x=np.where(np.arange(60) == 3, np.nan, np.arange(60.0))), {"x"}),
        (recording.isel(x=slice(None, None, 2)), {"y"}),
        (recording.assign_coords(x=[str(n) for n in range(60)]), {"x"}),
    ):
        with pytest.raises(RecordingError) as caught:
            compute_pixel_grid(part)
        assert {problem.path for problem in caught.value.problems} == names
        with pytest.raises(RecordingError):
            check_dataset(part, "recording")


def test_labels_take_pixel_indices() -> None:
    camera = Intrinsics(500.0, (29.5, 19.5), 2.0)
    x, y = np.arange(20, 30), np.arange(4, 12)
    arrays = {"depth": np.ones((1, 8, 10))}
    made = label("estimate", arrays, camera, t=[0], x=x, y=y)
    np.testing.assert_array_equal(made["x"], x)
    np.testing.assert_array_equal(made["y"], y)
    assert made["x"].attrs["units"] == label("estimate", arrays, camera, t=[0])["x"].attrs["units"]
