from __future__ import annotations

import numpy as np
import plyfile
import pytest
import trimesh
import xarray as xr

import scenetruth as st
from tests.export.conftest import Export, scene


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
