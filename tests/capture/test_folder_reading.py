"""The folder of a capture: its correction and geometry, and its import as a recording."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import assume, given, settings
from hypothesis import strategies as some

import scenetruth
from scenetruth.capture import check_capture, import_capture, open_capture
from scenetruth.errors import CaptureError, CaptureWarning, OutputExistsError
from tests.helpers.captured_folders import CapturedFolder, fall_off, store, write_capture

SHAPE = (40, 56)


@pytest.fixture
def captured(tmp_path: Path) -> CapturedFolder:
    return write_capture(tmp_path / "lab", 5, shape=SHAPE, positions=3, frames=3, prnu=0.05, dsnu_e=20.0)


def raw(captured: CapturedFolder) -> np.ndarray[Any, Any]:
    return np.array(
        [[tifffile.imread(captured.folder / captured.names[s, t]) for t in range(3)] for s in (-1, 0, 1)]
    )  # fmt: skip


def test_import_without_correction_is_what_the_files_hold(captured: CapturedFolder) -> None:
    found = import_capture(captured.folder, correct=False)
    assert found.image.dtype == np.uint16
    assert np.array_equal(found.image, raw(captured))
    assert found.attrs["full_scale"] == 4095
    assert found.attrs["focal_length_px"] == 1000
    assert found.stage_x_mm.values.tolist() == [-2, 0, 2]
    assert found.attrs["frame_interval_s"] == 10
    assert found.attrs["stage_tolerance_scale_ppm"] == pytest.approx(100)


def test_correction_removes_the_fixed_pattern(captured: CapturedFolder) -> None:
    """The same scene by the same sensor with the same noise, but without patterns: what is left is their noise."""
    plain = write_capture(
        captured.folder.parent / "ideal", 5, shape=SHAPE, positions=3, frames=3, prnu=0.0, dsnu_e=0.0, sets=()
    )
    ideal = raw(plain) - 16.0
    corrected = import_capture(captured.folder).image.values
    # Flat fields of a light that falls off make images of an even light brighter there.
    corrected *= fall_off(SHAPE)
    before, after = raw(captured) - 16.0 - ideal, corrected - ideal * corrected.mean() / ideal.mean()
    # A spread of 5 % of 1,800 DN is 90 DN; 8 flat fields leave noise of 0.5 %, 9 images 9 DN of shot noise each.
    fixed = before.mean(axis=(0, 1)).std(), after.mean(axis=(0, 1)).std()
    assert fixed[0] > 60
    assert fixed[1] < 20


def test_dark_frames_of_another_exposure_are_not_taken(captured: CapturedFolder) -> None:
    """Of several levels, the level of the images' exposure time is subtracted."""
    for n in range(4):
        store(captured.folder / f"dark/e1_{n}.tif", np.full(SHAPE, 900, dtype=np.uint16))
        store(captured.folder / f"dark/e0_{n}.tif", np.full(SHAPE, 20, dtype=np.uint16))
    captured.plain["files"] |= {"dark": "dark/e{level}_*.tif", "exposure_times_s": [0.01, 0.1]}
    captured.plain["files"].pop("flat")
    captured.write()
    found = import_capture(captured.folder)
    assert np.allclose(found.image, raw(captured).astype(np.float32) - 20, atol=1e-3)
    captured.plain["camera"]["exposure_time_s"] = 0.1
    captured.plain["camera"].pop("black_level_dn")
    captured.write()
    assert float(import_capture(captured.folder).image.mean() - found.image.mean()) == pytest.approx(-880, abs=0.1)


def test_import_writes_a_store_that_estimates_can_use(captured: CapturedFolder, tmp_path: Path) -> None:
    mask = np.zeros(SHAPE, dtype=np.uint8)
    mask[3, 4] = 255
    store(captured.folder / "mask.tif", mask)
    captured.plain["files"]["mask"] = "mask.tif"
    captured.write()
    (captured.folder / captured.names[1, 2]).unlink()
    with pytest.warns(CaptureWarning, match="s\\+1_t002.tif"):
        found = import_capture(captured.folder, output=tmp_path / "run")
    with pytest.warns(CaptureWarning):
        memory = import_capture(captured.folder)
    stored = scenetruth.load_store(tmp_path / "run" / "recording.zarr", kind="recording")
    for one in (found.load(), stored):
        assert one.drop_attrs().equals(memory.drop_attrs())
        assert json.loads(one.attrs["missing_images"]) == ["images/s+1_t002.tif"]
    assert stored.exclusion_mask.values[3, 4]
    assert np.isnan(stored.image[2, 2]).all()
    with pytest.raises(OutputExistsError):
        import_capture(captured.folder, output=tmp_path / "run")
    with pytest.warns(CaptureWarning):
        import_capture(captured.folder, output=tmp_path / "run", overwrite=True)


