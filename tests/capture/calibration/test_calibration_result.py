"""Files of a calibration, its errors of points, and files that are refused."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

import numpy as np
import pytest
import yaml

from scenetruth import OutputExistsError
from scenetruth.camera import Camera, Distortion
from scenetruth.capture.calibration import CalibrationError, RigCalibration, calibrate
from tests.helpers.drawn_rigs import SIZE, draw_rig


@pytest.fixture(scope="module")
def calibration() -> RigCalibration:
    rig = draw_rig(31, poses=5, positions=3)
    return calibrate(rig.observations, guess=5000.0, priors=rig.priors)


def test_round_trip(calibration: RigCalibration, tmp_path: Path) -> None:
    file = calibration.save(tmp_path / "calibration.yaml")
    loaded = RigCalibration.load(file)
    assert loaded.names == calibration.names
    np.testing.assert_array_equal(loaded.values, calibration.values)
    np.testing.assert_array_equal(loaded.covariance, calibration.covariance)
    np.testing.assert_array_equal(loaded.prior_std, calibration.prior_std)
    assert loaded.images == calibration.images
    assert [each.words for each in loaded.combinations] == [each.words for each in calibration.combinations]
    assert loaded.camera == calibration.camera
    assert loaded.summary() == calibration.summary()
    with pytest.raises(OutputExistsError):
        calibration.save(file)
    calibration.save(file, overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir() if not path.name.startswith(".")) == [
        "calibration.npz",
        "calibration.yaml",
    ]


def replaced(file: Path, matrix: np.ndarray, names: tuple[str, ...]) -> None:
    """Write another covariance with a matching checksum."""
    buffer = io.BytesIO()
    np.savez(buffer, names=np.array(names), covariance=matrix)
    file.with_suffix(".npz").write_bytes(buffer.getvalue())
    plain = yaml.safe_load(file.read_text())
    plain["covariance"]["sha256"] = hashlib.sha256(buffer.getvalue()).hexdigest()
    file.write_text(yaml.safe_dump(plain))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("indefinite", "not positive semidefinite"),
        ("asymmetric", "not symmetric for"),
        ("negative", "negative variance of f"),
        ("nan", "must be finite"),
        ("fixed", "parameter without a variance"),
        ("small", "must be a matrix of"),
        ("complex", "must have a covariance of real numbers"),
        ("text", "must have a covariance of real numbers"),
    ],
)
def test_matrices_that_are_no_covariance_are_refused(
    calibration: RigCalibration, tmp_path: Path, change: str, message: str
) -> None:
    file = calibration.save(tmp_path / "calibration.yaml")
    matrix = calibration.covariance.copy()
    if change == "indefinite":
        matrix[0, 1] = matrix[1, 0] = 1.5 * np.sqrt(matrix[0, 0] * matrix[1, 1])
    elif change == "asymmetric":
        matrix[0, 1] += 1e-3 * np.sqrt(matrix[0, 0] * matrix[1, 1])
    elif change == "negative":
        matrix[0, 0] *= -1
    elif change == "nan":
        matrix[2, 2] = np.nan
    elif change == "fixed":
        matrix[7, 0] = matrix[0, 7] = 1e-6
    elif change in ("complex", "text"):
        matrix = matrix.astype(complex if change == "complex" else str)
    else:
        matrix = matrix[:-1, :-1]
    replaced(file, matrix, calibration.names)
    with pytest.raises(CalibrationError, match=message) as caught:
        RigCalibration.load(file)
    assert "calibration.yaml" in str(caught.value)


def test_all_problems_of_a_file_are_reported_together(calibration: RigCalibration, tmp_path: Path) -> None:
    file = calibration.save(tmp_path / "calibration.yaml")
    plain = yaml.safe_load(file.read_text())
    plain["camera"]["width"] = -3
    plain["stage"]["reference"] = "middle"
    plain["parameters"]["f"]["value"] = "long"
    file.write_text(yaml.safe_dump(plain))
    with pytest.raises(CalibrationError) as caught:
        RigCalibration.load(file)
    assert {"camera.width", "stage.reference", "parameters.f.value"} <= {each.path for each in caught.value.problems}


def test_edited_and_mixed_files_are_refused(calibration: RigCalibration, tmp_path: Path) -> None:
    file = calibration.save(tmp_path / "calibration.yaml")
    plain = yaml.safe_load(file.read_text())
    plain["parameters"]["f"]["std"] *= 0.1
    file.write_text(yaml.safe_dump(plain))
    with pytest.raises(CalibrationError, match="instead of editing"):
        RigCalibration.load(file)
    other = RigCalibration.from_camera(calibration.camera, [-5, 0, 5], std={"f": 1.0})
    other.save(tmp_path / "other.yaml")
    (tmp_path / "other.npz").write_bytes(file.with_suffix(".npz").read_bytes())
    with pytest.raises(CalibrationError, match="belongs to another calibration"):
        RigCalibration.load(tmp_path / "other.yaml")
    (tmp_path / "other.npz").unlink()
    with pytest.raises(CalibrationError, match="cannot be read"):
        RigCalibration.load(tmp_path / "other.yaml")


def test_given_camera_without_a_stage_error() -> None:
    camera = Camera(width=SIZE[0], height=SIZE[1], focal_length_px=5000, distortion=Distortion(k1=-0.5))
    stated = RigCalibration.from_camera(camera, [-5, 0, 5], std={"f": 5.0})
    assert stated.camera.distortion == camera.distortion
    np.testing.assert_allclose(stated.viewpoint(2).position_mm, [5, 0, 0])
    np.testing.assert_allclose(stated.axis, [1, 0, 0])
    z = stated.point_errors(np.array([[319.5, 239.5]]), 660.0)[2]
    # dZ = Z df / f; distortion changes it by k1 (x / Z)^2 at the outer cameras.
    np.testing.assert_allclose(z.std, 0.66, rtol=2e-4)
    with pytest.raises(CalibrationError, match=r"std\.focal"):
        RigCalibration.from_camera(camera, [0], std={"focal": 1.0})


def test_poses_are_in_the_frame_of_the_reference_camera(calibration: RigCalibration) -> None:
    reference = calibration.viewpoint(calibration.reference)
    np.testing.assert_allclose(reference.position_mm, 0, atol=1e-12)
    np.testing.assert_allclose(reference.rotation, np.eye(3), atol=1e-12)
    step = calibration.viewpoint(2).position_mm - calibration.viewpoint(0).position_mm
    assert abs(np.linalg.norm(step) - 10) < 0.01
    assert calibration.axis @ step / np.linalg.norm(step) > 0.999


def test_summary_names_pairs_that_belong_together(calibration: RigCalibration) -> None:
    text = calibration.summary()
    assert "c_x and p2" in text
    assert "chi-squared / degrees of freedom" in text
