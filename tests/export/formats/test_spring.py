from __future__ import annotations

import h5py
import imageio.v3 as imageio
import numpy as np
import xarray as xr

from tests.export.conftest import Export

FB = 80.0 * 4.0


def read(file: str, name: str) -> np.ndarray:
    with h5py.File(file) as opened:
        assert list(opened) == [name]
        values: np.ndarray = opened[name][()]
        assert values.dtype == np.float32
        return values


def test_disparity_now_and_then_both_ways(export: Export, truth: xr.Dataset) -> None:
    done = export("spring")
    for number, t in enumerate((-1, 0, 1), start=1):
        depth = truth.depth.sel(s=0, t=t).values
        maps = {"disp1_left": depth}
        for name, way, there in (("disp2_FW_left", "next", t < 1), ("disp2_BW_left", "previous", t > -1)):
            assert (done.folder / name / f"{name}_{number:04d}.dsp5").exists() == there
            if there:
                maps[name] = depth + truth[f"displacement_{way}"].sel(s=0, t=t, component="Z").values
        for name, expected in maps.items():
            found = read(str(done.folder / name / f"{name}_{number:04d}.dsp5"), "disparity")
            # NaN stands where the truth has NaN; float32 holds 6e-8 of the value.
            np.testing.assert_allclose(found, FB / expected, rtol=6e-8)
            assert np.isnan(found).any()


def test_flow_forward_and_backward(export: Export, truth: xr.Dataset) -> None:
    done = export("spring")
    for name, way, number, t in (("FW", "next", 1, -1), ("FW", "next", 2, 0), ("BW", "previous", 3, 1)):
        place = f"flow_{name}_left"
        found = read(str(done.folder / place / f"{place}_{number:04d}.flo5"), "flow")
        expected = np.moveaxis(truth[f"flow_{way}"].sel(s=0, t=t).values, 0, -1)
        np.testing.assert_array_equal(found, expected.astype(np.float32))
    assert not (done.folder / "flow_FW_left" / "flow_FW_left_0003.flo5").exists()
    assert not (done.folder / "flow_BW_left" / "flow_BW_left_0001.flo5").exists()


def test_second_disparity_is_that_of_the_next_frame(export: Export, truth: xr.Dataset) -> None:
    # Where the wall, which rests, is seen all the time, the disparities of both frames are one.
    done = export("spring")
    first = read(str(done.folder / "disp1_left" / "disp1_left_0001.dsp5"), "disparity")
    second = read(str(done.folder / "disp2_FW_left" / "disp2_FW_left_0001.dsp5"), "disparity")
    wall = truth.object_id.sel(s=0, t=-1).values == 0
    np.testing.assert_array_equal(first[wall], second[wall])
    tile = truth.object_id.sel(s=0, t=-1).values == 1
    assert np.median(second[tile] - first[tile]) > 0.01


def test_images_and_cameras(export: Export, recording: xr.Dataset) -> None:
    done = export("spring")
    for name, s in (("frame_left", 0), ("frame_right", 1)):
        found = imageio.imread(done.folder / name / f"{name}_0002.png")
        assert np.abs(found / 255 - recording.image.sel(s=s, t=0).values).max() <= 0.5 / 255 + 1e-6
    assert np.loadtxt(done.folder / "cam_data" / "intrinsics.txt").tolist() == [[80, 80, 31.5, 23.5]] * 3
    assert np.loadtxt(done.folder / "cam_data" / "extrinsics.txt").reshape(3, 4, 4)[0].tolist() == np.eye(4).tolist()
    assert float((done.folder / "cam_data" / "baseline_mm.txt").read_text()) == 4.0


def test_instantaneous_flow_backward_is_the_negative(export: Export, truth: xr.Dataset) -> None:
    done = export("spring", flow="instantaneous")
    found = read(str(done.folder / "flow_BW_left" / "flow_BW_left_0002.flo5"), "flow")
    np.testing.assert_array_equal(found, -np.moveaxis(truth.flow.sel(s=0, t=0).values, 0, -1).astype(np.float32))
    then = read(str(done.folder / "disp2_BW_left" / "disp2_BW_left_0002.dsp5"), "disparity")
    depth = truth.depth.sel(s=0, t=0).values - truth.velocity.sel(s=0, t=0, component="Z").values
    np.testing.assert_allclose(then, FB / depth, rtol=6e-8)
