"""Image files: digital numbers as stored, headers, mosaics, and moments of frames."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

import scenetruth
from scenetruth.capture import ImageHeader, PixelFormat, average_frames, frame_moments, read_header, read_pixels
from scenetruth.capture.image_reading import header_problems
from scenetruth.errors import CaptureError
from scenetruth.scene.picture_file import PictureFileError

DRAW = np.random.default_rng(3)
GREY8 = DRAW.integers(0, 256, (31, 40)).astype(np.uint8)
GREY16 = DRAW.integers(0, 65536, (31, 40)).astype(np.uint16)
RGB8 = DRAW.integers(0, 256, (31, 40, 3)).astype(np.uint8)
RGB16 = DRAW.integers(0, 65536, (31, 40, 3)).astype(np.uint16)


def write_png16(file: Path, values: np.ndarray[Any, Any]) -> None:
    cv2 = pytest.importorskip("cv2")
    assert cv2.imwrite(str(file), values[..., ::-1])


@pytest.mark.parametrize(
    ("name", "values", "write"),
    [
        ("a.png", GREY8, imageio.imwrite),
        ("a.png", GREY16, imageio.imwrite),
        ("a.tif", GREY8, tifffile.imwrite),
        ("a.tif", GREY16, tifffile.imwrite),
        ("a.png", RGB8, imageio.imwrite),
        ("a.png", RGB16, write_png16),
        ("a.tif", RGB8, tifffile.imwrite),
        ("a.tif", RGB16, tifffile.imwrite),
        ("a.bmp", GREY8, imageio.imwrite),
    ],
)
def test_digital_numbers_are_those_that_were_written(tmp_path: Path, name: str, values: Any, write: Any) -> None:
    write(tmp_path / name, values)
    read = read_pixels(tmp_path / name)
    assert read.dtype == values.dtype
    assert np.array_equal(read, values)
    header = read_header(tmp_path / name)
    assert (header.height, header.width) == values.shape[:2]
    assert (header.bits, header.channels) == (8 * values.dtype.itemsize, 3 if values.ndim == 3 else 1)
    assert header_problems("a", header, PixelFormat(8), (40, 31)) == []


def exif(orientation: int) -> Image.Exif:
    made = Image.Exif()
    made[274] = orientation
    inner = made.get_ifd(0x8769)
    inner[33434], inner[36867], inner[37521] = 0.02, "2024:01:02 03:04:05", "25"
    return made


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_orientation_is_reported_and_not_obeyed(tmp_path: Path, suffix: str, orientation: int) -> None:
    Image.fromarray(GREY8).save(tmp_path / f"a.{suffix}", exif=exif(orientation))
    header = read_header(tmp_path / f"a.{suffix}")
    assert header.orientation == orientation
    assert np.array_equal(read_pixels(tmp_path / f"a.{suffix}"), GREY8)
    problems = header_problems("a", header, PixelFormat(8), (40, 31))
    assert [("Exif orientation" in one.message) for one in problems] == [True] * (orientation != 1)


def test_exposure_and_time_are_read(tmp_path: Path) -> None:
    Image.fromarray(GREY8).save(tmp_path / "a.jpg", exif=exif(1))
    header = read_header(tmp_path / "a.jpg")
    assert header.exposure_time_s == 0.02
    assert header.taken_s is not None
    assert header.taken_s % 60 == 5.25
    assert header.resolution_s == 0.01
    assert header.lossy
    assert header.encoding == "srgb"
    tags = [(33434, 5, 1, (1, 50), False), (36867, "s", 0, "2024:01:02 03:04:06", False)]
    tifffile.imwrite(tmp_path / "a.tif", GREY16, extratags=tags)
    other = read_header(tmp_path / "a.tif")
    assert other.exposure_time_s == 0.02
    assert other.taken_s is not None
    assert other.taken_s - header.taken_s == 0.75
    assert other.resolution_s == 1.0


def test_stated_encodings_are_read(tmp_path: Path) -> None:
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    info.add(b"gAMA", (45455).to_bytes(4, "big"))
    Image.fromarray(GREY8).save(tmp_path / "a.png", pnginfo=info)
    assert read_header(tmp_path / "a.png").encoding == "srgb"
    # The values are those of the file nevertheless.
    assert np.array_equal(read_pixels(tmp_path / "a.png"), GREY8)


def test_unreadable_files_say_why(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\nnothing of it follows here and so on")
    (tmp_path / "b.tif").write_bytes(b"II*\0" + bytes(20))
    (tmp_path / "c.png").write_text("text")
    tifffile.imwrite(tmp_path / "d.tif", GREY8.astype(np.float32))
    tifffile.imwrite(tmp_path / "e.tif", np.stack([GREY8, GREY8]))
    for name in ("a.png", "b.tif", "c.png", "none.png"):
        with pytest.raises(ValueError, match=r"cannot be read|must be a single image"):
            read_header(tmp_path / name)
    for name in ("a.png", "c.png", "none.png", "d.tif"):
        with pytest.raises(ValueError, match=r"cannot be read|radiances|floating-point"):
            read_pixels(tmp_path / name)
    with pytest.raises(ValueError, match="2 pages"):
        read_header(tmp_path / "e.tif")


@given(st.sampled_from(["rggb", "grbg", "gbrg", "bggr"]), st.integers(3, 9), st.integers(3, 9))
def test_planes_of_a_mosaic_are_the_pixels_of_their_colour(order: str, height: int, width: int) -> None:
    y, x = np.indices((height, width))
    colours = np.array(list(order))[2 * (y % 2) + x % 2]
    for plane, letter in (("red", "r"), ("green", "g"), ("blue", "b")):
        chosen = PixelFormat(bayer=order, plane=plane)  # type: ignore[arg-type]
        assert (chosen.select(colours) == letter).all()
        assert chosen.select(colours).shape == chosen.shape(height, width)
        # A point that lies at pixel (x, y) of the plane lies at the same place of the camera.
        columns, rows = chosen.select(x), chosen.select(y)
        point = chosen.principal_point((float(columns[-1, -1]), float(rows[-1, -1])))
        assert point == (columns.shape[1] - 1, rows.shape[0] - 1)
    assert PixelFormat(bayer=order).select(colours).shape == (height, width)


def test_encoded_values_become_proportional_to_light() -> None:
    light = np.linspace(0, 1, 300).reshape(15, 20)
    for encoding, encoded in (
        ("gamma", light ** (1 / 2.2)),
        ("srgb", np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)),
    ):
        pixels = PixelFormat(16, encoding)  # type: ignore[arg-type]
        found = pixels.convert(np.rint(65535 * encoded).astype(np.uint16))
        assert pixels.full_scale == 1.0
        assert found.max() == 1.0
        # Rounding of the encoded values, times the slope of the curve, at most 2.4 at light of 1.
        assert np.abs(found - light).max() < 2.4 * 0.5 / 65535 + 1e-7


@settings(max_examples=30)
@given(st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_moments_are_those_of_the_stack(count: int, seed: int) -> None:
    stack = np.random.default_rng(seed).integers(0, 4096, (count, 5, 6)).astype(np.uint16)
    found = frame_moments(iter(stack))
    assert np.allclose(found.mean, stack.mean(axis=0), rtol=1e-12)
    assert np.array_equal(found.lowest, stack.min(axis=0))
    assert np.array_equal(found.highest, stack.max(axis=0))
    assert np.allclose(found.frame_means, stack.mean(axis=(1, 2)), rtol=1e-12)
    if count == 1:
        assert np.isnan(found.variance).all()
    else:
        assert np.allclose(found.variance, stack.var(axis=0, ddof=1), rtol=1e-10, atol=1e-9)


def test_moments_keep_their_precision_at_a_large_offset() -> None:
    # A sum of squares in float64 would be off by 4e-7: 16 steps of rounding are 16 units of 7e-12.
    stack = 60_000 + np.random.default_rng(1).integers(0, 2, (16, 20, 20))
    assert np.allclose(frame_moments(stack).variance, stack.var(axis=0, ddof=1), rtol=0, atol=2e-10)


def test_average_of_files_is_their_mean_and_problems_come_together(tmp_path: Path) -> None:
    for number in range(3):
        tifffile.imwrite(tmp_path / f"dark_{number}.tif", GREY16 // (number + 1))
    expected = np.mean([GREY16 // (number + 1) for number in range(3)], axis=0)
    assert np.allclose(average_frames(tmp_path / "dark_*.tif"), expected, rtol=1e-6)
    assert np.array_equal(scenetruth.average_frames([tmp_path / "dark_0.tif"]), GREY16.astype(np.float32))
    tifffile.imwrite(tmp_path / "dark_3.tif", GREY16.T)
    (tmp_path / "dark_4.tif").write_text("no image")
    with pytest.raises(CaptureError) as caught:
        average_frames(tmp_path / "dark_*.tif")
    assert [Path(one.path).name for one in caught.value.problems] == ["dark_3.tif", "dark_4.tif"]
    assert "exchanged" in str(caught.value)
    with pytest.raises(CaptureError, match="matches no file"):
        average_frames(tmp_path / "flat_*.tif")
    with pytest.raises(CaptureError, match=re.escape("its folder does not exist")):
        average_frames(tmp_path / "nothing" / "*.tif")


def written_files() -> dict[str, bytes]:
    """Return small valid files by suffix."""
    import io

    found = {}
    for suffix, form in (("png", "PNG"), ("jpg", "JPEG"), ("bmp", "BMP"), ("tif", "TIFF")):
        stream = io.BytesIO()
        Image.fromarray(GREY8).save(stream, format=form, exif=exif(1))
        found[suffix] = stream.getvalue()
    stream = io.BytesIO()
    tifffile.imwrite(stream, RGB16)
    found["tiff"] = stream.getvalue()
    return found


WRITTEN = written_files()


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    st.sampled_from(sorted(WRITTEN)),
    st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=6),
    st.integers(0, 4000) | st.none(),
)
def test_damaged_files_are_refused_or_read_and_nothing_else(
    tmp_path: Path, suffix: str, changes: list[tuple[int, int]], length: int | None
) -> None:
    content = bytearray(WRITTEN[suffix])
    for place, value in changes:
        content[place % len(content)] = value
    file = tmp_path / f"a.{suffix}"
    file.write_bytes(bytes(content[:length]))
    for read in (read_header, read_pixels):
        with contextlib.suppress(PictureFileError):
            found = read(file)
            assert isinstance(found, ImageHeader | np.ndarray)
            assert isinstance(found, ImageHeader) or found.dtype in (np.uint8, np.uint16)
