"""Tables of points read back by pandas, against the truth, the projection of points, and the strain of the scene."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import scenetruth as st
from tests.helpers.exported_scene import Export

GAUGE: dict[str, Any] = {"window": 5, "step": 2}
FOCAL_PX, CENTRE_PX = 80, (31.5, 23.5)
TABLES = {"point_csv": "s+0_t+0.csv", "vic3d": "s+0_t+0.csv", "matchid": "s+0_t+0.csv", "dice": "DICe_solution_1.txt"}
"""The file of frame 0; DICe numbers files, from frame -1 on."""

COMMON = {
    "vic3d": {
        **{name: f"{name} [mm]" for name in "XYZUVW"},
        **{name: f"{name} [1] - Lagrange" for name in ("exx", "eyy", "exy")},
        **{"x": "x [pixel]", "y": "y [pixel]"},
    },
    "dice": {
        **{name: f"MODEL_COORDINATES_{name}" for name in "XYZ"},
        **dict(zip("UVW", (f"MODEL_DISPLACEMENT_{name}" for name in "XYZ"), strict=True)),
        **{name: f"VSG_STRAIN_{name[1:].upper()}" for name in ("exx", "eyy", "exy")},
        **{"x": "COORDINATE_X", "y": "COORDINATE_Y"},
    },
    "matchid": {
        **{name: f"coor.{name} [mm]" for name in "XYZ"},
        "U": "disp.Horizontal Displacement U [mm]",
        "V": "disp.Vertical Displacement V [mm]",
        "W": "disp.Out-Of-Plane: W [mm]",
        **{name: f"strain.Strain-global frame: E{name[1:]} [ ]" for name in ("exx", "eyy", "exy")},
        **{"x": "Coordinates.Image X [Pixel]", "y": "Coordinates.Image Y [Pixel]"},
    },
}


def read_table(file: Path) -> pd.DataFrame:
    """Return a table with its numbers to the last digit, which pandas 2 does not read."""
    return pd.read_csv(file, dtype=str).astype(float)


def table(export: Export, format: str, **options: object) -> pd.DataFrame:
    """Return the points with a result."""
    found = read_table(export(format, **GAUGE, **options).folder / TABLES[format])
    return found if format != "dice" else found[found["SIGMA"] >= 0].reset_index(drop=True)


def at_points(maps: xr.DataArray, found: pd.DataFrame) -> np.ndarray:
    """Return the values of a map at the pixels of a table."""
    where = {axis: xr.DataArray(found[f"{axis} [px]"].astype(int), dims="p") for axis in ("x", "y")}
    return np.asarray(maps.sel(where).values)


def test_points_and_displacements_are_those_of_the_truth(export: Export, truth: xr.Dataset) -> None:
    found = table(export, "point_csv")
    own = truth.sel(s=0, t=0)
    assert len(found) == np.isfinite(own["depth"].values[1::2, 1::2]).sum()
    np.testing.assert_array_equal(found["Z [mm]"], at_points(own["depth"], found))
    x, y, z = (found[f"{name} [mm]"] for name in "XYZ")
    for pixel, place, centre in ((found["x [px]"], x, CENTRE_PX[0]), (found["y [px]"], y, CENTRE_PX[1])):
        np.testing.assert_allclose(FOCAL_PX * place / z + centre, pixel, atol=1e-11)
    moved = at_points(own["displacement_next"], found)
    for name, values in zip("UVW", moved, strict=True):
        np.testing.assert_array_equal(found[f"{name} [mm]"], values)


def test_strains_are_those_of_the_library(export: Export, truth: xr.Dataset) -> None:
    found = table(export, "point_csv", measure="hencky")
    strain = st.compute_strain(truth, settings={**GAUGE, "measure": "hencky"}).sel(t=0)
    for name in ("exx", "eyy", "exy", "e1", "e2"):
        np.testing.assert_array_equal(found[f"{name} [1]"], at_points(strain[name], found))
    # All bodies of the scene are rigid.
    assert found["exx [1]"].notna().sum() > 400
    np.testing.assert_allclose(found["e1 [1]"].dropna(), 0, atol=1e-12)


@pytest.mark.parametrize("format", sorted(COMMON))
def test_programs_find_the_same_numbers_in_their_own_columns(export: Export, format: str) -> None:
    own, other = table(export, "point_csv"), table(export, format)
    for name, column in COMMON[format].items():
        unit = "px" if name in "xy" else "mm" if len(name) == 1 else "1"
        np.testing.assert_array_equal(other[column], own[f"{name} [{unit}]"])


@pytest.mark.parametrize(
    ("measure", "name"), [("green_lagrange", "Lagrange"), ("hencky", "Hencky"), ("engineering", "engr.")]
)
def test_headings_of_vic_state_the_tensor(export: Export, measure: str, name: str) -> None:
    found = read_table(export("vic3d", measure=measure, **GAUGE).folder / TABLES["vic3d"])
    assert [column for column in found if column.startswith("e")] == [
        f"{each} [1] - {name}" for each in ("exx", "eyy", "exy", "e1", "e2")
    ]


def test_files_of_dice_sort_by_their_frames(tmp_path: Path) -> None:
    """Numbers have as many digits as the number of frames, as those of the program."""
    recording = st.make_recording(np.zeros((2, 12, 9, 12)), focal_length_px=80, baseline_mm=4)
    maps = np.full((12, 9, 12), 100.0), np.zeros((3, 12, 9, 12))
    estimate = st.make_estimate(recording=recording, depth=maps[0], velocity=maps[1], t=recording["t"].values)
    folder = st.export((recording, estimate), "dice", output=tmp_path / "dice", window=3, step=2).folder
    assert sorted(file.name for file in folder.glob("*.txt")) == [f"DICe_solution_{n:02d}.txt" for n in range(12)]


def test_image_motion_and_sigma_of_vic_and_dice(export: Export, truth: xr.Dataset) -> None:
    own, vic, dice = (table(export, format) for format in ("point_csv", "vic3d", "dice"))
    flow = at_points(truth["flow_next"].sel(s=0, t=0), own)
    for axis, (one, other) in enumerate((("u [pixel]", "DISPLACEMENT_X"), ("v [pixel]", "DISPLACEMENT_Y"))):
        np.testing.assert_array_equal(vic[one], flow[axis])
        np.testing.assert_array_equal(dice[other], flow[axis])
    assert (vic["sigma [pixel]"] == 0).all()
    assert (dice["STATUS_FLAG"] == 4).all()


def test_subsets_of_dice_are_the_same_in_every_frame(recording: xr.Dataset, truth: xr.Dataset, tmp_path: Path) -> None:
    own, places = truth.sel(s=0), {}
    hole = np.zeros(own["depth"].shape, bool)
    hole[1, 10:20, 20:40] = True
    depth = np.where(hole, np.nan, own["depth"].values)
    estimate = st.make_estimate(
        recording=recording, depth=depth, velocity=np.where(hole, np.nan, own["velocity"].values), t=own["t"].values
    )
    folder = st.export((recording, estimate), "dice", output=tmp_path / "dice", **GAUGE).folder
    for number in range(own.sizes["t"]):
        file = folder / f"DICe_solution_{number}.txt"
        found = read_table(file)
        # NumPy reads every line, which it does not if a cell is empty.
        assert np.loadtxt(file, delimiter=",", skiprows=1).shape == found.shape
        place = found[["COORDINATE_X", "COORDINATE_Y"]].to_numpy().astype(int)
        failed = ~np.isfinite(depth[number, place[:, 1], place[:, 0]])
        np.testing.assert_array_equal(found["SIGMA"] == -1, failed)
        np.testing.assert_array_equal(found["STATUS_FLAG"], np.where(failed, 8, 4))
        for name in ("DISPLACEMENT_X", "MODEL_COORDINATES_Z", "MODEL_DISPLACEMENT_X"):
            np.testing.assert_array_equal(found[name].isna(), failed)
        places[number] = found[["SUBSET_ID", "COORDINATE_X", "COORDINATE_Y"]]
        assert places[number].equals(places[0])
    assert (place[:, 0] > 0).any()
    assert places[0]["SUBSET_ID"].is_unique


def test_displacements_have_the_standard_deviations_of_the_velocities(
    recording: xr.Dataset, truth: xr.Dataset, tmp_path: Path
) -> None:
    own = truth.sel(s=0)
    velocity = own["velocity"].values
    std = np.where(np.isfinite(velocity), np.array([0.01, 0.02, 0.05]).reshape(3, 1, 1, 1), np.nan)
    estimate = st.make_estimate(
        recording=recording, depth=own["depth"].values, velocity=velocity, velocity_std=std, t=own["t"].values
    )
    for axes, words in (("camera", "axes: X right, Y down, Z forward"), ("y_up", "axes: X right, Y up, Z towards")):
        done = st.export((recording, estimate), "point_csv", output=tmp_path / axes, axes=axes, **GAUGE)
        found = read_table(done.folder / TABLES["point_csv"])
        for name, expected in zip("UVW", (0.01, 0.02, 0.05), strict=True):
            np.testing.assert_allclose(found[f"{name}_std [mm]"], expected, rtol=1e-6)
        assert words in done.notes[0]
        assert "since=T" in done.notes[1]
    done = st.export((recording, estimate), "point_csv", output=tmp_path / "since", since=-1, **GAUGE)
    assert "U_std [mm]" not in read_table(done.folder / TABLES["point_csv"])
    assert not any("since=T" in note for note in done.notes)


def test_y_upwards_turns_the_frame_by_half_a_turn_about_x(
    export: Export, recording: xr.Dataset, truth: xr.Dataset, tmp_path: Path
) -> None:
    down = table(export, "point_csv")
    folder = st.export((recording, truth), "point_csv", output=tmp_path / "up", axes="y_up", **GAUGE).folder
    up = read_table(folder / TABLES["point_csv"])
    for name in ("Y [mm]", "Z [mm]", "V [mm]", "W [mm]", "exy [1]"):
        np.testing.assert_array_equal(up[name], -down[name])
    for name in ("X [mm]", "U [mm]", "exx [1]", "eyy [1]", "e1 [1]"):
        np.testing.assert_array_equal(up[name], down[name])


def test_estimate_states_its_noise_and_its_motion(recording: xr.Dataset, truth: xr.Dataset, tmp_path: Path) -> None:
    own, rng = truth.sel(s=0), np.random.default_rng(0)
    noise = 0.01
    velocity = own["velocity"].values + noise * rng.standard_normal(own["velocity"].shape)
    estimate = st.make_estimate(
        recording=recording,
        depth=own["depth"].values,
        velocity=velocity,
        velocity_std=np.where(np.isfinite(velocity), noise, np.nan),
        depth_std=np.where(np.isfinite(own["depth"].values), 0.02, np.nan),
    ).assign_attrs(settings=json.dumps({"window_sigma_px": 1.0}))
    done = st.export((recording, estimate), "point_csv", output=tmp_path / "csv", **GAUGE)
    found = read_table(done.folder / TABLES["point_csv"])
    assert "velocity at frame t over one frame" in done.notes[0]
    strain = st.compute_strain(estimate, settings=GAUGE).sel(t=0)
    np.testing.assert_array_equal(found["exx_std [1]"], at_points(strain["exx_std"], found))
    np.testing.assert_allclose(found["depth_std [mm]"], 0.02, rtol=1e-6)
    ratio = (found["exx [1]"] / found["exx_std [1]"]).dropna()
    # Rigid bodies: all strain is noise, overstated for a correlation that it does not have.
    assert len(ratio) > 100
    assert np.sqrt((ratio**2).mean()) < 1


def test_data_without_motion_are_rejected_before_work(recording: xr.Dataset, truth: xr.Dataset, tmp_path: Path) -> None:
    still = st.make_estimate(recording=recording, depth=truth["depth"].sel(s=0).values)
    with pytest.raises(st.ExportError, match="velocity: is missing"):
        st.export((recording, still), "vic3d", output=tmp_path / "csv")
    with pytest.raises(st.ExportError, match="odd number"):
        st.export((recording, truth), "vic3d", output=tmp_path / "csv", window=4)
    with pytest.raises(st.ExportError, match="measure"):
        st.export((recording, truth), "dice", output=tmp_path / "csv", measure="hencky")
    assert not (tmp_path / "csv").exists()


def test_points_of_a_frame_are_tracked(recording: xr.Dataset, truth: xr.Dataset, tmp_path: Path) -> None:
    """Displacements since a frame, as other programs state them: the projection of the moved point is its pixel."""
    done = st.export((recording, truth), "vic3d", output=tmp_path / "vic", since=-1, **GAUGE)
    assert "from frame -1 to frame t" in done.notes[0]
    found = read_table(done.folder / "s+0_t+1.csv")
    ends = [found[f"{name} [mm]"] + found[f"{moved} [mm]"] for name, moved in zip("XYZ", "UVW", strict=True)]
    for axis, name in enumerate("xy"):
        pixel = FOCAL_PX * ends[axis] / ends[2] + CENTRE_PX[axis]
        motion = found[f"{'uv'[axis]} [pixel]"]
        np.testing.assert_allclose(pixel - found[f"{name} [pixel]"], motion, atol=1e-11)
    strain = st.compute_strain(truth, since=-1, settings=GAUGE).sel(t=1)
    assert found["exx [1] - Lagrange"].notna().sum() == strain["valid"].sum()
    still = read_table(done.folder / "s+0_t-1.csv")
    assert (still[["U [mm]", "V [mm]", "W [mm]"]] == 0).all(axis=None)
    with pytest.raises(st.ExportError, match="since: must be one of the frames"):
        st.export((recording, truth), "hdf5", output=tmp_path / "h5", since=7)
