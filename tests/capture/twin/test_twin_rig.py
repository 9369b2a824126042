"""Rigs of twins: poses and lens of a calibration, and sensors with the noise that was measured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from scenetruth.camera import Camera, EmvaSensor, GaussianSensor, Schedule, Stage, build_sensor_chain
from scenetruth.capture import Capture, RigCalibration, open_capture
from scenetruth.capture.twin import NoiseLine, describe_sensor, make_rig
from scenetruth.schema import make_recording
from tests.helpers.captured_folders import write_capture

FOCAL_PX = 2000.0
LENS = {"k1": -0.3, "k2": 0.5, "p1": 1e-3, "p2": -5e-4}


def capture(**stage: Any) -> Capture:
    plain = {
        "camera": {"width": 320, "height": 240, "focal_length_px": FOCAL_PX},
        "stage": {"positions_mm": [-9, -5, 0, 4, 10], "errors": {"preset": "screw_stage"}, **stage},
        "frames": {"count": 3, "frame_interval_s": 30},
        "files": {"images": "s{s:+d}_t{t:+d}.tif"},
    }
    return Capture.from_dict(plain)


def calibration(seed: int) -> RigCalibration:
    """Return a calibration with drawn poses and axis."""
    camera = Camera(width=320, height=240, focal_length_px=FOCAL_PX, principal_point_px=(161, 118), distortion=LENS)
    made = RigCalibration.from_camera(camera, [-9, -5, 0, 4, 10])
    draw, scales = np.random.default_rng(seed), {"axis_y": 3e-3, "axis_z": 3e-3, "step_scale": 1e-4}
    for index, name in enumerate(made.names):
        scale = scales.get(name)
        if name.startswith("position"):
            scale = 1e-4 if name.endswith(("pitch", "yaw", "roll")) else 5e-3
        if scale is not None:
            made.values[index] = scale * draw.standard_normal()
    return made


def recording(stage: Any = (-9, -5, 0, 4, 10), **attrs: Any) -> Any:
    return make_recording(np.zeros((5, 3, 240, 320), np.float32), FOCAL_PX, 5.0, stage_x_mm=stage, attrs=attrs)


@given(seed=st.integers(0, 10**6), rectified=st.booleans())
@settings(max_examples=15, deadline=None)
def test_the_stage_of_the_scene_has_the_poses_of_the_calibration(seed: int, rectified: bool) -> None:
    given_, rig = capture(), calibration(seed)
    made = make_rig(given_, rig, recording(**({"geometry": "rectified"} if rectified else {})))
    stage = Stage.model_validate({**made.stage, "errors": None})
    schedule = Schedule(stage, given_.frames, lambda *_: np.random.default_rng(0))
    camera = Camera.model_validate(made.camera)
    points = np.random.default_rng(seed).uniform((-40, -30, 550), (40, 30, 700), (20, 3))
    # The frame of the recording has X along the axis if it is rectified.
    world = points @ made.reference_rotation.T
    for number, s in enumerate(stage.s.tolist()):
        here = camera.project(schedule.moment(s, 0).viewpoint.to_camera(world))
        there = rig.camera.project(rig.viewpoint(number).to_camera(points))
        # Offsets have 1e-6 µm and angles 1e-6 µrad; sums of rotation vectors are exact.
        assert np.abs(here - there).max() < 1e-6
    if rectified:
        assert made.reference_rotation @ rig.axis == pytest.approx([1, 0, 0], abs=1e-12)
        assert "axis_tilt_urad" not in made.stage
    else:
        assert (made.reference_rotation == np.eye(3)).all()
        tilt = np.array([1.0, *(1e-6 * np.array(made.stage["axis_tilt_urad"]))])
        assert tilt / np.linalg.norm(tilt) == pytest.approx(rig.axis, abs=1e-9)


def test_without_a_calibration_the_guide_is_ideal_and_visits_vary() -> None:
    made = make_rig(capture(), None, recording())
    assert made.stage["errors"] == {"repeatability_um": 1.0, "backlash_um": 5.0}
    assert "poses" not in made.stage
    assert made.camera["focal_length_px"] == FOCAL_PX


def test_visits_that_a_strip_has_measured_have_no_errors() -> None:
    given_, rig = recording(geometry="rectified"), calibration(2)
    share = np.ones((5, 3, 240, 320), np.float32)
    with_visits = given_.assign(noise_share=(("s", "t", "y", "x"), share))
    without = given_.assign(noise_share=(("s", "y", "x"), share[:, 0]))
    assert make_rig(capture(), rig, with_visits).stage["errors"]["repeatability_um"] == 0
    assert make_rig(capture(), rig, without).stage["errors"]["repeatability_um"] == 1


def test_measured_positions_are_those_of_the_stage() -> None:
    made = make_rig(capture(), None, recording(stage=[-9.2, -5.0, 0.0, 4.1, 10.0]))
    assert Stage.model_validate({**made.stage, "errors": None}).x_mm.tolist() == [-9.2, -5.0, 0.0, 4.1, 10.0]


def test_rotations_of_the_reference_camera_are_kept() -> None:
    rig = calibration(4)
    rig.values[rig.names.index("axis_y")] = 5e-3
    made = make_rig(capture(), rig, recording(geometry="rectified"))
    turned = Rotation.from_matrix(made.reference_rotation).magnitude()
    assert turned == pytest.approx(np.arccos(rig.axis[0]), rel=0.1)


def test_the_sensor_has_the_noise_of_dark_frames_and_flat_fields(tmp_path: Path) -> None:
    made = write_capture(tmp_path / "leaf", seed=2)
    found = describe_sensor(open_capture(made.folder), None)
    sensor, truth = EmvaSensor.model_validate(found.section), made.sensor
    assert found.origin == "dark frames and flat fields"
    assert sensor.gain_dn_per_e == pytest.approx(truth.gain_dn_per_e, rel=0.05)
    assert sensor.temporal_dark_noise_e == pytest.approx(truth.temporal_dark_noise_e, rel=0.1)
    assert sensor.black_level_dn == pytest.approx(truth.black_level_dn, abs=0.5)
    assert sensor.bit_depth == truth.bit_depth
    # Radiance 1 is full scale.
    assert build_sensor_chain(sensor).saturation_radiance == pytest.approx(1.0, rel=0.01)
    electrons = 0.5 * truth.saturation_capacity_e
    span = 2**truth.bit_depth - 1 - truth.black_level_dn
    expected = truth.gain_dn_per_e**2 * (electrons + truth.temporal_dark_noise_e**2) / span**2
    level = electrons * truth.gain_dn_per_e / span
    assert found.noise.variance(np.array(level)) == pytest.approx(expected, rel=0.1)


def test_without_dark_frames_the_images_give_the_noise(tmp_path: Path) -> None:
    made = write_capture(tmp_path / "leaf", seed=2)
    made.plain["files"] = {"images": made.plain["files"]["images"]}
    made.write()
    folder = open_capture(made.folder)
    even = describe_sensor(folder, NoiseLine(1e-4, 0.0))
    assert even.origin == "differences of the images"
    assert GaussianSensor.model_validate(even.section).noise_std == pytest.approx(0.01, rel=0.01)
    shot = describe_sensor(folder, NoiseLine(1e-6, 2e-4))
    sensor = EmvaSensor.model_validate(shot.section)
    assert sensor.gain_dn_per_e == pytest.approx(2e-4 * (2**sensor.bit_depth - 1 - sensor.black_level_dn), rel=1e-4)
    assert describe_sensor(folder, None).origin == "quantisation alone"
