"""Calibration of capture folders: agreement with the truth, noise of the pixels, files, strip, bad input."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from scenetruth import load_store
from scenetruth.camera import Camera, Distortion, Viewpoint
from scenetruth.capture import (
    RigCalibration,
    calibrate_capture,
    import_capture,
    load_capture,
    open_capture,
    run_capture,
)
from scenetruth.capture.calibration import CalibrationError, RigGeometry, RigPriors, rotation_matrix, triangulate
from scenetruth.errors import CaptureError, OutputExistsError
from tests.helpers.board_captures import changed_capture, constant_depth, make_board_capture, true_values
from tests.helpers.nightly import by_night, nightly

Calibrated = tuple[RigCalibration, Path]
StripCapture = tuple[Path, RigCalibration, Path]


def z_values(found: RigCalibration, folder: Path) -> dict[str, float]:
    return {name: (found.value(name) - value) / found.std(name) for name, value in true_values(folder).items()}


def test_parameters_agree_with_the_truth(board_capture: Path, board_calibration: Calibrated) -> None:
    found, _ = board_calibration
    z = z_values(found, board_capture)
    # Nine values of one draw beyond four standard deviations have a probability of 6e-4.
    assert max(map(abs, z.values())) < 4, z
    assert found.std("f") < 1e-3 * found.value("f")
    assert found.bit_depth == 12
    assert found.warnings == ()
    # The noise of the pixels is measured: some 2000 residuals scatter by 3 %, and defects of the model would add.
    assert 0.7 < found.variance_factor < 1.1


DOTS = {"kind": "dots", "dots": [6, 5], "spacing_mm": 8, "diameter_mm": 4}
SQUARES = {"kind": "checkerboard", "squares": [7, 6], "square_mm": 7.0}


@nightly
@pytest.mark.parametrize("board", [DOTS, *by_night(SQUARES)], ids=lambda board: str(board["kind"]))
def test_other_boards_agree_with_the_truth(board: dict[str, Any], tmp_path: Path) -> None:
    folder = make_board_capture(tmp_path / "c", board=board, poses=4, flat=6, dark=6, static=0)
    found = calibrate_capture(folder)
    z = z_values(found, folder)
    assert max(map(abs, z.values())) < 4, z
    assert found.variance_factor < 1.3


def test_noise_is_estimated_from_the_images_without_dark_frames(board_capture: Path, tmp_path: Path) -> None:
    none = dict.fromkeys(("dark", "flat", "static"))
    folder = changed_capture(board_capture, tmp_path / "c", files=none)
    found = calibrate_capture(folder)
    z = {name: (found.value(name) - value) / found.std(name) for name, value in true_values(board_capture).items()}
    assert max(map(abs, z.values())) < 4, z
    assert 0.5 < found.variance_factor < 1.5


def test_files_hold_the_calibration_and_its_points(
    board_capture: Path, board_calibration: Calibrated, tmp_path: Path
) -> None:
    from scenetruth.capture.capture_calibration import fit_points, load_points, rig_priors

    found, output = board_calibration
    assert sorted(path.name for path in output.iterdir()) == [
        "calibration.npz", "calibration.yaml", "calibration_points.npz",
    ]  # fmt: skip
    loaded = RigCalibration.load(output / "calibration.yaml")
    np.testing.assert_array_equal(loaded.values, found.values)
    np.testing.assert_array_equal(loaded.covariance, found.covariance)
    assert (loaded.bit_depth, loaded.warnings) == (12, found.warnings)
    folder, points = open_capture(board_capture), load_points(output / "calibration_points.npz")
    again = fit_points(folder, points, found, rig_priors(folder))
    kept = len(found.names)
    np.testing.assert_allclose(again.fit.state.values[:kept], found.values, rtol=0, atol=1e-3 * found.std("f"))
    assert again.fit.chi2 == pytest.approx(found.chi2, rel=1e-6)
    with pytest.raises(OutputExistsError):
        calibrate_capture(board_capture, output=output)
    (tmp_path / "other.npz").write_bytes(b"PK")
    with pytest.raises(CalibrationError, match="holds no detected points"):
        load_points(tmp_path / "other.npz")


def test_tolerances_are_those_of_the_file(board_capture: Path, tmp_path: Path) -> None:
    from scenetruth.capture.capture_calibration import rig_priors

    priors = rig_priors(open_capture(board_capture))
    # All board images are approached from one side.
    assert priors.errors.backlash_um == 0
    assert (priors.errors.yaw_urad, priors.errors.repeatability_um, priors.step_std) == (100, 1, 1e-4)
    stage = {"scan": "bidirectional", "step_std": 2e-4, "errors": {"preset": "screw_stage", "backlash_um": 4}}
    priors = rig_priors(open_capture(changed_capture(board_capture, tmp_path / "c", stage=stage)))
    assert (priors.errors.backlash_um, priors.step_std) == (0, 2e-4)
    assert priors.errors.repeatability_um == pytest.approx(np.hypot(1, 2))
    unknown = changed_capture(board_capture, tmp_path / "d", stage={"errors": None})
    assert rig_priors(open_capture(unknown)).errors == RigPriors().errors.model_copy(update={"backlash_um": 0.0})


def test_every_problem_is_reported_before_any_image_is_analysed(board_capture: Path, tmp_path: Path) -> None:
    folder = changed_capture(
        board_capture, tmp_path / "c", camera={"bayer": "rggb"}, files={"flat": None},
        stage={"positions": 1, "baseline_mm": 5},
    )  # fmt: skip
    for pose in (1, 2, 3, 4):
        for file in (folder / "board").glob(f"p{pose:02d}*"):
            file.unlink()
    for file in (*(folder / "images").glob("s-1*"), *(folder / "images").glob("s+1*")):
        file.unlink()
    with pytest.raises(CaptureError) as caught:
        calibrate_capture(folder, std={"g": 1.0, "f": -1.0}, distortion=["k7"])
    text = str(caught.value)
    for part in (
        "images at s = -1, 1", "shows 1 poses of the board", "of a mosaic", "std.g: must be one of", "std.f: must not",
        "distortion: must be some of",
    ):  # fmt: skip
        assert part in text, text


def test_grid_of_positions_is_rejected(board_capture: Path, tmp_path: Path) -> None:
    folder = changed_capture(
        board_capture, tmp_path / "c", stage={"rows": 2, "row_spacing_mm": 5.0},
        files={"images": "images/r{row}_s{s:+d}_t{t:+d}.tif"},
    )  # fmt: skip
    for file in sorted((folder / "images").iterdir()):
        shutil.copy(file, file.with_name(f"r0_{file.name}"))
        file.rename(file.with_name(f"r1_{file.name}"))
    with pytest.raises(CaptureError, match=r"stage\.rows: must be 1 for a calibration"):
        calibrate_capture(folder)


def test_camera_of_another_program_needs_no_board(board_capture: Path, tmp_path: Path) -> None:
    folder = changed_capture(board_capture, tmp_path / "c", files={"board": None}, board=_removed(board_capture))
    with pytest.raises(CaptureError, match="import a calibration of another program"):
        calibrate_capture(folder)
    file = tmp_path / "cameras.txt"
    file.write_text("1 RADIAL 240 180 1900 122.9 86.6 -0.3 1.5")
    found = calibrate_capture(folder, guess=file, std={"f": 3.0}, output=tmp_path / "out")
    assert (found.value("f"), found.std("f"), found.value("c_x"), found.std("c_x")) == (1900, 3, 122.4, 0)
    # Stage tolerances are part of the uncertainty: relative depth errors of f, step and, common to all pixels, yaw.
    z = found.point_errors([[120, 90]], 660.0)[2].std[0]
    yaw, x = 100e-6, 5.0
    expected = 660 * np.sqrt((3 / 1900) ** 2 + 1e-8 + 2 * (1900 * yaw * x / (1900 * x / 660 * 2 * x)) ** 2)
    assert z == pytest.approx(expected, rel=0.05)
    assert RigCalibration.load(tmp_path / "out" / "calibration.yaml").std("f") == 3
    assert calibrate_capture(folder, guess=tmp_path / "out" / "calibration.yaml").std("f") == 3
    default = calibrate_capture(folder, guess=Camera(width=240, height=180, focal_length_px=1900))
    assert default.std("f") == pytest.approx(1.9)
    assert default.std("c_x") == 5.0
    file.write_text("1 RADIAL 320 180 1900 122.9 86.6 -0.3 1.5")
    for guess in (file, Camera(width=320, height=180, focal_length_px=1900), tmp_path / "none.yaml"):
        with pytest.raises(CaptureError, match=r"another camera|cannot be read"):
            calibrate_capture(folder, guess=guess)


def _removed(folder: Path) -> dict[str, Any]:
    return dict.fromkeys(load_capture(folder).to_dict()["board"]) | {"legacy": None}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera": {"bit_depth": 14}}, "of a camera of 12 bits, but the images have 14"),
        ({"stage": {"baseline_mm": 6.0}}, "positions -5, 0, 5 mm, but the stage has -6, 0, 6 mm"),
    ],
)
def test_calibration_of_another_camera_is_rejected(
    changes: dict[str, Any], words: str, board_capture: Path, board_calibration: Calibrated, tmp_path: Path
) -> None:
    folder = changed_capture(board_capture, tmp_path / "c", **changes)
    with pytest.raises(CaptureError, match=words):
        calibrate_capture(folder, guess=board_calibration[0])


def test_saturated_pixels_have_no_weight(board_capture: Path, tmp_path: Path) -> None:
    import tifffile

    folder = tmp_path / "c"
    shutil.copytree(board_capture, folder, ignore=shutil.ignore_patterns("truth", "*.json", ".*"))
    # A lamp is mirrored in every image.
    for file in (folder / "board").glob("*.tif"):
        image = tifffile.imread(file)
        image[60:75, 100:120] = 4095
        tifffile.imwrite(file, image)
    z = {
        name: (found.value(name) - value) / found.std(name)
        for found in [calibrate_capture(folder)]
        for name, value in true_values(board_capture).items()
    }
    assert max(map(abs, z.values())) < 4, z


def test_one_colour_of_a_mosaic_gives_the_camera_in_its_own_pixels(board_capture: Path, tmp_path: Path) -> None:
    """Green filters in every second pixel: each image is a mosaic with the grey image in its green pixels."""
    import tifffile

    folder = changed_capture(
        board_capture, tmp_path / "c", files=dict.fromkeys(("dark", "flat", "static")),
        camera={"width": 480, "height": 360, "bayer": "gbrg", "plane": "green", "focal_length_px": 3800},
    )  # fmt: skip
    for file in (*(folder / "board").glob("*.tif"), *(folder / "images").glob("*.tif")):
        mosaic = np.zeros((360, 480), dtype=np.uint16)
        mosaic[::2, ::2] = tifffile.imread(file)
        tifffile.imwrite(file, mosaic)
    found, pixels = calibrate_capture(folder), open_capture(folder).images.pixels
    assert (found.width, found.height, pixels.step, pixels.offset) == (480, 360, 2, (0, 0))
    true = true_values(board_capture)
    for name in ("f", "c_x", "c_y"):
        assert abs(found.value(name) - 2 * true[name]) < 4 * found.std(name)


@pytest.fixture(scope="module")
def with_strip(tmp_path_factory: pytest.TempPathFactory) -> StripCapture:
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


def test_depth_of_every_frame_agrees_with_the_truth(with_strip: StripCapture) -> None:
    folder, found, _ = with_strip
    assert found.measured_visits == ((12, 13, 14), (15, 16, 17), (18, 19, 20))
    errors = [seen_depth(folder, found, frame) for frame in (-1, 0, 1)]
    # The errors of three frames are nearly the same one; beyond four deviations they have a probability of 1e-4.
    for error, std in errors:
        assert abs(error) < 4 * std
        assert std < 0.5
    # The frames of a strip differ by the noise of its points: 18 or more dots of some 0.01 px.
    assert np.ptp([error for error, _ in errors]) < 0.25


def test_mean_poses_of_the_measurement_keep_the_geometry(with_strip: StripCapture) -> None:
    _, found, _ = with_strip
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


def test_files_keep_the_visits_of_the_measurement(with_strip: StripCapture) -> None:
    _, found, output = with_strip
    loaded = RigCalibration.load(output / "calibration.yaml")
    assert (loaded.measured_visits, loaded.measured_images) == (found.measured_visits, found.measured_images)
    for wrong in (((12, 13), (15, 16), (18,)), ((12, 13, 14),), ((12,), (12,), (13,)), ((99,), (12,), (13,))):
        with pytest.raises(CalibrationError, match="measured_visits"):
            replace(found, measured_visits=wrong)


def test_images_are_rectified_by_the_poses_of_their_visits(with_strip: StripCapture, tmp_path: Path) -> None:
    folder, found, _ = with_strip
    recording = import_capture(folder, calibration=found)
    assert "stage_tolerance_repeatability_um" not in recording.attrs
    # Those of another measurement have new visits.
    other = import_capture(folder, calibration=replace(found, measured_images="0" * 64))
    assert other.attrs["stage_tolerance_repeatability_um"] > 0
    assert not np.array_equal(recording["image"].values, other["image"].values)


@nightly
def test_run_states_the_error_of_the_measured_visits(with_strip: StripCapture, tmp_path: Path) -> None:
    folder, found, _ = with_strip
    run = run_capture(folder, tmp_path / "out", method=constant_depth)
    assert run.calibration is not None
    assert run.calibration.measured_visits == found.measured_visits
    estimate = load_store(tmp_path / "out" / "estimate.zarr")
    _, _, z = found.measured().point_errors([[120, 90]], 660.0, visit_std=np.zeros(6))
    assert estimate["depth_std_common"].isel(t=1, y=90, x=120).item() == pytest.approx(z.std[0], rel=0.02)
    page = run.page.read_text(encoding="utf-8")
    assert "from one scan" not in page
    assert "strip.scale" in page


def test_table_of_the_strip_is_checked_before_any_image(with_strip: StripCapture, tmp_path: Path) -> None:
    folder, _, _ = with_strip
    copy = changed_capture(folder, tmp_path / "c")
    (copy / "strip.csv").write_text("x_mm,y_mm\n1,2\n", encoding="utf-8")
    with pytest.raises(CaptureError, match=r"strip\.file: lacks the columns z_mm"):
        calibrate_capture(copy)
    with pytest.raises(CaptureError, match=r"strip\.file: lacks the columns z_mm"):
        open_capture(copy)
