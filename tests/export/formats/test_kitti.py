from __future__ import annotations

import imageio.v3 as imageio
import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from tests.export.conftest import Export
from tests.export.readers import opencv_image

FB = 80.0 * 4.0


def test_disparities_at_both_times(export: Export, truth: xr.Dataset) -> None:
    done = export("kitti")
    for number, t in enumerate((-1, 0)):
        now = truth.depth.sel(s=0, t=t).values
        then = now + truth.displacement_next.sel(s=0, t=t, component="Z").values
        for place, depth in (("disp_occ_0", now), ("disp_occ_1", then)):
            file = done.folder / place / f"{number:06d}_10.png"
            found = imageio.imread(file)
            assert found.dtype == np.uint16
            known = np.isfinite(depth)
            # KITTI's development kit: d = value / 256, and 0 is invalid.
            np.testing.assert_array_equal(found > 0, known)
            assert np.abs(found[known] / 256 - FB / depth[known]).max() <= 0.5 / 256 + 1e-12
            np.testing.assert_array_equal(found, opencv_image(file))


def test_flow_has_three_channels_of_16_bits(export: Export, truth: xr.Dataset) -> None:
    done = export("kitti")
    file = done.folder / "flow_occ" / "000001_10.png"
    # Signature, length and name of the first chunk, width, height; then bits of a channel, and 2 for red, green, blue.
    assert tuple(file.read_bytes()[24:26]) == (16, 2)
    blue, green, red = np.moveaxis(opencv_image(file).astype(float), -1, 0)
    expected = truth.flow_next.sel(s=0, t=0).values
    known = np.isfinite(expected).all(axis=0)
    np.testing.assert_array_equal(blue, known)
    found = (np.stack([red, green]) - 2**15) / 64
    errors = (found - expected)[:, known]
    assert np.abs(errors).max() <= 0.5 / 64 + 1e-12
    # Rounding to a step has the rms of step / sqrt(12): 0.0045 px. The wall rests: its flow of 0 is exact.
    moving = truth.object_id.sel(s=0, t=0).values[known] == 1
    assert np.sqrt((errors[:, moving] ** 2).mean()) == pytest.approx(1 / 64 / np.sqrt(12), rel=0.05)
    assert not red[~known].any()
    assert not green[~known].any()


def test_steps_are_told(export: Export) -> None:
    done = export("kitti")
    assert "0.0045 px rms" in done.notes[0]
    assert "0.0011 px rms" in done.notes[0]


def test_calibration_gives_the_depth_in_metres(export: Export, truth: xr.Dataset) -> None:
    done = export("kitti")
    lines = (done.folder / "calib_cam_to_cam" / "000000.txt").read_text().splitlines()
    told = dict(line.split(": ") for line in lines)
    left, right = (np.array(told[f"P_rect_0{n}"].split(), dtype=float).reshape(3, 4) for n in (2, 3))
    rows, columns = np.nonzero(truth.object_id.sel(s=0, t=-1).values >= 0)
    depth_m = truth.depth.sel(s=0, t=-1).values[rows, columns] / 1000
    points = np.stack([(columns - 31.5) / 80 * depth_m, (rows - 23.5) / 80 * depth_m, depth_m, np.ones_like(depth_m)])
    (x_left, y_left, _), (x_right, y_right, _) = (matrix @ points / (matrix @ points)[2] for matrix in (left, right))
    np.testing.assert_allclose([x_left, y_left], [columns, rows], atol=1e-9)
    np.testing.assert_allclose(x_left - x_right, FB / (1000 * depth_m), rtol=1e-9)
    np.testing.assert_allclose(y_left, y_right, atol=1e-9)


def test_what_does_not_fit_becomes_unknown_and_is_told(
    recording: xr.Dataset, truth: xr.Dataset, tmp_path: pytest.TempPathFactory
) -> None:
    changed = truth.copy()
    changed["flow_next"] = truth.flow_next.copy(deep=True)
    changed.flow_next.loc[{"s": 0, "t": 0, "y": 10, "x": 20}] = 512.0
    done = st.export((recording, changed), "kitti", output=f"{tmp_path}/kitti")
    assert "1 values out of range" in done.notes[1]
    flow = opencv_image(done.folder / "flow_occ" / "000001_10.png")
    assert not flow[10, 20].any()


def test_instantaneous_scene_flow_of_an_estimate(recording: xr.Dataset, tmp_path: pytest.TempPathFactory) -> None:
    depth = np.full((3, 48, 64), 100.0)
    depth[:, :5] = np.nan
    velocity = np.zeros((3, 3, 48, 64))
    velocity[2] = -20.0
    estimate = st.make_estimate(depth=depth, velocity=velocity, flow=np.full((2, 3, 48, 64), -1.5), recording=recording)
    done = st.export((recording, estimate), "kitti", output=f"{tmp_path}/kitti", flow="instantaneous")
    first, second = (imageio.imread(done.folder / f"disp_occ_{n}" / "000000_10.png") for n in (0, 1))
    assert set(first[5:].ravel()) == {round(256 * FB / 100)}
    assert set(second[5:].ravel()) == {round(256 * FB / 80)}
    assert not first[:5].any()
    assert not second[:5].any()
    assert any("instantaneous" in note for note in done.notes)
