"""Page and figures of a capture: contents, drawings, and captures that lack parts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenetruth.capture import RigCalibration, check_capture, open_capture
from scenetruth.capture.capture_calibration import fit_points, load_points, rig_priors
from scenetruth.capture.report import CaptureResults, draw_noise, noise_words, write_capture_page
from tests.helpers.board_captures import changed_capture
from tests.helpers.nightly import nightly
from tests.helpers.page_words import without_definitions
from tests.helpers.synthetic_case import make_growing_case

FIGURES = {
    "residuals.png", "board_images.png", "board_coverage.png", "depth_budget.png", "depth_error.png",
    "photon_transfer.png", "fixed_patterns.png",
}  # fmt: skip


@pytest.fixture(scope="module")
def results(board_capture: Path, board_calibration: tuple[RigCalibration, Path]) -> CaptureResults:
    folder = open_capture(board_capture)
    calibration, output = board_calibration
    solution = fit_points(folder, load_points(output / "calibration_points.npz"), calibration, rig_priors(folder))
    return CaptureResults(folder, check_capture(board_capture), calibration, solution)


def test_page_shows_calibration_noise_and_suggestions(results: CaptureResults, tmp_path: Path) -> None:
    steps = []
    page = write_capture_page(results, tmp_path, lambda what, done, total: steps.append((what, done, total)))
    assert {path.name for path in tmp_path.iterdir()} == FIGURES
    assert page.count("data:image/png;base64,") == len(FIGURES)
    assert "<h1>Capture: Simulated capture</h1>" in page
    page = without_definitions(page)
    for text in (
        "Suggestions",
        "Poses of the board",
        "relative error of the step length",
        "gain K: 0.39",
        "No mistakes",
    ):
        assert text in page, text
    assert steps[0] == ("page", 0, 5)
    assert steps[-1] == ("page", 5, 5)
    for name in FIGURES:
        with Image.open(tmp_path / name) as picture:
            values = np.asarray(picture.convert("L"))
        assert values.shape[1] > 500
        assert values.std() > 5


@nightly
def test_figures_are_the_same_bytes_again(results: CaptureResults, tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("first", "second")]
    for folder in folders:
        folder.mkdir()
        write_capture_page(results, folder)
    for name in FIGURES:
        assert len({(folder / name).read_bytes() for folder in folders}) == 1, name


@pytest.mark.usefixtures("undrawn_figures")
def test_warnings_and_missing_images_are_notices(results: CaptureResults, tmp_path: Path) -> None:
    from dataclasses import replace

    assert results.calibration is not None
    calibration = replace(results.calibration, warnings=("the halves <differ>",))
    check = replace(results.check, missing=("images/s+1_t+0.tif",))
    page = write_capture_page(replace(results, calibration=calibration, check=check), tmp_path)
    assert '<p class="notice" role="note">the halves &lt;differ&gt;</p>' in page
    assert "1 images are missing: images/s+1_t+0.tif" in page


@pytest.mark.usefixtures("undrawn_figures")
def test_capture_without_board_and_frames_has_a_page(board_capture: Path, tmp_path: Path) -> None:
    none = dict.fromkeys(("dark", "flat", "static"))
    folder = open_capture(changed_capture(board_capture, tmp_path / "c", files=none))
    (tmp_path / "figures").mkdir()
    page = write_capture_page(CaptureResults(folder, check_capture(folder.capture)), tmp_path / "figures")
    assert "No images of a board" in page
    assert "Suggestions" not in page
    assert "Not measured: add files.dark and files.flat." in page
    assert draw_noise(folder, None, tmp_path) == []
    assert noise_words(folder, None) == ["Not measured: add files.dark and files.flat."]


@pytest.mark.usefixtures("undrawn_figures")
@pytest.mark.parametrize("stated", [False, True])
def test_growth_is_shown_with_its_uncertainty_only(stated: bool, results: CaptureResults, tmp_path: Path) -> None:
    estimate = make_growing_case(32, 24, 250.0).estimate
    estimate = estimate.drop_vars([name for name in estimate if str(name).startswith("growth_rate_std")])
    if stated:
        # 0.001 per frame of 60 s is 6 % per hour.
        estimate = estimate.assign(growth_rate_std=0.001 + 0 * estimate["depth"].fillna(0))
    estimate.attrs["frame_interval_s"] = 60.0
    figures, pictures = tmp_path / "figures", tmp_path / "pictures"
    figures.mkdir()
    pictures.mkdir()
    Image.new("RGB", (8, 6)).save(figures / "growth_rate.png")
    shown = replace(results, estimate=estimate, figures=figures, calibration=None, solution=None)
    page = without_definitions(write_capture_page(shown, pictures))
    assert ("Median standard uncertainty of a pixel: 6 %/h." in page) is stated
    assert ("<b>Growth rate.</b>" in page) is stated
