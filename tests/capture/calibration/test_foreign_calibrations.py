"""Cameras of other programs: conventions of pixels and coefficients, round trips, and what is refused."""

from __future__ import annotations

import contextlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenetruth import EstimateWarning, OutputExistsError
from scenetruth.camera import Camera, Distortion
from scenetruth.capture.calibration import (
    CalibrationError,
    RigCalibration,
    RigGeometry,
    export_calibration,
    import_calibration,
    import_camera,
)

LENS = Distortion(k1=-0.31, k2=1.7, p1=2e-4, p2=-3e-4, k3=0.4)
CAMERA = Camera(width=640, height=480, focal_length_px=5016.5, principal_point_px=(331.7, 228.4), distortion=LENS)
ORIGIN = r"0\.5 px"
X_MM = [-10.0, -5.0, 0.0, 5.0, 10.0]


def close(one: Camera, other: Camera) -> None:
    assert (one.width, one.height) == (other.width, other.height)
    np.testing.assert_allclose(one.focal_px, other.focal_px, rtol=1e-12)
    np.testing.assert_allclose(one.principal_point, other.principal_point, atol=1e-9)
    assert one.distortion is not None
    assert other.distortion is not None
    np.testing.assert_allclose(one.distortion.coefficients, other.distortion.coefficients, rtol=1e-12)


@pytest.fixture
def calibration() -> RigCalibration:
    return RigCalibration.from_camera(CAMERA, X_MM)


@pytest.mark.parametrize(("target", "name"), [("opencv", "camera.yml"), ("colmap", "cameras.txt")])
def test_round_trips(calibration: RigCalibration, tmp_path: Path, target: str, name: str) -> None:
    file = export_calibration(calibration, tmp_path / name, target=target)  # type: ignore[arg-type]
    close(import_camera(file), CAMERA)
    with pytest.raises(OutputExistsError):
        export_calibration(calibration, file, target=target)  # type: ignore[arg-type]


@pytest.mark.parametrize("aspect", [2e-4, 0.02, -0.03])
@pytest.mark.parametrize("target", ["opencv", "colmap", "matchid"])
def test_pixels_that_are_not_square_go_round(
    calibration: RigCalibration, tmp_path: Path, target: str, aspect: float
) -> None:
    names = {"opencv": "camera.yml", "colmap": "cameras.txt", "matchid": "rig.caldat"}
    values = calibration.values.copy()
    values[calibration.names.index("aspect")] = aspect
    taller = replace(calibration, values=values)
    file = export_calibration(taller, tmp_path / names[target], target=target)  # type: ignore[arg-type]
    with pytest.warns(EstimateWarning, match=ORIGIN) if target == "matchid" else contextlib.nullcontext():
        found = import_calibration(file, X_MM, size=(640, 480))
    close(found.camera, CAMERA)
    assert found.value("aspect") == pytest.approx(aspect, abs=1e-12)
    cv2 = pytest.importorskip("cv2")
    points = np.random.default_rng(2).uniform([-40, -30, 600], [40, 30, 700], (20, 3))
    matrix = np.array([[5016.5, 0, 331.7], [0, 5016.5 * (1 + aspect), 228.4], [0, 0, 1]])
    pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array([*LENS.coefficients[:5]]))[0]
    rig = RigGeometry.from_values(found.values, found.layout, found.positions_mm, found.reference)
    np.testing.assert_allclose(rig.project(rig.to_stage(points))[2], pixels.reshape(-1, 2), atol=1e-8)
    if abs(aspect) > 1e-3:
        with contextlib.ExitStack() as stack:
            if target == "matchid":
                stack.enter_context(pytest.warns(EstimateWarning, match=ORIGIN))
            stack.enter_context(pytest.raises(CalibrationError, match="must be square: use import_calibration"))
            import_camera(file, size=(640, 480))


@pytest.mark.parametrize("suffix", ["yml", "xml"])
def test_files_of_opencv_itself(tmp_path: Path, suffix: str) -> None:
    cv2 = pytest.importorskip("cv2")
    file = tmp_path / f"camera.{suffix}"
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", np.array([[5016.5, 0, 331.7], [0, 5016.5, 228.4], [0, 0, 1]]))
    storage.write("distortion_coefficients", np.array([[-0.31, 1.7, 2e-4, -3e-4, 0.4]]))
    storage.release()
    close(import_camera(file), CAMERA)


