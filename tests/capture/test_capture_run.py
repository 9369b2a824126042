"""Runs of captures: products, resumption, rejected and replaced results, captures without a board."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from scenetruth import load_store
from scenetruth.capture import CaptureRun, load_capture, run_capture
from scenetruth.errors import CaptureError, EstimateError, OutputExistsError
from tests.helpers.board_captures import changed_capture, constant_depth
from tests.helpers.gradient_method import Gradients
from tests.helpers.nightly import by_night, nightly
from tests.helpers.page_words import without_definitions
from tests.helpers.undrawn_figures import leave_undrawn

PRODUCTS = {
    "calibration.npz", "calibration.yaml", "calibration_points.npz", "capture.html", "capture_figures",
    "capture_run.json", "check.json", "estimate.zarr", "figures", "recording.zarr", "report.html",
}  # fmt: skip
METHOD = constant_depth
"""Takes no time."""
# Figures of captures are drawn in `tests.capture.report`.
pytestmark = pytest.mark.usefixtures("undrawn_figures")


class StoppedError(Exception):
    """Raised where a user interrupts a run."""


@pytest.fixture(scope="module")
def run(board_capture: Path, tmp_path_factory: pytest.TempPathFactory) -> CaptureRun:
    with pytest.MonkeyPatch.context() as monkeypatch:
        leave_undrawn(monkeypatch)
        return run_capture(board_capture, tmp_path_factory.mktemp("run") / "out", method=METHOD)


def entries(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir() if not path.name.startswith(".")}


def copied(folder: Path, target: Path) -> Path:
    """Copy a folder with the times of its files."""
    return changed_capture(folder, target)


def test_run_writes_calibration_recording_estimate_and_reports(run: CaptureRun) -> None:
    assert entries(run.folder.path) == PRODUCTS
    assert run.reused == ()
    assert run.check.usable
    assert run.calibration is not None
    estimate = load_store(run.folder.path / "estimate.zarr")
    assert estimate["depth"].shape == (3, 180, 240)
    _, _, z = run.calibration.point_errors([[120, 90]], 660.0, visit_std=np.zeros(6))
    common = estimate["depth_std_common"].isel(t=1, y=90, x=120).item()
    # The images are rectified, so that the pixel is nearly that of the recorded image.
    assert common == pytest.approx(z.std[0], rel=0.02)
    np.testing.assert_allclose(estimate["depth_std"] ** 2, estimate["depth_std_common"] ** 2 + 0.05**2, rtol=1e-4)
    page = without_definitions(run.page.read_text(encoding="utf-8"))
    for text in (
        "Suggestions",
        "standard deviation of the mean depth",
        "focal length",
        "Halve",
        "gain K",
        'href="report.html"',
    ):
        assert text in page


def test_second_call_does_nothing_again(run: CaptureRun, board_capture: Path) -> None:
    times = {path: path.stat().st_mtime_ns for path in run.folder.path.iterdir() if path.name != ".run.lock"}
    again = run_capture(board_capture, run.folder.path, method=METHOD)
    assert again.reused == ("check", "calibrate", "import", "estimate", "report", "page")
    assert {path: path.stat().st_mtime_ns for path in run.folder.path.iterdir()} == times
    assert again.calibration is not None
    assert run.calibration is not None
    assert again.calibration.std("f") == run.calibration.std("f")
    assert again.check.findings == run.check.findings


@nightly
@pytest.mark.parametrize(
    ("what", "done"),
    [("detect boards", ("check",)), *by_night(("report", ("check", "calibrate", "import", "estimate")))],
)
def test_interrupted_run_resumes(what: str, done: tuple[str, ...], board_capture: Path, tmp_path: Path) -> None:
    def stop(task: str, step: int, total: int) -> None:
        if task == what:
            raise StoppedError

    with pytest.raises(StoppedError):
        run_capture(board_capture, tmp_path / "out", method=METHOD, progress=stop)
    left = entries(tmp_path / "out")
    assert "capture.html" not in left
    assert ("calibration.yaml" in left) == ("estimate.zarr" in left) == ("estimate" in done)
    again = run_capture(board_capture, tmp_path / "out", method=METHOD)
    assert again.reused == done
    assert entries(tmp_path / "out") == PRODUCTS
    assert "Suggestions" in again.page.read_text(encoding="utf-8")


@nightly
def test_results_of_other_inputs_are_rejected_or_replaced(board_capture: Path, tmp_path: Path) -> None:
    folder = copied(board_capture, tmp_path / "lab")
    first = run_capture(folder, tmp_path / "out", method=METHOD)
    assert first.calibration is not None
    before = first.calibration.std("f")
    with pytest.raises(OutputExistsError, match=r"estimate\.zarr.*other settings"):
        run_capture(folder, tmp_path / "out", method="structure_tensor")
    # One board image is taken again.
    file = folder / "board" / "p00_s+0.tif"
    image = tifffile.imread(file)
    tifffile.imwrite(
        file, np.clip(image.astype(int) + np.arange(image.size).reshape(image.shape) % 3, 0, 4095).astype("u2")
    )
    os.utime(file, ns=(1, 1))
    with pytest.raises(OutputExistsError, match=r"calibration\.yaml"):
        run_capture(folder, tmp_path / "out", method=METHOD)
    again = run_capture(folder, tmp_path / "out", method=METHOD, overwrite=True)
    assert again.reused == ("check",)
    assert again.calibration is not None
    assert again.calibration.std("f") != before
    assert run_capture(folder, tmp_path / "out", method=METHOD).reused[-1] == "page"


def test_foreign_files_are_kept(board_capture: Path, tmp_path: Path) -> None:
    (tmp_path / "out" / "capture_figures").mkdir(parents=True)
    (tmp_path / "out" / "capture_figures" / "thesis.tex").write_text("mine")
    for overwrite in (False, True):
        with pytest.raises(OutputExistsError):
            run_capture(board_capture, tmp_path / "out", method=METHOD, overwrite=overwrite)
    assert entries(tmp_path / "out") == {"capture_figures"}
    assert (tmp_path / "out" / "capture_figures" / "thesis.tex").read_text() == "mine"
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputExistsError, match="is a file"):
        run_capture(board_capture, tmp_path / "file")


@nightly
def test_mistakes_that_the_check_finds_end_the_run(board_capture: Path, tmp_path: Path) -> None:
    folder = copied(board_capture, tmp_path / "lab")
    for file in (folder / "images").glob("*.tif"):
        image = tifffile.imread(file)
        image[:40] = 4095
        tifffile.imwrite(file, image)
    with pytest.raises(CaptureError, match=r"saturated: 9 of 9 images"):
        run_capture(folder, tmp_path / "out", method=METHOD)
    assert entries(tmp_path / "out") == {"check.json", "capture_run.json"}
    done = run_capture(folder, tmp_path / "out", method=METHOD, check=False)
    assert done.reused == ("check",)
    assert done.check.mistakes("error") == ["saturated"]
    assert "saturated: 9 of 9 images" in done.page.read_text(encoding="utf-8")


def test_every_problem_ends_the_run_before_any_work(board_capture: Path, tmp_path: Path) -> None:
    folder = copied(board_capture, tmp_path / "lab")
    for pose in (2, 3, 4):
        for file in (folder / "board").glob(f"p{pose:02d}*"):
            file.unlink()
    with pytest.raises(CaptureError) as caught:
        run_capture(folder, tmp_path / "out", distortion=["k9"])
    assert "shows 2 poses" in str(caught.value)
    assert "distortion: must be some of" in str(caught.value)
    with pytest.raises(EstimateError):
        run_capture(board_capture, tmp_path / "out", method="no_such_method")
    single = changed_capture(board_capture, tmp_path / "single", frames={"count": 1})
    for file in (*(single / "images").glob("*t-1.tif"), *(single / "images").glob("*t+1.tif")):
        file.unlink()
    with pytest.raises(CaptureError, match="frames"):
        run_capture(single, tmp_path / "out", method=Gradients())
    assert not (tmp_path / "out").exists()


def without_board(folder: Path, target: Path, **camera: Any) -> Path:
    removed = dict.fromkeys(load_capture(folder).to_dict()["board"]) | {"legacy": None}
    return changed_capture(folder, target, files={"board": None}, board=removed, camera=camera)


@nightly
def test_capture_without_a_board_states_its_limits(board_capture: Path, tmp_path: Path) -> None:
    folder = without_board(board_capture, tmp_path / "lab")
    done = run_capture(folder, tmp_path / "out", method=METHOD)
    assert done.calibration is None
    assert "calibration.yaml" not in entries(tmp_path / "out")
    assert "No images of a board" in done.page.read_text(encoding="utf-8")
    recording = load_store(tmp_path / "out" / "recording.zarr")
    assert recording.attrs["focal_length_px"] == 1912
    assert recording.attrs["stage_tolerance_yaw_urad"] == 100
    file = tmp_path / "cameras.txt"
    file.write_text("1 RADIAL 240 180 1900 122.9 86.6 -0.3 1.5")
    done = run_capture(folder, tmp_path / "imported", method=METHOD, guess=file, std={"f": 3.0, "c_x": 2.0, "c_y": 2.0})
    attrs = load_store(tmp_path / "imported" / "recording.zarr").attrs
    assert attrs["focal_length_px"] == 1900
    assert attrs["focal_length_std_px"] == 3.0
    # The method states no lens, so that the images are those of a pinhole camera.
    assert "distortion" not in attrs
    lost = without_board(board_capture, tmp_path / "lost", focal_length_px=None)
    with pytest.raises(CaptureError, match=r"camera\.focal_length_px: is missing"):
        run_capture(lost, tmp_path / "none", method=METHOD)
