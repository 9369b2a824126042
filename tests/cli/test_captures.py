"""The commands of real images: what they print, what they write, and how they end."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

import scenetruth as st
from scenetruth.camera import Camera
from scenetruth.capture import RigCalibration
from tests.helpers.board_captures import make_board_capture
from tests.helpers.captured_folders import CapturedFolder, write_capture
from tests.helpers.command_line import scenetruth
from tests.helpers.nightly import nightly
from tests.helpers.scenes import cube

pytestmark = pytest.mark.usefixtures("undrawn_figures")

SMALL = {
    "camera": {"width": 96, "height": 72, "focal_length_px": 750},
    "stage": {"positions": 3, "baseline_mm": 3},
    "frames": {"count": 2},
    "sensor": {"noise_std": 0.005, "bit_depth": 10},
}


@pytest.fixture
def made(tmp_path: Path) -> CapturedFolder:
    return write_capture(tmp_path / "lab", 2, shape=(48, 64), positions=3, frames=3)


def test_from_a_folder_to_a_recording(made: CapturedFolder, tmp_path: Path) -> None:
    (made.folder / "capture.yaml").unlink()
    done = scenetruth("capture", "init", made.folder, "--focal-length-px", "1000", "--baseline-mm", "2")
    assert done.returncode == 0, done.stderr
    assert 'images: "images/s{s:+d}_t{t:03d}.tif"  9 files' in done.stdout
    assert "wrote" in done.stdout
    done = scenetruth("capture", "check", made.folder)
    assert done.returncode == 0, done.stdout
    assert "noise: gain K: 0.3" in done.stdout
    assert "9 images; no mistakes" in done.stdout
    done = scenetruth("capture", "import", made.folder, "-o", tmp_path / "run")
    assert done.returncode == 0, done.stderr
    assert "9 images of 64 x 48 px" in done.stdout
    recording = st.load_store(tmp_path / "run" / "recording.zarr")
    assert recording.image.dtype == np.float32
    done = scenetruth("capture", "import", made.folder, "-o", tmp_path / "run")
    assert done.returncode == 2
    assert "--overwrite" in done.stderr
    done = scenetruth("capture", "import", made.folder, "-o", tmp_path / "run", "--overwrite", "--no-correct")
    assert done.returncode == 0, done.stderr
    assert st.load_store(tmp_path / "run" / "recording.zarr").image.dtype == np.uint16


def test_import_with_a_calibration(made: CapturedFolder, tmp_path: Path) -> None:
    camera = Camera(width=64, height=48, focal_length_px=990)
    file = RigCalibration.from_camera(camera, [-2.0, 0.0, 2.0]).save(tmp_path / "calibration.yaml")
    done = scenetruth("capture", "import", made.folder, "-o", tmp_path / "run", "--calibration", file)
    assert done.returncode == 0, done.stderr
    recording = st.load_store(tmp_path / "run" / "recording.zarr")
    assert recording.attrs["focal_length_px"] == 990
    assert "noise_share" in recording
    file = RigCalibration.from_camera(camera, [-3.0, 0.0, 3.0]).save(tmp_path / "other.yaml")
    done = scenetruth("capture", "import", made.folder, "-o", tmp_path / "other", "--calibration", file)
    assert done.returncode == 2
    assert "is for the positions -3, 0, 3 mm, but the stage has -2, 0, 2 mm" in done.stderr


def test_check_ends_with_1_for_mistakes_and_2_for_an_invalid_file(made: CapturedFolder) -> None:
    (made.folder / made.names[1, 1]).unlink()
    made.plain["camera"]["width"] = 48
    made.plain["camera"]["height"] = 64
    made.write()
    done = scenetruth("capture", "check", made.folder, "--json")
    assert done.returncode == 1
    assert {finding["mistake"] for finding in json.loads(done.stdout)["findings"]} == {"turned"}
    done = scenetruth("capture", "check", made.folder)
    assert done.returncode == 1
    assert "error: turned: images/s-1_t000.tif" in done.stdout
    (made.folder / "capture.yaml").write_text("camera: 3", encoding="utf-8")
    assert scenetruth("capture", "check", made.folder).returncode == 2


def test_missing_images_are_told_and_the_rest_is_imported(made: CapturedFolder, tmp_path: Path) -> None:
    (made.folder / made.names[1, 1]).unlink()
    done = scenetruth("capture", "check", made.folder)
    assert done.returncode == 0
    assert "8 images, 1 missing; no mistakes" in done.stdout
    done = scenetruth("capture", "import", made.folder, "-o", tmp_path / "run")
    assert done.returncode == 0
    assert "1 image is missing and invalid (NaN): images/s+1_t001.tif" in done.stderr


def test_schema_of_captures_is_printed() -> None:
    schema = json.loads(scenetruth("schema", "capture").stdout)
    assert {"camera", "stage", "frames", "files"} <= set(schema["properties"])


def test_capture_folder_is_written_and_resumed(tmp_path: Path) -> None:
    scene, output = tmp_path / "scene.yaml", tmp_path / "capture"
    scene.write_text(yaml.safe_dump(cube(**SMALL).to_dict()))
    board = "board={kind: checkerboard, squares: [6, 5], square_mm: 7}"
    options = ("--parameter", board, "--poses", "2", "--dark", "1", "--flat", "0", "--set", "frames.count=1")
    done = scenetruth("capture", "simulate", scene, "-o", output, *options)
    assert done.returncode == 0, done.stderr
    assert f"wrote {output / 'capture.yaml'}, {output / 'truth' / 'parameters.yaml'}" in done.stdout
    assert sorted(path.name for path in output.iterdir() if not path.name.startswith(".")) == [
        "board", "capture.yaml", "dark", "images", "simulated_capture.json", "static", "truth",
    ]  # fmt: skip
    assert len(list((output / "board").iterdir())) == 6
    first = output / "board" / "p00_s+0.tif"
    content = first.read_bytes()
    first.unlink()
    assert scenetruth("capture", "simulate", scene, "-o", output, *options).returncode == 0
    assert first.read_bytes() == content
    again = scenetruth("capture", "simulate", scene, "-o", output, *options, "--seed", "5")
    assert again.returncode == 2
    assert "contains the capture of another scene" in again.stderr


def test_wrong_options_are_named_together(tmp_path: Path) -> None:
    given = ("--poses", "3", "--parameter", "poses=4", "--parameter", "flat", "-o", tmp_path / "c")
    done = scenetruth("capture", "simulate", "cube", *given)
    assert done.returncode == 2
    assert "--poses: is also given by --parameter poses" in done.stderr
    assert "--parameter" in done.stderr
    assert not (tmp_path / "c").exists()


@nightly
def test_calibration_prints_its_parameters_and_writes_its_files(tmp_path: Path) -> None:
    folder = make_board_capture(tmp_path / "lab", poses=3, static=0)
    done = scenetruth(
        "capture", "calibrate", folder, "-o", tmp_path / "out", "--std", "f=1", "--focal-length-px", "1900"
    )
    assert done.returncode == 2
    assert "--std: states the standard deviations of a camera of --import" in done.stderr
    done = scenetruth("capture", "calibrate", folder, "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert " f = 1" in done.stdout
    assert "points in 9 of 9 images" in done.stdout
    assert (tmp_path / "out" / "calibration.yaml").exists()
    for more in ((), ("--import", tmp_path / "cameras.yaml", "--overwrite")):
        done = scenetruth("capture", "calibrate", folder, "-o", tmp_path / "out", *more)
        assert done.returncode == 2
        assert ("cameras.yaml: cannot be read" if more else "--overwrite") in done.stderr


@nightly
def test_run_of_a_capture_prints_the_calibration_and_its_pages(tmp_path: Path) -> None:
    folder = make_board_capture(tmp_path / "lab", poses=3, static=0, dark=4, flat=4)
    done = scenetruth("capture", "run", folder, "-o", tmp_path / "out", "--method", "opencv_stereo[window: 0]")
    assert done.returncode == 2
    assert "window" in done.stderr
    assert not (tmp_path / "out").exists()
    done = scenetruth("capture", "run", folder, "-o", tmp_path / "out", "--method", "opencv_stereo")
    assert done.returncode == 0, done.stderr
    assert " f = 1" in done.stdout
    assert f"wrote {tmp_path / 'out' / 'capture.html'}, {tmp_path / 'out' / 'report.html'}" in done.stdout
    again = scenetruth("capture", "run", folder, "-o", tmp_path / "out", "--method", "opencv_stereo")
    assert again.returncode == 0, again.stderr
    assert again.stdout == done.stdout
