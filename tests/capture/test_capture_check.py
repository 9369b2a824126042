"""Mistakes that images show by themselves: each is named, and clean captures have none."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter

from scenetruth.capture import CaptureReport, check_capture
from scenetruth.errors import CaptureError
from tests.helpers.captured_folders import CapturedFolder, store, write_capture
from tests.helpers.nightly import by_night

SHAPE = (96, 128)


def captured(folder: Path, seed: int = 1, **more: Any) -> CapturedFolder:
    return write_capture(folder / "lab", seed, shape=SHAPE, **more)


def change(files: list[Path], function: Callable[[NDArray[Any]], NDArray[Any]]) -> None:
    for file in files:
        values = tifffile.imread(file)
        store(file, function(values.astype(np.float64)).astype(values.dtype))


def mistakes(made: CapturedFolder) -> list[str]:
    return check_capture(made.folder).mistakes("error", "warning")


@pytest.mark.parametrize("seed", [0, *by_night(1, 2, 3)])
@pytest.mark.parametrize("preset", ["industrial_cmos", "ccd_2002", *by_night("scientific_cmos")])
def test_clean_captures_have_no_mistakes(tmp_path: Path, preset: str, seed: int) -> None:
    report = check_capture(captured(tmp_path, seed, preset=preset).folder)
    assert report.usable
    assert [str(one) for one in report.findings if one.severity != "note"] == []
    assert report.image_count == 25
    assert any("proportional to the exposure time" in one.message for one in report.findings)
    assert report.gamma is not None
    assert report.gamma.linear in (True, None)


def test_report_has_the_noise_of_the_sensor(tmp_path: Path) -> None:
    made = captured(tmp_path)
    report = check_capture(made.folder)
    assert report.noise is not None
    assert abs(report.noise.gain_dn_per_e - made.sensor.gain_dn_per_e) < 4 * report.noise.gain_std
    plain = json.loads(json.dumps(report.to_dict()))
    assert plain["noise"]["gain_dn_per_e"] == pytest.approx(report.noise.gain_dn_per_e)
    assert plain["usable"] is True


def test_without_frames_at_rest_linearity_is_said_to_be_untested(tmp_path: Path) -> None:
    report = check_capture(captured(tmp_path, sets=("dark",)).folder)
    assert report.usable
    assert any("linearity is not tested" in one.message for one in report.findings)


def test_missing_image_is_named(tmp_path: Path) -> None:
    made = captured(tmp_path)
    (made.folder / made.names[0, 3]).unlink()
    report = check_capture(made.folder)
    assert report.mistakes("error", "warning") == ["missing_image"]
    assert report.missing == ("images/s+0_t003.tif",)
    assert report.usable


def test_wrong_pattern_gets_the_nearest(tmp_path: Path) -> None:
    made = captured(tmp_path)
    made.plain["files"]["images"] = "images/pos{s}_t{t:02d}.tif"
    made.write()
    report = check_capture(made.folder)
    assert report.mistakes("error") == ["files"]
    assert "nearest: images/s{s:+d}_t{t:03d}.tif (25 files)" in str(report.findings[0])


def test_turned_images_are_named(tmp_path: Path) -> None:
    made = captured(tmp_path)
    file = made.folder / made.names[1, 2]
    store(file, tifffile.imread(file), extratags=[(274, "H", 1, 8, False)])
    report = check_capture(made.folder)
    assert report.mistakes("error", "warning") == ["turned"]
    assert "images/s+1_t002.tif" in str(report.findings[0])
    for name in made.names.values():
        store(made.folder / name, np.rot90(tifffile.imread(made.folder / name)).copy())
    report = check_capture(made.folder)
    assert report.mistakes("error", "warning") == ["turned"]
    assert len(report.findings) == 25


@pytest.mark.parametrize("preset", ["industrial_cmos", "scientific_cmos", "ccd_2002"])
def test_saturation_at_and_below_full_scale(tmp_path: Path, preset: str) -> None:
    # The full well saturates below the full scale of the converter, or at it.
    assert mistakes(captured(tmp_path, preset=preset, exposure=2.0)) == ["saturated"]
    shutil.rmtree(tmp_path / "lab")
    made = captured(tmp_path, preset=preset)
    full = 2**made.sensor.bit_depth - 1
    change([made.folder / made.names[1, 1]], lambda values: np.where(values > np.median(values), full, values))
    report = check_capture(made.folder)
    assert report.mistakes("error") == ["saturated"]
    assert "1 of 25 images" in str(report.findings[0])


def test_bright_uniform_surface_is_not_saturated(tmp_path: Path) -> None:
    """Half of each image is as bright as its brightest point, with shot noise: no value is cut off."""
    made = captured(tmp_path)
    opened = made.sensor.chain().open(SHAPE, lambda *key: np.random.default_rng(abs(hash(key)) % 2**32))
    from tests.helpers.captured_folders import read

    bright = np.full(SHAPE, 0.95)
    for number, name in enumerate(made.names.values()):
        values = tifffile.imread(made.folder / name)
        values[:, :64] = read(opened, bright, 7, number)[:, :64]
        store(made.folder / name, values)
    assert "saturated" not in mistakes(made)


@pytest.mark.parametrize("with_flats", [True, False])
@pytest.mark.parametrize("cut", [True, False])
def test_uniform_background_of_a_quiet_camera_is_told_from_values_that_are_cut_off(
    tmp_path: Path, with_flats: bool, cut: bool
) -> None:
    """A background of 230 DN with a noise of 2 DN: narrow as a plateau, but as wide as its shot noise."""
    draw = np.random.default_rng(1)
    gain, black = 4 / 210, 20

    def shown(light: NDArray[np.float64]) -> NDArray[np.uint8]:
        noise = np.sqrt(gain * light + 0.6**2) * draw.standard_normal(light.shape)
        values = black + light + noise
        return np.asarray(np.rint(np.clip(np.minimum(values, 228) if cut else values, 0, 255)), dtype=np.uint8)

    light = np.full((64, 80), 215.0 if cut else 210.0)
    light[20:44, 20:60] = draw.uniform(20, 150, (24, 40))
    plain: dict[str, Any] = {
        "camera": {"width": 80, "height": 64, "focal_length_px": 100},
        "stage": {"positions": 3, "baseline_mm": 5},
        "frames": {"count": 3},
        "files": {"images": "s{s}_t{t}.tif"},
    }
    for s, t in np.ndindex(3, 3):
        store(tmp_path / f"s{s}_t{t}.tif", shown(light))
    if with_flats:
        plain["files"] |= {"dark": "dark/*.tif", "flat": "flat/*.tif"}
        for n in range(6):
            store(tmp_path / f"dark/{n}.tif", shown(np.zeros((64, 80))))
            store(tmp_path / f"flat/{n}.tif", shown(np.full((64, 80), 120.0)))
    made = CapturedFolder(tmp_path, None, plain)  # type: ignore[arg-type]
    made.write()
    report = check_capture(tmp_path)
    assert ("saturated" in report.mistakes("error")) == (cut and with_flats)
    assert ("saturated" in report.mistakes("warning")) == (not with_flats)


def test_dark_images_are_an_error(tmp_path: Path) -> None:
    assert mistakes(captured(tmp_path, exposure=0.01, sets=())) == ["exposure"]


@pytest.mark.parametrize(("preset", "sets"), [
    ("industrial_cmos", ("dark", "flat", "static")),
    ("ccd_2002", ("dark", "flat", "static")),
    *by_night(
        ("scientific_cmos", ("dark", "flat", "static")),
        ("industrial_cmos", ("dark", "flat")),
        ("industrial_cmos", ("dark", "static")),
        ("scientific_cmos", ("dark", "static")),
    ),
    # The noise leaves two exponents, of which the dark frames confirm one.
    ("ccd_2002", ("dark", "static")),
])  # fmt: skip
def test_encoded_images_are_named(tmp_path: Path, preset: str, sets: tuple[str, ...]) -> None:
    made = captured(tmp_path, preset=preset, sets=sets, gamma=0.45)
    assert mistakes(made) == ["gamma"]
    made.plain["camera"] |= {"encoding": "gamma", "gamma": 1 / 0.45, "black_level_dn": 0}
    made.write()
    assert "gamma" not in mistakes(made)


def test_encodings_that_files_state_are_reported(tmp_path: Path) -> None:
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    info.add(b"sRGB", b"\0")
    image = np.random.default_rng(1).integers(20, 200, (20, 30)).astype(np.uint8)
    plain = {
        "camera": {"width": 30, "height": 20, "focal_length_px": 100},
        "stage": {"positions": 2, "baseline_mm": 5},
        "frames": {"count": 1},
        "files": {"images": "s{s}.png"},
    }
    made = CapturedFolder(tmp_path, None, plain)  # type: ignore[arg-type]
    for s in range(2):
        Image.fromarray(image).save(tmp_path / f"s{s}.png", pnginfo=info)
        Image.fromarray(image).save(tmp_path / f"s{s}.jpg", quality=98)
    made.write()
    assert mistakes(made) == ["gamma"]
    made.plain["camera"]["encoding"] = "srgb"
    made.write()
    assert mistakes(made) == []
    made.plain["files"]["images"] = "s{s}.jpg"
    made.write()
    assert any("JPEG" in str(one) for one in check_capture(tmp_path).findings)


def test_dark_frames_with_light_or_another_gain_are_wrong(tmp_path: Path) -> None:
    for change_of in (lambda values: values + 400, lambda values: 2 * values, lambda values: values / 3):
        made = captured(tmp_path)
        change(made.frames("dark"), change_of)
        assert mistakes(made) == ["dark"]
        # Without a stated black level, images that are darker than the dark frames or flat fields show it.
        shutil.rmtree(tmp_path / "lab")


def test_dark_frames_of_another_exposure_are_wrong(tmp_path: Path) -> None:
    made = captured(tmp_path)
    for file in made.frames("dark"):
        store(file, tifffile.imread(file), extratags=[(33434, 5, 1, (1, 50), False)])
    report = check_capture(made.folder)
    assert report.mistakes("error") == ["dark"]
    assert "exposed for 0.02 s, the images for 0.01 s" in str(report.findings[0])


def test_dark_frames_of_another_camera_are_wrong(tmp_path: Path) -> None:
    """Their fixed pattern is not in the images; where it is too weak to be seen, nothing is claimed."""
    made = captured(tmp_path, 1, dsnu_e=60.0, black_level_dn=200.0, sets=("dark",))
    assert mistakes(made) == []
    other = write_capture(tmp_path / "other", 2, shape=SHAPE, dsnu_e=60.0, black_level_dn=200.0, sets=("dark",))
    shutil.rmtree(made.folder / "dark")
    shutil.copytree(other.folder / "dark", made.folder / "dark")
    report = check_capture(made.folder)
    assert report.mistakes("error", "warning") == ["dark"]
    assert "fixed pattern" in str(report.findings[0])


def test_blurred_images_are_named(tmp_path: Path) -> None:
    made = captured(tmp_path, sets=())
    change([made.folder / made.names[1, 3]], lambda values: gaussian_filter(values, 2.0))
    report = check_capture(made.folder)
    assert report.mistakes("error", "warning") == ["blurred"]
    assert "images/s+1_t003.tif: is blurred" in str(report.findings[0])
    assert report.usable


def with_boards(made: CapturedFolder, scale: float = 1.0) -> list[Path]:
    """Add images of a board of two poses at three positions."""
    files = []
    draw = np.random.default_rng(1)
    y, x = np.indices(SHAPE)
    for pose, s in np.ndindex(2, 3):
        squares = ((x + 3 * s) // 12 + (y + 5 * pose) // 12) % 2
        light = 200 + 1800 * scale * gaussian_filter(squares.astype(float), 0.8)
        file = made.folder / f"board/p{pose}_s{s - 1:+d}.tif"
        store(file, np.clip(light + 8 * draw.standard_normal(SHAPE), 0, 4095).astype(np.uint16))
        files.append(file)
    made.plain["files"]["board"] = "board/p{pose}_s{s:+d}.tif"
    # Another board, which is not found: the check of the response is skipped.
    made.plain["board"] = {"kind": "dots", "dots": [9, 7], "spacing_mm": 5, "diameter_mm": 2}
    made.write()
    return files


def test_blurred_and_saturated_boards_are_named(tmp_path: Path) -> None:
    made = captured(tmp_path, sets=(), positions=3)
    files = with_boards(made)
    assert mistakes(made) == []
    change([files[4]], lambda values: gaussian_filter(values, 2.0))
    report = check_capture(made.folder)
    assert report.mistakes("error", "warning") == ["blurred"]
    assert "board/p1_s+0.tif: is blurred" in str(report.findings[0])
    with_boards(made, scale=3.0)
    report = check_capture(made.folder)
    assert report.mistakes("error") == ["saturated"]
    assert "6 of 6 board images" in str(report.findings[0])


def test_srgb_is_named_by_dark_frames_and_noise(tmp_path: Path) -> None:
    made = captured(tmp_path, preset="scientific_cmos", sets=("dark", "static"))
    full = 2**made.sensor.bit_depth - 1

    def encode(values: NDArray[Any]) -> NDArray[Any]:
        share = values / full
        return np.asarray(full * np.where(share < 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055))

    change([*map(made.folder.joinpath, made.names.values()), *made.frames("dark"), *made.frames("static")], encode)
    assert mistakes(made) == ["gamma"]


def test_changes_of_brightness_are_noted(tmp_path: Path) -> None:
    made = captured(tmp_path)
    change([made.folder / made.names[1, 3]], lambda values: 16 + 1.1 * (values - 16))
    report = check_capture(made.folder)
    assert report.usable
    (note,) = [one for one in report.findings if one.mistake == "exposure"]
    assert "1 of 25 images" in note.message
    assert "s+1_t003" in note.message


def test_bit_depth_that_values_contradict(tmp_path: Path) -> None:
    made = captured(tmp_path, sets=())
    made.plain["camera"] |= {"bit_depth": 10}
    made.write()
    assert mistakes(made) == ["bit_depth"]
    made.plain["camera"] |= {"bit_depth": 14}
    made.write()
    assert "bit_depth" in mistakes(made)


def test_flat_fields_that_are_saturated_are_an_error(tmp_path: Path) -> None:
    made = captured(tmp_path)
    change(made.frames("flat"), lambda values: np.full_like(values, 4095))
    report = check_capture(made.folder)
    assert "flat" in report.mistakes("error")


def test_boards_that_are_not_complete_are_named(tmp_path: Path) -> None:
    made = captured(tmp_path)
    for pose in range(2):
        for s in range(-2, 3):
            if (pose, s) != (1, 2):
                store(made.folder / f"board/p{pose}_s{s:+d}.tif", np.full(SHAPE, 300, dtype=np.uint16))
    made.plain["files"]["board"] = "board/p{pose}_s{s:+d}.tif"
    made.plain["board"] = {"kind": "dots", "dots": [9, 7], "spacing_mm": 5, "diameter_mm": 2}
    made.write()
    report: CaptureReport = check_capture(made.folder)
    assert report.mistakes("error", "warning") == ["board"]
    assert "pose 1, s 2" in str(report.findings[0])


def test_invalid_capture_file_is_an_error_of_its_own(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="scenetruth capture init"):
        check_capture(tmp_path)