def test_failed_import_leaves_nothing(captured: CapturedFolder, tmp_path: Path) -> None:
    # Only the values show that the bit depth is wrong.
    captured.plain["camera"] |= {"bit_depth": 9}
    captured.plain["files"] = {"images": captured.plain["files"]["images"]}
    captured.write()
    with pytest.raises(CaptureError, match="more than the 511"):
        import_capture(captured.folder, output=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_flat_fields_of_more_bits_are_not_saturated(captured: CapturedFolder) -> None:
    """Twelve bits with the default of eight: the cause is named wherever the frames are read."""
    del captured.plain["camera"]["bit_depth"]
    captured.plain["camera"]["black_level_dn"] = 0
    captured.write()
    for read in (lambda: open_capture(captured.folder).correction(), lambda: import_capture(captured.folder)):
        with pytest.raises(CaptureError, match="more than the 255 of 8 bits; set bit_depth to that of the camera"):
            read()
    report = check_capture(captured.folder)
    assert [each.mistake for each in report.findings if each.severity == "error"] == ["bit_depth"]


def test_undistorted_import_is_the_undistorted_recording(captured: CapturedFolder, tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="no distortion to remove"):
        import_capture(captured.folder, undistort=True)
    captured.plain["camera"]["distortion"] = {"k1": -30.0}
    captured.write()
    kept = import_capture(captured.folder)
    assert kept.attrs["distortion"][0] == -30
    found = import_capture(captured.folder, undistort=True, output=tmp_path / "run")
    assert found.image.equals(scenetruth.undistort_images(kept).image)
    assert "distortion" not in found.attrs


def test_tables_give_positions_and_times(captured: CapturedFolder) -> None:
    (captured.folder / "x.csv").write_text("s,x_mm\n-1,98.1\n0,100.0\n1,102.05\n", encoding="utf-8")
    rows = [f"{s},{t},{100 + 10 * t + 2 * s}" for s in (-1, 0, 1) for t in range(3)]
    (captured.folder / "t.csv").write_text("s, t, time_s\n" + "\n".join(rows), encoding="utf-8")
    captured.plain["stage"]["positions_file"] = "x.csv"
    captured.plain["frames"] |= {"times": "file", "times_file": "t.csv"}
    captured.write()
    found = import_capture(captured.folder, correct=False)
    assert np.allclose(found.stage_x_mm, [-1.9, 0, 2.05])
    assert found.planned_time_s.values.tolist() == [[-12, -2, 8], [-10, 0, 10], [-8, 2, 12]]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("s,x\n0,1\n", "lacks the columns x_mm; it has s, x"),
        ("s,x_mm\n-1,-2\n0,0\n", "lacks the positions s = 1"),
        ("s,x_mm\n-1,-2\n0,zero\n1,2\n", "line 3: x_mm must be a number"),
        ("s,x_mm\n-1,2\n0,0\n1,-2\n", "position s = -1 is 2 mm from the reference, but -2 mm are planned"),
        ("s,x_mm\n-1,-0.002\n0,0\n1,0.002\n", "the unit or order of the table"),
        ("s,x_mm\n", "has no rows"),
        ("s,x_mm\n-1,-2\n0,0\n0,0.1\n1,2\n", "lists the positions s = 0 more than once"),
        ("s,x_mm\n-1,-2\n0,-2\n1,2\n", "positions s = -1 and 0 are at -2 and -2 mm: they coincide"),
        (None, "cannot be read"),
    ],
)
def test_tables_that_do_not_fit_say_why(captured: CapturedFolder, table: str | None, message: str) -> None:
    if table is not None:
        (captured.folder / "x.csv").write_text(table, encoding="utf-8")
    captured.plain["stage"]["positions_file"] = "x.csv"
    captured.write()
    with pytest.raises(CaptureError, match="positions_file") as caught:
        import_capture(captured.folder)
    assert message in str(caught.value)


def test_planned_times_follow_the_scan(captured: CapturedFolder) -> None:
    captured.plain["stage"] |= {"scan": "bidirectional", "time_per_position_s": 1.0}
    captured.write()
    found = import_capture(captured.folder, correct=False)
    # Frames -1 and 1 are scanned backwards.
    assert found.planned_time_s.values.tolist() == [[-9, -1, 11], [-10, 0, 10], [-11, 1, 9]]


