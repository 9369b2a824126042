"""Times, tolerances and lens of a recording: read as given, kept by stores and simulations, checked all together."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scenetruth as st
from scenetruth.schema import check_dataset, read_acquisition, tolerance_attributes

IMAGES = np.zeros((3, 4, 5, 6))
TIMES = 10.0 * np.arange(4) + 2.0 * np.arange(3)[:, None]
GOOD: dict[str, Any] = {
    "images": IMAGES,
    "focal_length_px": 100.0,
    "baseline_mm": 5.0,
    "frame_interval_s": 10.0,
    "planned_time_s": TIMES,
    "line_time_s": 1e-3,
    "distortion": (-0.1, 0.02, 0.0, 0.0),
    "stage_tolerances": {"yaw_urad": 20.0, "repeatability_um": 1.0},
    "lens_tolerances": {"focal_length_std_px": 0.5, "principal_point_std_px": [1.0, 2.0], "distortion_std": [0.01] * 4},
}


def test_what_is_stated_is_read_and_kept(tmp_path: Path) -> None:
    recording = st.make_recording(**GOOD)
    st.save_store(recording, tmp_path / "recording.zarr")
    for each in (recording, st.load_store(tmp_path / "recording.zarr", kind="recording")):
        found = read_acquisition(each)
        np.testing.assert_array_equal(found.time_s[0], TIMES)
        assert (found.line_time_s, found.stage.yaw_urad, found.stage.repeatability_um) == (1e-3, 20.0, 1.0)
        assert found.distortion.tolist() == [-0.1, 0.02, 0, 0, 0, 0, 0, 0]
        assert (found.focal_length_std_px, found.principal_point_std_px) == (0.5, (1.0, 2.0))
        assert found.distortion_std.tolist() == [0.01] * 4 + [0.0] * 4
        assert found.tolerances_stated
        assert each["planned_time_s"].attrs["units"] == "s"
    part = read_acquisition(recording.isel(t=slice(1, None), s=slice(0, 2), x=slice(2, None)))
    np.testing.assert_array_equal(part.time_s[0], TIMES[:2, 1:])


def test_nothing_stated_is_a_simultaneous_pinhole_rig() -> None:
    recording = st.make_recording(IMAGES, 100.0, 5.0, frame_interval_s=10.0, distortion=[0.0] * 5)
    found = read_acquisition(recording)
    np.testing.assert_array_equal(found.time_s[0], np.broadcast_to([-10.0, 0.0, 10.0, 20.0], (3, 4)))
    assert not found.tolerances_stated
    assert not found.distortion.size
    assert not found.stage.corrects


def test_grid_has_a_time_for_every_image() -> None:
    times = TIMES + np.arange(2)[:, None, None] * 0.5
    recording = st.make_recording(
        np.zeros((2, 3, 4, 5, 6)), 100.0, 5.0, frame_interval_s=10.0, stage_y_mm=[0, 5], planned_time_s=times
    )
    assert recording["planned_time_s"].dims == ("s_y", "s", "t")
    np.testing.assert_array_equal(read_acquisition(recording).time_s, times)
    np.testing.assert_array_equal(read_acquisition(recording.sel(s_y=1)).time_s[0], times[1])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"planned_time_s": TIMES[:2]}, r"planned_time_s: must hold one time for each image, shape \(3, 4\)"),
        ({"planned_time_s": np.where(TIMES == 12, np.nan, TIMES)}, "planned_time_s: must hold finite numbers"),
        ({"planned_time_s": TIMES[:, ::-1]}, "planned_time_s: must increase along t, but does not after s=-1, t=-1"),
        ({"planned_time_s": TIMES / 60}, "planned_time_s: has frames 0.166667 s apart, but frame_interval_s is 10 s"),
        ({"line_time_s": -1.0}, r"attrs\.line_time_s: must be a finite number, not negative"),
        ({"line_time_s": float("nan")}, "line_time_s: must be a finite number"),
        ({"distortion": []}, r"attrs\.distortion: must hold 4, 5 or 8 coefficients in the order k1, k2, p1"),
        ({"distortion": [0.1, np.nan, 0, 0]}, r"attrs\.distortion: must be a list of finite numbers"),
        ({"distortion": None}, r"attrs\.distortion_std: states the uncertainty of a lens without coefficients"),
        ({"distortion": [0.1] * 5}, r"attrs\.distortion_std: must hold one value for each of the 5 coefficients"),
        ({"stage_tolerances": {"yaw": 1.0}}, r"stage_tolerances\.yaw: is no tolerance; these are pitch_urad, yaw_urad"),
        ({"stage_tolerances": 3}, "stage_tolerances: must be a mapping"),
        ({"stage_tolerances": {"yaw_urad": -1.0}}, r"stage_tolerance_yaw_urad: must not be negative.* \(got -1\.0\)"),
        ({"stage_tolerances": {"yaw_urad": np.nan}}, "stage_tolerance_yaw_urad: must be a finite number"),
        ({"stage_tolerances": {"roll_urad": 1e6}}, "stage_tolerance_roll_urad: must be at most 100000 urad"),
        ({"stage_tolerances": {"repeatability_um": 4e3}}, "repeatability_um: exceeds half the smallest step of 5 mm"),
        ({"lens_tolerances": {"focal_length_std_px": 80.0}}, "focal_length_std_px: must be at most half of it"),
        ({"lens_tolerances": {"principal_point_std_px": [1, -1]}}, r"principal_point_std_px\.1: must not be negative"),
        ({"stage_x_mm": [0.0, 5.0, 5.0]}, "stage_x_mm: has positions that coincide"),
    ],
)
def test_bad_values_are_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(st.RecordingError, match=message):
        st.make_recording(**{**GOOD, **changes})


def test_all_problems_at_once() -> None:
    recording = st.make_recording(**GOOD)
    recording.attrs |= {"stage_tolerance_pitch_urad": -3.0, "distortion": [], "focal_length_std_px": np.inf}
    recording = recording.assign_coords(
        planned_time_s=(("s", "t"), TIMES[:, ::-1]),
        stage_x_mm=("s", [0.0, 0.0, 5.0]),
    )
    with pytest.raises(st.RecordingError) as caught:
        check_dataset(recording, "recording")
    assert {problem.path for problem in caught.value.problems} >= {
        "attrs.stage_tolerance_pitch_urad",
        "attrs.distortion",
        "attrs.focal_length_std_px",
        "planned_time_s",
        "stage_x_mm",
    }


def test_attributes_of_tolerances_are_checked_by_name() -> None:
    with pytest.raises(st.RecordingError, match=r"attrs\.stage_tolerance_yaw: is no tolerance"):
        st.make_recording(IMAGES, 100.0, 5.0, attrs=tolerance_attributes({"yaw": 3.0}))


def test_simulated_recordings_state_what_a_laboratory_knows() -> None:
    """The statistics of the errors, and the times of the scan that the truth has, but not the errors drawn."""
    wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 100]}}
    scene: dict[str, Any] = {
        "camera": {"width": 40, "height": 30, "focal_length_px": 60, "distortion": {"k1": -0.1}},
        "objects": [wall | {"texture": {"kind": "uniform"}}],
        "stage": {"positions": 3, "baseline_mm": 5, "time_per_position_s": 2.0, "scan": "bidirectional"},
        "frames": {"count": 3, "frame_interval_s": 60.0},
        "shutter": {"readout_time_s": 2.9, "stage_speed_mm_per_s": 0.1},
        "render": {"backend": "raycast", "supersampling": 1},
    }
    scene["stage"]["errors"] = {"preset": "screw_stage"}
    recording, truth = st.simulate(scene)
    found = read_acquisition(recording)
    np.testing.assert_allclose(found.time_s[0], truth["image_time_s"].values, atol=1e-12)
    stage = found.stage
    assert (stage.yaw_urad, stage.straightness_um, stage.repeatability_um, stage.backlash_um) == (100.0, 5.0, 1.0, 5.0)
    assert found.distortion.tolist() == [-0.1, 0, 0, 0, 0, 0, 0, 0]
    assert found.line_time_s == pytest.approx(0.1)
    assert found.stage_speed_mm_per_s == 0.1
    # Approached from one side only, backlash displaces all positions alike.
    scene["stage"]["scan"] = "unidirectional"
    assert read_acquisition(st.simulate(scene).recording).stage.backlash_um == 0.0
