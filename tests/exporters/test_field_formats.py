"""Surfaces read back by meshio and as XML, and all maps read back by h5py."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.storage.stored_array import StoredArray
from tests.helpers.exported_scene import Export

GAUGE: dict[str, Any] = {"window": 5, "step": 2}


def read_mesh(file: Path) -> Any:
    """Read a mesh; meshio leaves closing its file to the garbage collector."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        return meshio.read(file)


def test_surface_has_the_points_displacements_and_strains(export: Export, truth: xr.Dataset) -> None:
    file = export("vtu", **GAUGE).folder / "s+0_t+0.vtu"
    mesh = read_mesh(file)
    strain = st.compute_strain(truth, settings=GAUGE).sel(t=0)
    known = np.isfinite(strain["displacement"].values).all(axis=0)
    np.testing.assert_allclose(mesh.points.T, strain["point"].values[:, known], rtol=1e-14)
    data = mesh.point_data
    np.testing.assert_array_equal(data["displacement [mm]"].T, strain["displacement"].values[:, known])
    for name in ("exx", "eyy", "exy", "e1", "e2"):
        np.testing.assert_array_equal(data[f"{name} [1]"], strain[name].values[known])
    rows, columns = np.nonzero(known)
    np.testing.assert_array_equal(
        data["pixel [px]"][:, :2], np.stack([strain["x"][columns], strain["y"][rows]], axis=1)
    )
    root = ET.parse(file).getroot()
    assert root.attrib["type"] == "UnstructuredGrid"
    assert root.find(".//Piece").attrib["NumberOfPoints"] == str(known.sum())  # type: ignore[union-attr]


def test_surface_of_an_estimate_has_the_standard_deviations_of_its_displacements(
    recording: xr.Dataset, truth: xr.Dataset, tmp_path: Path
) -> None:
    own, stds = truth.sel(s=0), (0.01, 0.02, 0.05)
    velocity = own["velocity"].values
    std = np.where(np.isfinite(velocity), np.reshape(stds, (3, 1, 1, 1)), np.nan)
    estimate = st.make_estimate(
        recording=recording, depth=own["depth"].values, velocity=velocity, velocity_std=std, t=own["t"].values
    )
    folder = st.export((recording, estimate), "vtu", output=tmp_path / "vtu", window=5, step=2).folder
    mesh = read_mesh(folder / "s+0_t+0.vtu")
    found = mesh.point_data["displacement_std [mm]"]
    np.testing.assert_allclose(found, np.tile(stds, (len(mesh.points), 1)), rtol=1e-6)


def test_paraview_has_the_files_with_their_times(tmp_path: Path) -> None:
    recording = st.make_recording(np.zeros((2, 3, 9, 12)), focal_length_px=80, baseline_mm=4, frame_interval_s=3600)
    frames = recording["t"].values
    maps = np.full((3, 9, 12), 100.0), np.zeros((3, 3, 9, 12))
    estimate = st.make_estimate(recording=recording, depth=maps[0], velocity=maps[1], t=frames)
    folder = st.export((recording, estimate), "vtu", output=tmp_path / "vtu", window=3, step=2).folder
    listed = ET.parse(folder / "surface.pvd").getroot().findall("Collection/DataSet")
    assert [(each.attrib["timestep"], each.attrib["file"]) for each in listed] == [
        (repr(t * 3600.0), f"s+0_t{t:+d}.vtu") for t in frames.tolist()
    ]
    assert all((folder / each.attrib["file"]).is_file() for each in listed)


def test_frames_without_points_have_no_file_and_lone_points_are_vertices(tmp_path: Path) -> None:
    recording = st.make_recording(np.zeros((2, 3, 9, 12)), focal_length_px=80, baseline_mm=4)
    depth = np.full((3, 9, 12), np.nan)
    depth[1, 3, 5] = 100.0
    estimate = st.make_estimate(
        recording=recording, depth=depth, velocity=0 * np.stack([depth] * 3), t=recording["t"].values
    )
    done = st.export((recording, estimate), "vtu", output=tmp_path / "vtu", window=3, step=2)
    assert done.files == ("s+0_t+0.vtu", "surface.pvd")
    listed = ET.parse(done.folder / "surface.pvd").getroot().findall("Collection/DataSet")
    assert [each.attrib["file"] for each in listed] == ["s+0_t+0.vtu"]
    mesh = read_mesh(done.folder / "s+0_t+0.vtu")
    np.testing.assert_array_equal(mesh.points[:, 2], [100.0])
    assert [(cells.type, cells.data.tolist()) for cells in mesh.cells] == [("vertex", [[0]])]
    assert np.isnan(mesh.point_data["exx [1]"]).all()
    assert "no strain: " in done.notes[1]
    assert done.notes[-1].startswith("no files for the frames [-1, 1]: ")


