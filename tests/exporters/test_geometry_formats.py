"""Point clouds, and cameras of OpenCV and of COLMAP that see their points at the right pixels."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import plyfile
import pytest
import trimesh
import xarray as xr
from scipy.spatial.transform import Rotation

import scenetruth as st
from tests.helpers.exported_scene import Export, scene
from tests.helpers.format_readers import rotation_of

DISTORTION = {"k1": -0.12, "k2": 0.03, "p1": 0.002, "p2": -0.001, "k3": 0.01}
ERRORS = {"repeatability_um": 200, "straightness_um": 300, "pitch_urad": 2000, "yaw_urad": 3000, "roll_urad": 4000}


@pytest.fixture(scope="module")
def imperfect() -> tuple[xr.Dataset, xr.Dataset]:
    camera = {"width": 32, "height": 24, "focal_length_px": 40, "distortion": DISTORTION}
    stage = {"positions": 3, "baseline_mm": 4.0, "errors": ERRORS}
    return st.simulate(scene(camera=camera, stage=stage, frames={"count": 2}), truth_views="all")


def points_of(folder: Path, s: int, t: int) -> tuple[np.ndarray, np.ndarray]:
    vertex = plyfile.PlyData.read(folder / f"s{s:+d}_t{t:+d}.ply")["vertex"]
    return np.stack([vertex[name] for name in "xyz"], axis=1), np.stack([vertex["column"], vertex["row"]], axis=1)


def opencv_camera(file: Path) -> dict[str, np.ndarray]:
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_READ)
    names = ("camera_matrix", "distortion_coefficients", "rotation_matrix", "rotation_vector", "translation_vector")
    found = {name: storage.getNode(name).mat() for name in names}
    found["size"] = np.array([storage.getNode(f"image_{name}").real() for name in ("width", "height")])
    return found


def seen_by_opencv(file: Path, points: np.ndarray) -> np.ndarray:
    camera = opencv_camera(file)
    turned, _ = cv2.Rodrigues(camera["rotation_vector"])
    np.testing.assert_allclose(turned, camera["rotation_matrix"], atol=1e-14)
    how = (camera["rotation_vector"], camera["translation_vector"], camera["camera_matrix"])
    return cv2.projectPoints(points, *how, camera["distortion_coefficients"])[0][:, 0]


def test_opencv_projects_points_to_their_pixels(export: Export) -> None:
    points, cameras = export("ply").folder, export("opencv_yaml").folder
    for s in (-1, 0, 1):
        where, pixels = points_of(points, s, 1)
        np.testing.assert_allclose(seen_by_opencv(cameras / f"s{s:+d}.yml", where), pixels, atol=1e-6)
        assert opencv_camera(cameras / f"s{s:+d}.yml")["size"].tolist() == [64, 48]


def test_opencv_does_so_with_lens_and_stage_errors(imperfect: tuple[xr.Dataset, xr.Dataset], tmp_path: Path) -> None:
    points = st.export(imperfect, "ply", output=tmp_path / "ply").folder
    cameras = st.export(imperfect, "opencv_yaml", output=tmp_path / "cameras", poses="actual").folder
    planned = st.export(imperfect, "opencv_yaml", output=tmp_path / "planned").folder
    for s, t in ((-1, 0), (0, 1), (1, 1)):
        where, pixels = points_of(points, s, t)
        # OpenCV and the Brown-Conrady model of the scene are one formula.
        np.testing.assert_allclose(seen_by_opencv(cameras / f"s{s:+d}_t{t:+d}.yml", where), pixels, atol=1e-6)
        assert np.abs(seen_by_opencv(planned / f"s{s:+d}.yml", where) - pixels).max() > 0.05


def read_colmap(folder: Path) -> tuple[dict[str, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]], str]:
    """For every image: world to camera, parameters, 2D points, and the 3D points that they show."""
    model = folder / "sparse" / "0"
    lines = {
        name: [line for line in (model / f"{name}.txt").read_text().split("\n") if not line.startswith("#")]
        for name in ("cameras", "images", "points3D")
    }
    (_, kind, _, _, *numbers) = lines["cameras"][0].split()
    points = {}
    for line in filter(None, lines["points3D"]):
        number, *values = line.split()
        points[int(number)] = values
    found = {}
    for head, places in zip(lines["images"][0:-1:2], lines["images"][1::2], strict=True):
        image, *values = head.split()
        w, x, y, z, *shift = map(float, values[:7])
        pose = np.column_stack([rotation_of(w, x, y, z), shift])
        table = np.array(places.split(), dtype=float).reshape(-1, 3)
        where = np.array([points[int(n)][:3] for n in table[:, 2]], dtype=float)
        # A track says which image, and which of its points, counted from 0.
        for index, n in enumerate(table[:, 2]):
            track = points[int(n)][7:]
            assert (image, str(index)) in set(zip(track[::2], track[1::2], strict=True))
        found[values[8]] = (pose, np.array(numbers, dtype=float), table[:, :2], where)
    return found, kind


def test_colmap_projects_points_half_a_pixel_further(export: Export, truth: xr.Dataset) -> None:
    done = export("colmap", every=3)
    images, kind = read_colmap(done.folder)
    assert kind == "PINHOLE"
    assert sorted(images) == sorted(path.name for path in (done.folder / "images").iterdir())
    for pose, (f_x, f_y, c_x, c_y), places, where in images.values():
        x, y, z = pose @ np.column_stack([where, np.ones(len(where))]).T
        np.testing.assert_allclose(places, np.stack([f_x * x / z + c_x, f_y * y / z + c_y], axis=1), atol=1e-9)
    # In COLMAP, the first pixel's centre is at (0.5, 0.5), and the middle of this image at half its width.
    assert images["s+0_t+0.png"][1].tolist() == [80, 80, 32, 24]
    pixels = images["s+0_t+0.png"][2] - 0.5
    assert not np.abs(pixels - np.rint(pixels)).max() > 1e-9
    assert (np.rint(pixels) % 3 == 0).all()
    np.testing.assert_allclose(points_of_pixels(export, pixels), images["s+0_t+0.png"][3], atol=1e-9)
    # Other cameras list what they see, and no more.
    columns, rows = np.rint(pixels).astype(int).T
    assert len(images["s+1_t+0.png"][2]) == truth.visible.sel(s=1, t=0).values[rows, columns].sum()


def points_of_pixels(export: Export, pixels: np.ndarray) -> np.ndarray:
    where, own = points_of(export("ply").folder, 0, 0)
    by_pixel = {tuple(pixel): point for pixel, point in zip(own.tolist(), where, strict=True)}
    return np.array([by_pixel[tuple(pixel)] for pixel in np.rint(pixels).astype(int).tolist()])


def test_colmap_with_lens_and_stage_errors(imperfect: tuple[xr.Dataset, xr.Dataset], tmp_path: Path) -> None:
    done = st.export(imperfect, "colmap", output=tmp_path / "colmap", every=2)
    images, kind = read_colmap(done.folder)
    assert kind == "FULL_OPENCV"
    for pose, (f_x, f_y, c_x, c_y, *lens), places, where in images.values():
        turned, _ = cv2.Rodrigues(pose[:, :3])
        matrix = np.array([[f_x, 0, c_x], [0, f_y, c_y], [0, 0, 1]])
        seen = cv2.projectPoints(where, turned, pose[:, 3], matrix, np.array(lens))[0][:, 0]
        np.testing.assert_allclose(places, seen, atol=1e-6)
    pixels = images["s+0_t+0.png"][2] - 0.5
    np.testing.assert_allclose(pixels, np.rint(pixels), atol=1e-9)


def test_frames_other_than_the_reference_know_one_image_of_each_point(export: Export) -> None:
    done = export("colmap", frame=1, every=6)
    images, _ = read_colmap(done.folder)
    assert [len(places) for _, _, places, _ in images.values()][::2] == [0, 0]
    assert len(images["s+0_t+1.png"][2]) > 50


def test_points_are_seen_from_where_the_truth_was_made_for(tmp_path: Path) -> None:
    camera = {"width": 32, "height": 24, "focal_length_px": 40}
    moved = scene(camera=camera, stage={"positions": 3, "baseline_mm": 4.0, "errors": ERRORS}, frames={"count": 2})
    actual = st.simulate(moved, truth_views="all")
    assert actual.truth.attrs["truth_poses"] == "actual"
    nominal = actual._replace(truth=st.make_truth(moved, truth_views="all", truth_poses="nominal"))
    points = {
        label: points_of(st.export(data, "ply", output=tmp_path / label).folder, 1, 0)[0]
        for label, data in (("actual", actual), ("nominal", nominal))
    }
    depths = {
        label: data.truth["depth"].sel(s=1, t=0).values.ravel()
        for label, data in (("actual", actual), ("nominal", nominal))
    }
    depths = {label: depth[np.isfinite(depth)] for label, depth in depths.items()}
    place, turn = (actual.truth[f"camera_{name}"].sel(s=1, t=0).values for name in ("position_mm", "rotation_rad"))
    seen = Rotation.from_rotvec(turn).inv().apply(points["actual"] - place)
    np.testing.assert_allclose(np.sort(seen[:, 2]), np.sort(depths["actual"]), rtol=1e-9)
    np.testing.assert_allclose(np.sort(points["nominal"][:, 2]), np.sort(depths["nominal"]), rtol=1e-9)
    assert np.abs(np.sort(points["actual"][:, 2]) - np.sort(depths["actual"])).max() > 0.01


def test_real_poses_need_a_truth(recording: xr.Dataset, tmp_path: Path) -> None:
    estimate = st.make_estimate(depth=np.full((3, 48, 64), 90.0), recording=recording)
    with pytest.raises(st.ExportError, match=r"poses: needs the actual poses of a truth.*[(]got 'actual'[)]"):
        st.export((recording, estimate), "opencv_yaml", output=tmp_path / "x", poses="actual")
    with pytest.raises(st.ExportError, match=r"frame: must be one of the frames \[-1, 0, 1\] \(got 5\)"):
        st.export((recording, estimate), "colmap", output=tmp_path / "x", frame=5)


def test_points_are_where_the_truth_says(export: Export, truth: xr.Dataset, recording: xr.Dataset) -> None:
    done = export("ply")
    file = done.folder / "s+1_t+0.ply"
    assert b"format binary_little_endian 1.0" in file.read_bytes()[:60]
    read = trimesh.load(file)
    own = truth.sel(s=1, t=0)
    rows, columns = np.nonzero(np.isfinite(own.depth.values))
    depth = own.depth.values[rows, columns]
    # The camera s = 1 stands at X = 4 mm.
    expected = np.stack([(columns - 31.5) / 80 * depth + 4, (rows - 23.5) / 80 * depth, depth], axis=1)
    np.testing.assert_allclose(read.vertices, expected, rtol=0, atol=1e-12)
    greys = 255 * recording.image.sel(s=1, t=0).values[rows, columns]
    assert np.abs(read.colors[:, 0] - greys).max() <= 0.5 + 1e-6
    np.testing.assert_array_equal(read.colors[:, 0], read.colors[:, 2])
    vertex = plyfile.PlyData.read(file)["vertex"]
    for name, maps in (("n{}", own.normal), ("velocity_{}", own.velocity)):
        for axis, values in zip("xyz", maps.values, strict=True):
            np.testing.assert_array_equal(vertex[name.format(axis)], values[rows, columns].astype(np.float32))
    np.testing.assert_array_equal(vertex["growth_rate"], own.growth_rate.values[rows, columns].astype(np.float32))
    np.testing.assert_array_equal(vertex["object_id"], own.object_id.values[rows, columns])
    np.testing.assert_array_equal([vertex["column"], vertex["row"]], [columns, rows])


def test_cameras_see_one_surface(export: Export) -> None:
    # What different cameras see of the wall lies in one plane, so their points are in one frame.
    done = export("ply")
    points = []
    for s in (-1, 0, 1):
        vertex = plyfile.PlyData.read(done.folder / f"s{s:+d}_t+0.ply")["vertex"]
        wall = vertex["object_id"] == 0
        points.append(np.stack([vertex[name][wall] for name in "xyz"], axis=1))
    together = np.concatenate(points)
    scatter = np.linalg.svd(together - together.mean(axis=0), compute_uv=False)
    assert scatter[-1] < 1e-10 * scatter[0]


def test_real_cameras_see_one_surface_too(tmp_path: str) -> None:
    errors = {"repeatability_um": 200, "straightness_um": 300, "yaw_urad": 3000, "roll_urad": 4000}
    small = {"width": 32, "height": 24, "focal_length_px": 40}
    stage = {"positions": 3, "baseline_mm": 4.0, "errors": errors}
    shown = scene(camera=small, stage=stage, frames={"count": 1})
    recording, truth = st.simulate(shown, truth_views="all")
    done = st.export((recording, truth), "ply", output=f"{tmp_path}/ply")
    parts = [plyfile.PlyData.read(done.folder / f"s{s:+d}_t+0.ply")["vertex"] for s in (-1, 0, 1)]
    for number, normal_axes in ((0, ("nx", "ny", "nz")),):
        points = [np.stack([part[name][part["object_id"] == number] for name in "xyz"], axis=1) for part in parts]
        together = np.concatenate(points)
        _, scatter, axes = np.linalg.svd(together - together.mean(axis=0), full_matrices=False)
        assert scatter[-1] < 1e-10 * scatter[0]
        normals = np.concatenate([np.stack([part[name] for name in normal_axes], axis=1) for part in parts])
        walls = np.concatenate([part["object_id"] == number for part in parts])
        np.testing.assert_allclose(np.abs(normals[walls] @ axes[-1]), 1, atol=1e-6)


def test_single_precision_and_no_points_without_depth(export: Export, recording: xr.Dataset, tmp_path: str) -> None:
    done = export("ply", coordinates="float32")
    vertex = plyfile.PlyData.read(done.folder / "s+0_t+0.ply")["vertex"]
    assert vertex["x"].dtype == np.float32
    estimate = st.make_estimate(flow=np.zeros((2, 3, 48, 64)), recording=recording)
    with pytest.raises(st.ExportError, match="depth: is missing, and disparity too: there are no points"):
        st.export((recording, estimate), "ply", output=f"{tmp_path}/none")


def test_ply_has_both_parts_of_standard_deviations(recording: xr.Dataset, tmp_path: Path) -> None:
    shape = (recording.sizes["y"], recording.sizes["x"])
    std = np.linspace(0.1, 0.2, shape[0] * shape[1]).reshape(shape)
    estimate = st.make_estimate(depth=np.full(shape, 500.0), depth_std=std, recording=recording)
    estimate["depth_std_common"] = 0.5 * estimate["depth_std"]
    folder = st.export((recording, estimate), "ply", output=tmp_path / "both").folder
    vertex = plyfile.PlyData.read(folder / "s+0_t+0.ply")["vertex"]
    expected = std[vertex["row"], vertex["column"]]
    np.testing.assert_allclose(vertex["depth_std"], expected, rtol=1e-6)
    np.testing.assert_allclose(vertex["depth_std_common"], 0.5 * expected, rtol=1e-6)
