from __future__ import annotations

import cv2
import imageio.v3 as imageio
import numpy as np
import xarray as xr

from tests.export.conftest import Export
from tests.export.readers import read_cam, read_dpt, read_flo


def test_flow_and_depth(export: Export, truth: xr.Dataset) -> None:
    done = export("sintel", sequence="tile_1", camera=1)
    top = done.folder / "training"
    assert {path.parent.name for path in top.rglob("frame_*")} == {"tile_1"}
    for number, t in enumerate((-1, 0, 1), start=1):
        depth = truth.depth.sel(s=1, t=t).values
        found = read_dpt(top / "depth" / "tile_1" / f"frame_{number:04d}.dpt")
        np.testing.assert_array_equal(found, depth.astype(np.float32))
        invalid = imageio.imread(top / "invalid" / "tile_1" / f"frame_{number:04d}.png")
        np.testing.assert_array_equal(invalid, 255 * np.isnan(depth))
        file = top / "flow" / "tile_1" / f"frame_{number:04d}.flo"
        assert file.exists() == (t < 1)
        if t < 1:
            expected = np.moveaxis(truth.flow_next.sel(s=1, t=t).values, 0, -1)
            known = np.isfinite(depth)
            np.testing.assert_array_equal(read_flo(file)[known], expected[known].astype(np.float32))
            np.testing.assert_array_equal(cv2.readOpticalFlow(str(file)), read_flo(file))
            assert (read_flo(file)[~known] > 1e9).all()


def test_camera_projects_what_it_sees_to_its_pixel(export: Export, truth: xr.Dataset) -> None:
    done = export("sintel", camera=-1)
    inner, outer = read_cam(done.folder / "training" / "camdata_left" / "scene" / "frame_0002.cam")
    rows, columns = np.nonzero(np.isfinite(truth.depth.sel(s=-1, t=0).values))
    depth = truth.depth.sel(s=-1, t=0).values[rows, columns]
    # In the world: camera -1 stands at X = -4 mm.
    points = np.stack([(columns - 31.5) / 80 * depth - 4, (rows - 23.5) / 80 * depth, depth, np.ones(len(depth))])
    x, y, w = inner @ outer @ points
    np.testing.assert_allclose([x / w, y / w], [columns, rows], atol=1e-10)


def test_occlusions_are_those_of_the_next_frame(export: Export, truth: xr.Dataset) -> None:
    done = export("sintel")
    place = done.folder / "training" / "occlusions" / "scene"
    first, second = (imageio.imread(place / f"frame_{number:04d}.png") for number in (1, 2))
    assert not (place / "frame_0003.png").exists()
    # In the first frame nothing is earlier; what other images show of t = 0 is known from another map.
    np.testing.assert_array_equal(first > 0, truth.occluded_in_time.sel(s=0, t=-1).values)
    surface = truth.object_id.sel(s=0, t=0).values >= 0
    expected = surface & ~truth.visible.sel(s=0, t=1).values
    assert 20 < expected.sum() < surface.sum() / 4
    np.testing.assert_array_equal(second > 0, expected)
    assert set(np.unique(second)) == {0, 255}


def test_instantaneous_flow_has_no_occlusions(export: Export) -> None:
    done = export("sintel", flow="instantaneous")
    assert not (done.folder / "training" / "occlusions").exists()