def test_export_is_read_and_projected_alike_by_opencv(calibration: RigCalibration, tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    file = export_calibration(calibration, tmp_path / "camera.yml", target="opencv")
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_READ)
    matrix, lens = storage.getNode("camera_matrix").mat(), storage.getNode("distortion_coefficients").mat()
    points = np.random.default_rng(1).uniform([-40, -30, 600], [40, 30, 700], (20, 3))
    pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, lens)[0].reshape(-1, 2)
    np.testing.assert_allclose(CAMERA.project(points), pixels, atol=1e-8)


def test_kalibr(tmp_path: Path) -> None:
    file = tmp_path / "camchain.yaml"
    chain = {
        "camera_model": "pinhole", "intrinsics": [5016.5, 5016.5, 331.7, 228.4], "distortion_model": "radtan",
        "distortion_coeffs": [-0.31, 1.7, 2e-4, -3e-4], "resolution": [640, 480],
    }  # fmt: skip
    file.write_text(json.dumps({"cam0": chain}))
    expected = CAMERA.model_copy(update={"distortion": LENS.model_copy(update={"k3": 0.0})})
    close(import_camera(file), expected)
    file.write_text(json.dumps({"cam0": {**chain, "distortion_model": "equidistant"}}))
    with pytest.raises(CalibrationError, match="equidistant cannot be represented"):
        import_camera(file)


def test_matlab_counts_pixels_from_one(tmp_path: Path) -> None:
    values = {
        "K": [[5016.5, 0, 332.7], [0, 5016.5, 229.4], [0, 0, 1]], "ImageSize": [480, 640],
        "RadialDistortion": [-0.31, 1.7, 0.4], "TangentialDistortion": [2e-4, -3e-4],
    }  # fmt: skip
    file = tmp_path / "camera.json"
    file.write_text(json.dumps(values))
    close(import_camera(file), CAMERA)
    from scipy.io import savemat

    older = {key: np.array(value) for key, value in values.items() if key != "K"}
    older["IntrinsicMatrix"] = np.array(values["K"]).T
    savemat(tmp_path / "camera.mat", {"cameraParams": older})
    close(import_camera(tmp_path / "camera.mat"), CAMERA)


MATCHID = """Cam{0}_Fx [pixels];5016.5
Cam{0}_Fy [pixels];5016.5
Cam{0}_Fs [pixels];{1}
Cam{0}_Kappa 1;-0.31
Cam{0}_Kappa 2;1.7
Cam{0}_Kappa 3;0.4
Cam{0}_P1;0.0002
Cam{0}_P2;-0.0003
Cam{0}_Cx [pixels];331.7
Cam{0}_Cy [pixels];228.4
"""


@pytest.mark.parametrize("first", [0, 1])
def test_matchid_warns_of_its_origin(tmp_path: Path, first: int) -> None:
    file = tmp_path / "calibration.caldat"
    file.write_text(MATCHID.format(first, 0) + MATCHID.format(first + 1, 0))
    with pytest.warns(EstimateWarning, match=ORIGIN):
        close(import_camera(file, size=(640, 480)), CAMERA)
    with pytest.warns(EstimateWarning, match=ORIGIN), pytest.raises(CalibrationError, match="give `size`"):
        import_camera(file)
    file.write_text(MATCHID.format(first, 0.7))
    with pytest.warns(EstimateWarning, match=ORIGIN), pytest.raises(CalibrationError, match=r"skew is 0\.7"):
        import_camera(file, size=(640, 480))


def test_matchid_round_trip_with_a_pair(calibration: RigCalibration, tmp_path: Path) -> None:
    file = export_calibration(calibration, tmp_path / "rig.caldat", target="matchid")
    with pytest.warns(EstimateWarning, match=ORIGIN):
        close(import_camera(file, size=(640, 480), camera=1), CAMERA)
    assert "Tx [mm];-10.0" in file.read_text()