def test_cells_are_whole_squares_of_one_object(export: Export, truth: xr.Dataset) -> None:
    mesh = read_mesh(export("vtu", **GAUGE).folder / "s+0_t+0.vtu")
    (cells,) = mesh.cells
    assert cells.type == "quad"
    pixel = mesh.point_data["pixel [px]"][:, :2].astype(int)
    corners = pixel[cells.data]
    np.testing.assert_array_equal(
        corners - corners[:, :1], np.broadcast_to([[0, 0], [2, 0], [2, 2], [0, 2]], corners.shape)
    )
    objects = truth["object_id"].sel(s=0, t=0).values[corners[..., 1], corners[..., 0]]
    assert (objects == objects[:, :1]).all()
    assert {0, 1} == set(objects.ravel().tolist())
    # Every square of one object whose corners are near each other is a cell.
    number = truth["object_id"].sel(s=0, t=0).values[1::2, 1::2]
    same = (
        (number[1:, 1:] == number[:-1, 1:])
        & (number[1:, :-1] == number[:-1, :-1])
        & (number[1:, 1:] == number[1:, :-1])
    )
    assert len(cells.data) == (same & (number[1:, 1:] >= 0)).sum()


def test_hdf5_describes_itself(export: Export, truth: xr.Dataset) -> None:
    with h5py.File(export("hdf5", **GAUGE).folder / "maps.h5") as file:
        assert set(file) == {"truth", "strain"}
        maps = file["truth"]
        for name, item in truth.data_vars.items():
            made = maps[str(name)]
            np.testing.assert_array_equal(made[()], item.values)
            assert made.attrs["units"] == item.attrs["units"]
            assert made.attrs["long_name"] == item.attrs["long_name"]
            assert [dim.label for dim in made.dims] == list(item.dims)
        np.testing.assert_array_equal(maps["depth"].dims[1][0][()], truth["t"].values)
        assert [name.decode() for name in maps["component"][()]] == ["X", "Y", "Z"]
        assert maps.attrs["focal_length_px"] == 80
        strain = st.compute_strain(truth, settings=GAUGE)
        np.testing.assert_array_equal(file["strain"]["exx"][()], strain["exx"].values)
        # Components first, as in the other groups.
        np.testing.assert_array_equal(file["strain"]["point"][()], strain["point"].values)
        assert file["strain"].attrs["gauge_length_px"] == strain.attrs["gauge_length_px"]
        assert file["strain"]["angle"].attrs["units"] == "rad"
        # Times and frames are those of the maps, not of the first frame.
        for name in ("t", "time_s"):
            np.testing.assert_array_equal(file["strain"][name][()], truth[name].values)
        assert file["strain"].attrs["gauge_length_mm"] == pytest.approx(strain.attrs["gauge_length_mm"], rel=0.05)


def test_hdf5_is_written_frame_by_frame(
    recording: xr.Dataset, truth: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames, read, sizes = truth.sizes["t"], StoredArray.read, []

    def reading(self: StoredArray, key: tuple[Any, ...]) -> NDArray[Any]:
        values = read(self, key)
        sizes.append(values.size * frames / np.prod(self.shape))
        return values

    stored = st.open_store(st.save_store(truth, tmp_path / "truth.zarr"))
    monkeypatch.setattr(StoredArray, "read", reading)
    folder = st.export((recording, stored), "hdf5", output=tmp_path / "h5", **GAUGE).folder
    assert frames > 1
    assert len(sizes) > 2 * frames
    # Maps of one frame at most are in memory.
    assert max(sizes) <= 1
    with h5py.File(folder / "maps.h5") as file:
        np.testing.assert_array_equal(file["truth"]["velocity"][()], truth["velocity"].values)
        assert file["truth"]["depth"].chunks == (1, 1, *truth["depth"].shape[2:])


def test_hdf5_of_a_depth_map_has_no_strain(recording: xr.Dataset, truth: xr.Dataset, tmp_path: Path) -> None:
    depth = truth["depth"].sel(s=0).values
    still = st.make_estimate(recording=recording, depth=depth)
    done = st.export((recording, still), "hdf5", output=tmp_path / "h5", images=True)
    assert done.notes == ("no strain: it needs depth and motion",)
    with h5py.File(done.folder / "maps.h5") as file:
        assert set(file) == {"estimate", "recording"}
        np.testing.assert_array_equal(file["estimate"]["depth"][()], still["depth"].values)
        np.testing.assert_array_equal(file["recording"]["image"][()], recording["image"].values)
