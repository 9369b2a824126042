"""Calibration of a capture with a fiducial strip: poses of the measurement, their use by import and estimate, files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from scenetruth import load_store
from scenetruth.camera import Camera, Distortion, Viewpoint
from scenetruth.capture import RigCalibration, calibrate_capture, import_capture, open_capture, run_capture
from scenetruth.capture.calibration import CalibrationError, RigGeometry, rotation_matrix, triangulate
from scenetruth.errors import CaptureError
from tests.helpers.board_captures import changed_capture, constant_depth, make_board_capture

Calibrated = tuple[Path, RigCalibration, Path]


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    folder = make_board_capture(tmp_path_factory.mktemp("strip") / "c", strip=True, poses=4, dark=4, flat=4, static=0)
    output = tmp_path_factory.mktemp("calibrated")
    return folder, calibrate_capture(folder, output=output), output


def seen_depth(folder: Path, found: RigCalibration, frame: int) -> tuple[float, float]:
    """Return the error of the depth that a calibration gives for the true images of points, and its deviation."""
    true = yaml.safe_load((folder / "truth" / "parameters.yaml").read_text(encoding="utf-8"))
    camera = Camera(
        width=240, height=180, focal_length_px=true["camera"]["focal_length_px"],
        principal_point_px=true["camera"]["principal_point_px"], distortion=Distortion(**true["camera"]["distortion"]),
    )  # fmt: skip
    visits = sorted((one for one in true["stage"]["visits"] if one["t"] == frame), key=lambda one: int(one["s"]))
    views = [Viewpoint(np.array(one["position_mm"]), rotation_matrix(np.array(one["rotation_rad"]))) for one in visits]
    pixels = np.stack(np.meshgrid([30.0, 120, 210], [20.0, 90, 160]), axis=-1).reshape(-1, 2)
    points = camera.ray_directions(pixels) * 660
    world = points @ views[1].rotation.T + views[1].position_mm
    seen = np.array([camera.project(view.to_camera(world)) for view in views])
    # The reference camera sees these points at the given pixels.
    numbers = [each[frame + 1] for each in found.measured_visits]
    starts = [found.layout.first_visit + 6 * found.visits.index(number) for number in numbers]
    motions = np.array([found.values[start : start + 6] for start in starts])
    rig = RigGeometry.from_values(found.values, found.layout, found.positions_mm, found.reference, motions)
    depth = triangulate(rig, seen, np.full(9, 660.0))[:, 2]
    _, _, z = found.point_errors(pixels, 660.0, visits=[numbers])
    return float((depth - 660).mean()), z.mean_std


def test_depth_of_every_frame_agrees_with_the_truth(calibrated: Calibrated) -> None:
    folder, found, _ = calibrated
    assert found.measured_visits == ((12, 13, 14), (15, 16, 17), (18, 19, 20))
    errors = [seen_depth(folder, found, frame) for frame in (-1, 0, 1)]
    # The errors of three frames are nearly the same one; beyond four deviations they have a probability of 1e-4.
    for error, std in errors:
        assert abs(error) < 4 * std
        assert std < 0.5
    # The frames of a strip differ by the noise of its points: 18 or more dots of some 0.01 px.
    assert np.ptp([error for error, _ in errors]) < 0.25


def test_mean_poses_of_the_measurement_keep_the_geometry(calibrated: Calibrated) -> None:
    _, found, _ = calibrated
    mean = found.measured()
    assert mean.measured_visits == found.measured_visits
    assert mean.visits == (12, 13, 14, 15, 16, 17, 18, 19, 20)
    for position, visits in enumerate(found.measured_visits):
        for visit in visits:
            one, other = (each.viewpoint(position, visit) for each in (found, mean))
            reference = [each.viewpoint(1, found.measured_visits[1][1]) for each in (found, mean)]
            # Relative to one image of the reference camera.
            for a, b in (((one, reference[0]), (other, reference[1])),):
                first, second = (
                    (x.rotation.T @ (y.position_mm - x.position_mm), x.rotation.T @ y.rotation) for y, x in (a, b)
                )
                np.testing.assert_allclose(first[0], second[0], rtol=0, atol=2e-6)
                np.testing.assert_allclose(first[1], second[1], rtol=0, atol=1e-9)
        motions = [mean.value(f"visit[{visit}].yaw") for visit in visits]
        assert abs(sum(motions)) < 1e-12
    errors = []
    for each in (found, mean):
        numbers = [visits[1] for visits in each.measured_visits]
        errors.append(each.point_errors([[20, 30], [200, 150]], 660.0, visits=[numbers])[2].covariance)
    np.testing.assert_allclose(errors[0], errors[1], rtol=1e-3)
    assert RigCalibration.from_camera(found.camera, [0.0]).measured().visits == ()


def test_files_keep_the_visits_of_the_measurement(calibrated: Calibrated) -> None:
    _, found, output = calibrated
    loaded = RigCalibration.load(output / "calibration.yaml")
    assert (loaded.measured_visits, loaded.measured_images) == (found.measured_visits, found.measured_images)
    for wrong in (((12, 13), (15, 16), (18,)), ((12, 13, 14),), ((12,), (12,), (13,)), ((99,), (12,), (13,))):
        with pytest.raises(CalibrationError, match="measured_visits"):
            replace(found, measured_visits=wrong)


def test_images_are_rectified_by_the_poses_of_their_visits(calibrated: Calibrated, tmp_path: Path) -> None:
    folder, found, _ = calibrated
    recording = import_capture(folder, calibration=found)
    assert "stage_tolerance_repeatability_um" not in recording.attrs
    # Those of another measurement have new visits.
    other = import_capture(folder, calibration=replace(found, measured_images="0" * 64))
    assert other.attrs["stage_tolerance_repeatability_um"] > 0
    assert not np.array_equal(recording["image"].values, other["image"].values)


def test_run_states_the_error_of_the_measured_visits(calibrated: Calibrated, tmp_path: Path) -> None:
    folder, found, _ = calibrated
    run = run_capture(folder, tmp_path / "out", method=constant_depth)
    assert run.calibration is not None
    assert run.calibration.measured_visits == found.measured_visits
    estimate = load_store(tmp_path / "out" / "estimate.zarr")
    _, _, z = found.measured().point_errors([[120, 90]], 660.0, visit_std=np.zeros(6))
    assert estimate["depth_std_common"].isel(t=1, y=90, x=120).item() == pytest.approx(z.std[0], rel=0.02)
    page = run.page.read_text(encoding="utf-8")
    assert "from one scan" not in page
    assert "strip.scale" in page


def test_table_of_the_strip_is_checked_before_any_image(calibrated: Calibrated, tmp_path: Path) -> None:
    folder, _, _ = calibrated
    copy = changed_capture(folder, tmp_path / "c")
    (copy / "strip.csv").write_text("x_mm,y_mm\n1,2\n", encoding="utf-8")
    with pytest.raises(CaptureError, match=r"strip\.file: lacks the columns z_mm"):
        calibrate_capture(copy)
    assert open_capture(copy).capture.strip is not None