DICE = """<ParameterList>
  <ParameterList name="CAMERA 0">
    <Parameter name="CX" type="double" value="3.317e+02"/>
    <Parameter name="CY" type="double" value="228.4"/>
    <Parameter name="FX" type="double" value="5016.5"/>
    <Parameter name="FY" type="double" value="5016.5"/>
    <Parameter name="K1" type="double" value="-0.31"/>
    <Parameter name="K2" type="double" value="1.7"/>
    <Parameter name="K3" type="double" value="0.4"/>
    <Parameter name="P1" type="double" value="{p1}"/>
    <Parameter name="P2" type="double" value="{p2}"/>
    <Parameter name="LENS_DISTORTION_MODEL" type="string" value="{model}"/>
    <Parameter name="IMAGE_HEIGHT_WIDTH" type="string" value="{{ 480, 640 }}"/>
  </ParameterList>
</ParameterList>
"""


def test_dice(tmp_path: Path) -> None:
    """Its radial series are powers of the displacement: r3, r5, r7 are 1 + k1 r2 + k2 r4 + k3 r6."""
    file = tmp_path / "cal.xml"
    file.write_text(DICE.format(p1=2e-4, p2=-3e-4, model="OPENCV_LENS_DISTORTION"))
    close(import_camera(file), CAMERA)
    file.write_text(DICE.format(p1=0, p2=0, model="K1R3_K2R5_K3R7"))
    close(import_camera(file), CAMERA.model_copy(update={"distortion": Distortion(k1=-0.31, k2=1.7, k3=0.4)}))
    for model in ("K1R2_K2R4_K3R6", "K1R1_K2R2_K3R3", "VIC3D_LENS_DISTORTION"):
        file.write_text(DICE.format(p1=0, p2=0, model=model))
        with pytest.raises(CalibrationError, match=f"{model} with coefficients"):
            import_camera(file)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("1 OPENCV_FISHEYE 640 480 500 500 320 240 0 0 0 0", "OPENCV_FISHEYE cannot be represented"),
        ("1 PINHOLE 640 480 500 501 320 240", "pixels must be square"),
        ("1 PINHOLE 640 480 500 500 320", "is no file of this program"),
        ("1 PINHOLE 640 480 -5 -5 320 240", "must be positive"),
        ("", "has 0 cameras"),
    ],
)
def test_what_cannot_be_represented_is_refused(tmp_path: Path, row: str, message: str) -> None:
    file = tmp_path / "cameras.txt"
    file.write_text(row)
    with pytest.raises(CalibrationError, match=message) as caught:
        import_camera(file)
    assert "cameras.txt" in str(caught.value)


def test_prism_coefficients_of_opencv_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "camera.yml"
    lens = ", ".join(["0.1"] * 12)
    file.write_text(
        f"%YAML:1.0\n---\nK: [500., 0., 320., 0., 500., 240., 0., 0., 1.]\nD: [{lens}]\nimage_size: [640, 480]\n"
    )
    with pytest.raises(CalibrationError, match=r"s1 is 0\.1"):
        import_camera(file)


def test_wrong_size_and_unreadable_files(calibration: RigCalibration, tmp_path: Path) -> None:
    file = export_calibration(calibration, tmp_path / "cameras.txt", target="colmap")
    with pytest.raises(CalibrationError, match="another camera or crop"):
        import_camera(file, size=(1280, 960))
    with pytest.raises(CalibrationError, match="cannot be read"):
        import_camera(tmp_path / "missing.yml")
    (tmp_path / "broken.yml").write_text("%YAML:1.0\n---\na: [1, 2\n")
    with pytest.raises(CalibrationError, match="not valid YAML"):
        import_camera(tmp_path / "broken.yml")
    (tmp_path / "broken.xml").write_text("<opencv_storage><a>")
    with pytest.raises(CalibrationError, match="not valid XML"):
        import_camera(tmp_path / "broken.xml")


def test_imports_state_an_uncertainty(calibration: RigCalibration, tmp_path: Path) -> None:
    file = export_calibration(calibration, tmp_path / "cameras.txt", target="colmap")
    found = import_calibration(file, X_MM)
    np.testing.assert_allclose([found.std(name) for name in ("f", "c_x", "c_y", "k1")], [5.0165, 5, 5, 0])
    assert import_calibration(file, X_MM, std={"f": 1.0}).std("c_x") == 0


def test_a_focal_length_in_mm_is_asked_for(tmp_path: Path) -> None:
    file = tmp_path / "cameras.txt"
    file.write_text("1 SIMPLE_PINHOLE 640 480 12.5 320 240", encoding="utf-8")
    with pytest.warns(EstimateWarning, match=r"cameras.txt: focal_length_px: 12\.5 px .* is it in mm\?"):
        import_camera(file)
