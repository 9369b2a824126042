"""Formats of benchmarks, read back by their published descriptions."""

from __future__ import annotations

import json

import cv2
import h5py
import imageio.v3 as imageio
import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import binary_dilation

import scenetruth as st
from scenetruth.exporters import ExportSource
from scenetruth.exporters.benchmark_formats import hidden_next
from tests.helpers.exported_scene import Export
from tests.helpers.format_readers import decode_runs, opencv_image, read_cam, read_dpt, read_flo


def test_masks_are_the_objects(export: Export, truth: xr.Dataset) -> None:
    done = export("coco")
    told = json.loads((done.folder / "annotations.json").read_text())
    assert told["categories"] == [
        {"id": 1, "name": "wall", "supercategory": "object"},
        {"id": 2, "name": "tile", "supercategory": "object"},
    ]
    images = {image["id"]: image for image in told["images"]}
    assert len(images) == 9
    assert len({annotation["id"] for annotation in told["annotations"]}) == len(told["annotations"]) == 18
    covered = {number: np.zeros((48, 64), dtype=int) for number in images}
    for annotation in told["annotations"]:
        image = images[annotation["image_id"]]
        mask = decode_runs(**annotation["segmentation"])
        expected = truth.object_id.sel(s=image["s"], t=image["t"]).values == annotation["category_id"] - 1
        np.testing.assert_array_equal(mask, expected)
        assert sum(annotation["segmentation"]["counts"]) == 48 * 64
        assert annotation["area"] == mask.sum()
        left, top, width, height = annotation["bbox"]
        assert mask[top : top + height, left : left + width].sum() == mask.sum()
        assert mask[top].any()
        assert mask[top + height - 1].any()
        assert mask[:, left].any()
        assert mask[:, left + width - 1].any()
        assert annotation["iscrowd"] == 0
        covered[annotation["image_id"]] += mask
    for number, image in images.items():
        np.testing.assert_array_equal(covered[number], truth.object_id.sel(s=image["s"], t=image["t"]) >= 0)
        assert imageio.imread(done.folder / "images" / image["file_name"]).shape == (48, 64)


def test_run_lengths_begin_outside() -> None:
    from scenetruth.exporters.benchmark_formats import _run_lengths

    for text in ("0110/0010", "1000/1001", "1111/1111"):
        mask = np.array([[letter == "1" for letter in row] for row in text.split("/")])
        np.testing.assert_array_equal(decode_runs(_run_lengths(mask), [2, 4]), mask)
    assert _run_lengths(np.ones((2, 2), dtype=bool)) == [0, 4]


def test_parts_of_a_plant_have_it_as_supercategory(recording: xr.Dataset, truth: xr.Dataset, tmp_path: str) -> None:
    named = truth.assign_attrs(object_names='["plant/leaf-1", "plant/leaf-1"]')
    done = st.export((recording, named), "coco", output=f"{tmp_path}/x")
    told = json.loads((done.folder / "annotations.json").read_text())
    assert told["categories"] == [{"id": 1, "name": "plant/leaf-1", "supercategory": "plant"}]
    # Two objects of one name are two instances.
    assert {annotation["object_id"] for annotation in told["annotations"]} == {0, 1}


def test_estimates_know_no_objects(recording: xr.Dataset, tmp_path: str) -> None:
    estimate = st.make_estimate(depth=np.full((3, 48, 64), 90.0), recording=recording)
    with pytest.raises(st.ExportError, match="object_id: is missing: only a truth contains"):
        st.export((recording, estimate), "coco", output=f"{tmp_path}/x")


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


def test_points_are_looked_for_in_the_next_frame(recording: xr.Dataset, truth: xr.Dataset) -> None:
    surface = truth.object_id.sel(s=0, t=0).values >= 0
    expected = surface & ~truth.visible.sel(s=0, t=1).values
    # Some points are seen later but not earlier: these have to be told apart.
    assert (truth.occluded_in_time.sel(s=0, t=0).values & ~expected).sum() > 20
    found = hidden_next(ExportSource(recording, truth.drop_vars("visible")), 0, 0)
    wrong = found != expected
    assert wrong.sum() < 0.15 * expected.sum()
    # Only at the outlines of what is hidden, by a pixel.
    outline = binary_dilation(expected) & binary_dilation(~expected & surface)
    assert not (wrong & ~outline).any()


def test_first_frame_and_reference_are_exact(source: ExportSource, truth: xr.Dataset) -> None:
    np.testing.assert_array_equal(hidden_next(source, 1, -1), truth.occluded_in_time.sel(s=1, t=-1).values)
    expected = (truth.object_id.sel(s=0, t=0).values >= 0) & ~truth.visible.sel(s=0, t=1).values
    np.testing.assert_array_equal(hidden_next(source, 0, 0), expected)