def test_times_of_the_files_must_be_fine_enough(captured: CapturedFolder) -> None:
    for (s, t), name in captured.names.items():
        values = tifffile.imread(captured.folder / name)
        stamp = f"2024:03:01 12:{t:02d}:{10 + s:02d}"
        store(captured.folder / name, values, datetime=stamp)
    captured.plain["frames"] |= {"times": "exif", "frame_interval_s": 60.0}
    captured.write()
    found = import_capture(captured.folder, correct=False)
    assert found.planned_time_s.values.tolist() == [[-61, -1, 59], [-60, 0, 60], [-59, 1, 61]]
    captured.plain["frames"]["frame_interval_s"] = 5.0
    captured.write()
    with pytest.raises(CaptureError, match="resolution of 1 s, which is too coarse"):
        import_capture(captured.folder, correct=False)


def test_all_sets_are_checked_together(captured: CapturedFolder) -> None:
    captured.plain["files"] |= {"dark": "darks/*.tif", "board": "board/{pose}.tif"}
    captured.plain["board"] = {"kind": "dots", "dots": [9, 7], "spacing_mm": 5, "diameter_mm": 2}
    captured.write()
    captured.frames("flat")[0].write_text("no image")
    (captured.folder / captured.names[0, 0]).write_text("no image")
    with pytest.raises(CaptureError) as caught:
        open_capture(captured.folder)
    paths = [problem.path for problem in caught.value.problems]
    assert paths == ["images/s+0_t000.tif", "files.dark", "flat/e0_00.tif", "files.board"]
    assert "nearest: dark/dark*.tif (8 files)" in str(caught.value)


def test_exchanged_dark_and_flat_are_rejected(captured: CapturedFolder) -> None:
    captured.plain["files"] |= {"dark": "flat/e1_*.tif", "flat": "dark/*.tif"}
    captured.plain["files"].pop("exposure_times_s")
    captured.write()
    with pytest.raises(CaptureError, match="are they exchanged"):
        import_capture(captured.folder)


def test_missing_focal_length_is_found_before_work(captured: CapturedFolder, tmp_path: Path) -> None:
    captured.plain["camera"].pop("focal_length_px")
    captured.write()
    with pytest.raises(CaptureError, match=r"camera\.focal_length_px"):
        import_capture(captured.folder, output=tmp_path / "run")


