"""The capture file that is written from the names of a folder's images."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import yaml

from scenetruth.capture import CAPTURE_FILE, capture_text, load_capture, open_capture, write_capture_file
from scenetruth.errors import CaptureError
from tests.helpers.captured_folders import write_capture


def touch(folder: Path, *names: str, value: int = 3000, **more: Any) -> None:
    for name in names:
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        tifffile.imwrite(file, np.full((20, 30), value, dtype=np.uint16), **more)


def guessed(folder: Path, **more: Any) -> dict[str, Any]:
    return dict(yaml.safe_load(capture_text(folder, **more)))


def test_folder_of_a_capture_is_understood(tmp_path: Path) -> None:
    """With focal length and baseline given, the file written for a folder loads, and its images open."""
    made = write_capture(tmp_path / "lab", shape=(24, 32))
    (tmp_path / "lab" / CAPTURE_FILE).unlink()
    write_capture_file(made.folder, focal_length_px=1000, baseline_mm=2)
    capture = load_capture(made.folder)
    assert (capture.camera.width, capture.camera.height, capture.camera.bit_depth) == (32, 24, 12)
    assert (capture.stage.positions, capture.frames.count) == (5, 5)
    files = capture.files
    assert (files.images, files.dark, files.static) == (
        "images/s{s:+d}_t{t:03d}.tif",
        "dark/dark*.tif",
        "static/n*.tif",
    )
    assert files.flat == "flat/e{level}_*.tif"
    folder = open_capture(capture)
    assert len(folder.images.files) == 25
    assert {name: len(one.headers) for name, one in folder.sets.items()} == {"dark": 8, "flat": 16, "static": 8}


def test_unknown_values_are_empty_and_must_be_filled_in(tmp_path: Path) -> None:
    touch(tmp_path, *(f"pos{s}_t{t}.tif" for s in range(3) for t in range(2)))
    write_capture_file(tmp_path)
    with pytest.raises(CaptureError, match=r"stage\.baseline_mm: is empty; fill it in"):
        load_capture(tmp_path)
    text = (tmp_path / CAPTURE_FILE).read_text(encoding="utf-8").replace("baseline_mm:", "baseline_mm: 5")
    (tmp_path / CAPTURE_FILE).write_text(text, encoding="utf-8")
    assert load_capture(tmp_path).camera.focal_length_px is None


@pytest.mark.parametrize(
    ("names", "field", "pattern"),
    [
        ([f"cam{s:02d}/frame_{t:04d}.tiff" for s in range(1, 4) for t in range(9, 12)], "images",
         "cam{s:02d}/frame_{t:04d}.tiff"),
        ([f"IMG_{t:04d}.tif" for t in range(5)], "images", "IMG_{t:04d}.tif"),
        (["a_1.tif", *(f"Calibration/pose{p}_cam{s}.tif" for p in range(3) for s in range(2))], "board",
         "Calibration/pose{pose}_cam{s}.tif"),
        (["a_1.tif", *(f"checkerboard_{p}.tif" for p in range(3))], "board", "checkerboard_{pose}.tif"),
        (["a_1.tif", *(f"Dark Frames/d-{n:03d}.tif" for n in range(4))], "dark", "Dark Frames/d-*.tif"),
        (["a_1.tif", *(f"flatfield_exp{e}_{n}.tif" for e in range(2) for n in range(3))], "flat",
         "flatfield_exp{level}_*.tif"),
        (["a_1.tif", "mask.tif"], "mask", "mask.tif"),
    ],
)  # fmt: skip
def test_names_of_many_laboratories(tmp_path: Path, names: list[str], field: str, pattern: str) -> None:
    touch(tmp_path, *names)
    assert guessed(tmp_path, baseline_mm=5)["files"][field] == pattern


def test_bits_times_and_exposures_come_from_the_files(tmp_path: Path) -> None:
    for t in range(4):
        tags = [(33434, 5, 1, (1, 100), False)]
        touch(tmp_path, f"s0_t{t}.tif", f"s1_t{t}.tif", datetime=f"2024:03:01 12:0{t}:30", value=900, extratags=tags)
    plain = guessed(tmp_path, baseline_mm=5)
    assert plain["camera"]["bit_depth"] == 10
    assert plain["camera"]["exposure_time_s"] == 0.01
    assert plain["frames"]["frame_interval_s"] == 60


def test_missing_files_and_others_are_mentioned(tmp_path: Path) -> None:
    touch(tmp_path, *(f"s{s}_t{t}.tif" for s in range(3) for t in range(3) if (s, t) != (1, 1)), "extra/photo.tif")
    text = capture_text(tmp_path, baseline_mm=5)
    assert "missing: s1_t1.tif" in text
    assert "other files: extra/photo.tif (1 file)" in text


def test_rows_ask_for_their_spacing(tmp_path: Path) -> None:
    touch(tmp_path, *(f"row{r}_s{s}_t{t}.tif" for r in range(2) for s in range(2) for t in range(2)))
    plain = guessed(tmp_path, baseline_mm=5)
    assert plain["stage"]["rows"] == 2
    assert plain["stage"]["row_spacing_mm"] is None
    write_capture_file(tmp_path, baseline_mm=5)


def test_existing_files_are_not_replaced(tmp_path: Path) -> None:
    touch(tmp_path, "s0.tif", "s1.tif")
    (tmp_path / CAPTURE_FILE).write_text("mine", encoding="utf-8")
    with pytest.raises(CaptureError, match="already"):
        write_capture_file(tmp_path)
    assert (tmp_path / CAPTURE_FILE).read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    ("names", "message"),
    [([], "has no images"), (["one.tif", "two.tif"], "differ in more than numbers"), (["dark1.tif"], "only 1 of dark")],
)
def test_folders_without_a_measurement_say_why(tmp_path: Path, names: list[str], message: str) -> None:
    touch(tmp_path, *names)
    with pytest.raises(CaptureError, match=message):
        capture_text(tmp_path)
    with pytest.raises(CaptureError, match="is not a directory"):
        capture_text(tmp_path / "none")
    with pytest.raises(CaptureError, match="focal_length_px"):
        capture_text(tmp_path, focal_length_px=-1)