@pytest.mark.parametrize("form", ["colour", "plane", "gamma", "grid"])
def test_other_forms_of_images_are_corrected_and_checked_alike(tmp_path: Path, form: str) -> None:
    """Images, dark frames and flat fields are brought into one form before the correction."""
    draw = np.random.default_rng(1)
    shape = (20, 30, 3) if form == "colour" else (20, 30)
    rows = 2 if form == "grid" else 1
    images = draw.integers(400, 3000, (rows, 3, 2, *shape)).astype(np.uint16)
    dark = draw.integers(10, 20, (5, *shape)).astype(np.uint16)
    flat = draw.integers(1500, 2500, (5, *shape)).astype(np.uint16)
    plain: dict[str, Any] = {
        "camera": {"width": 30, "height": 20, "bit_depth": 12, "focal_length_px": 100},
        "stage": {"positions": 3, "baseline_mm": 5},
        "frames": {"count": 2},
        "files": {"images": "r{row}_s{s}_t{t}.tif", "dark": "dark/*.tif", "flat": "flat/*.tif"},
    }
    if form == "plane":
        plain["camera"] |= {"bayer": "gbrg", "plane": "red"}
    if form == "gamma":
        plain["camera"] |= {"encoding": "gamma", "gamma": 2.0}
    if form == "grid":
        plain["stage"] |= {"rows": 2, "row_spacing_mm": 4}
    for row, s, t in np.ndindex(rows, 3, 2):
        store(tmp_path / f"r{row}_s{s}_t{t}.tif", images[row, s, t])
    for n in range(5):
        store(tmp_path / f"dark/{n}.tif", dark[n])
        store(tmp_path / f"flat/{n}.tif", flat[n])
    made = CapturedFolder(tmp_path, None, plain)  # type: ignore[arg-type]
    made.write()

    def light(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        values = values[..., 1::2, 0::2] if form == "plane" else values
        return (values / 4095.0) ** 2 if form == "gamma" else values.astype(np.float64)

    low, high = light(dark).mean(axis=0), light(flat).mean(axis=0)
    # Each colour has its own mean responsivity.
    axes = (0, 1) if form == "colour" else None
    expected = (light(images) - low) / (high - low) * (high - low).mean(axis=axes)
    found = import_capture(made.folder)
    values = found.image.values if form == "grid" else found.image.values[None]
    finite = np.isfinite(values)
    # Random frames make some pixels of unusual sensitivity, which are marked.
    assert finite.mean() > 0.9
    assert np.allclose(values[finite], expected[finite], rtol=2e-5, atol=1e-6)
    assert found.attrs["full_scale"] == pytest.approx((1 if form == "gamma" else 4095) - low.mean())
    report = check_capture(made.folder)
    assert report.image_count == 6 * rows
    assert "files" not in report.mistakes("error")


@pytest.mark.parametrize(
    ("distance_mm", "message"), [(0.6, r"distance_mm: 0\.6 mm is 0\.3 baselines of 2 mm; is it in m"), (600.0, "")]
)
def test_a_distance_in_another_unit_is_asked_for(captured: CapturedFolder, distance_mm: float, message: str) -> None:
    captured.plain["distance_mm"] = distance_mm
    captured.write()
    report = check_capture(captured.folder)
    assert ("units" in report.mistakes("warning")) == bool(message)
    if message:
        with pytest.warns(CaptureWarning, match=message):
            found = import_capture(captured.folder)
    else:
        found = import_capture(captured.folder)
    assert found.attrs["distance_mm"] == distance_mm


def test_a_focal_length_in_mm_in_the_capture_file_is_asked_for(captured: CapturedFolder) -> None:
    captured.plain["camera"]["focal_length_px"] = 6.2
    captured.write()
    assert "units" in check_capture(captured.folder).mistakes("warning")
    with pytest.warns(scenetruth.SceneWarning, match=r"focal_length_px: 6\.2 px .* is it in mm\?"):
        import_capture(captured.folder)


PLANTED: dict[str, tuple[dict[str, Any], str]] = {
    "wrong type": ({"camera.line_time_s": "slow"}, "camera.line_time_s"),
    "misspelt key": ({"camera.hight": 3}, "camera.hight"),
    "out of range": ({"camera.bit_depth": 40}, "camera.bit_depth"),
    "misspelt section": ({"boards": {}}, "boards"),
    "stage out of range": ({"stage.time_per_position_s": -1}, "stage.time_per_position_s"),
    "two distances": ({"distance_mm": -5}, "distance_mm"),
    "missing positions": ({"stage.positions_file": "none.csv"}, "stage.positions_file"),
    "missing times": ({"frames.times": "file", "frames.times_file": "none.csv"}, "frames.times_file"),
    "missing mask": ({"files.mask": "none.png"}, "files.mask"),
    "missing strip": ({"strip": {"file": "none.csv"}}, "strip.file"),
    "strip out of range": ({"strip.scale_std": -1.0, "strip.file": "strip.csv"}, "strip.scale_std"),
    "pattern without files": ({"files.flat": "flut/*.tif"}, "files.flat"),
    "pattern with an unknown field": ({"files.static": "static/{pose}.tif"}, "files.static"),
    "board without a description": ({"files.board": "none/{pose}.tif"}, ""),
    "broken file": ({}, "dark/broken.tif"),
}


def planted(folder: Path, plain: dict[str, Any], names: Iterable[str]) -> None:
    """Write a capture file with mistakes."""
    plain = json.loads(json.dumps(plain))
    (folder / "strip.csv").write_text("x_mm,y_mm,z_mm\n0,0,0\n")
    broken = folder / "dark" / "broken.tif"
    broken.unlink(missing_ok=True)
    for name in names:
        if name == "broken file":
            broken.write_bytes(b"II*")
        for path, value in PLANTED[name][0].items():
            *above, last = path.split(".")
            owner = plain
            for key in above:
                owner = owner.setdefault(key, {})
            owner[last] = value
    (folder / "capture.yaml").write_text(json.dumps(plain))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> CapturedFolder:
    return write_capture(tmp_path_factory.mktemp("planted") / "lab", 5, shape=(12, 16), positions=2, frames=2)


@settings(max_examples=12, deadline=None)
@given(names=some.lists(some.sampled_from(sorted(PLANTED)), min_size=1, unique=True))
def test_mistakes_do_not_hide_each_other(whole: CapturedFolder, names: list[str]) -> None:
    # The last has the file of the first.
    assume(not {"missing strip", "strip out of range"} <= {*names})
    planted(whole.folder, whole.plain, names)
    with pytest.raises(CaptureError) as caught:
        open_capture(whole.folder)
    found = [problem.path for problem in caught.value.problems]

    def is_of(name: str, path: str) -> bool:
        where = PLANTED[name][1]
        return path.startswith(where) if where else path in ("", "files.board")

    assert [name for name in names if not any(is_of(name, path) for path in found)] == []
    assert [path for path in found if not any(is_of(name, path) for name in names)] == []
