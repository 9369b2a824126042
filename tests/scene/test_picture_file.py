"""Pictures: what their numbers mean, by the files of their own formats."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image, ImageCms, PngImagePlugin

from scenetruth.scene.picture_file import DecodedPicture, PictureFileError, decode_picture

GREY = np.array([[0, 51, 102], [153, 204, 255]], dtype=np.uint8)
COLOUR = np.dstack([GREY, GREY[:, ::-1], GREY[::-1]])
LUMINANCE = COLOUR / 255 @ [0.2126, 0.7152, 0.0722]


def saved(image: Image.Image, form: str = "PNG", **options: Any) -> bytes:
    out = io.BytesIO()
    image.save(out, form, **options)
    return out.getvalue()


def tiff(values: NDArray[Any], **options: Any) -> bytes:
    out = io.BytesIO()
    tifffile.imwrite(out, values, **options)
    return out.getvalue()


def radiances(content: bytes, encoding: str | None = None) -> NDArray[np.float32]:
    return decode_picture(content).radiances(encoding)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (saved(Image.fromarray(GREY)), GREY / 255),
        (saved(Image.fromarray(GREY), "BMP"), GREY / 255),
        (saved(Image.fromarray(COLOUR)), LUMINANCE),
        (saved(Image.fromarray(np.dstack([COLOUR, GREY]))), LUMINANCE),
        (saved(Image.fromarray(GREY.astype(np.uint16) * 257)), GREY / 255),
        (saved(Image.fromarray(GREY > 100)), GREY > 100),
        (saved(Image.fromarray(GREY).convert("P")), GREY / 255),
        (tiff(GREY), GREY / 255),
        (tiff(GREY.astype(np.uint16) * 257), GREY / 255),
        (tiff(COLOUR.astype(np.uint16) * 257, photometric="rgb"), LUMINANCE),
        (tiff(np.moveaxis(COLOUR, 2, 0), photometric="rgb", planarconfig="separate"), LUMINANCE),
        (tiff((GREY / 255).astype(np.float32)), GREY / 255),
        (tiff(255 - GREY, photometric="miniswhite"), GREY / 255),
        (tiff(65535 - GREY.astype(np.uint16) * 257, photometric="miniswhite"), GREY / 255),
    ],
    ids=["8 bit", "BMP", "colour", "opacity", "16 bit", "1 bit", "palette", "TIFF", "TIFF 16 bit", "TIFF colour 16 bit",
         "TIFF planes", "TIFF float", "white is zero", "white is zero, 16 bit"],
)  # fmt: skip
def test_grey_values_and_colours(content: bytes, expected: NDArray[Any]) -> None:
    np.testing.assert_allclose(radiances(content), expected, atol=1e-6)


def test_palettes_of_colours() -> None:
    index = Image.fromarray(np.array([[0, 1], [2, 3]], dtype=np.uint8), "P")
    index.putpalette([255, 0, 0, 0, 255, 0, 0, 0, 255, 10, 20, 30])
    expected = np.array([[0.2126, 0.7152], [0.0722, np.dot([10, 20, 30], [0.2126, 0.7152, 0.0722]) / 255]])
    np.testing.assert_allclose(radiances(saved(index)), expected, atol=1e-6)
    np.testing.assert_allclose(radiances(saved(index, "TIFF")), expected, atol=1e-6)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (saved(Image.fromarray(COLOUR).convert("CMYK"), "JPEG"), "is CMYK; convert it"),
        (saved(Image.fromarray(COLOUR).convert("CMYK"), "TIFF"), "is CMYK; convert it"),
        (tiff((GREY / 100).astype(np.float32)), "has radiances from 0 to 2.55"),
        (tiff((GREY / 255 - 0.1).astype(np.float32)), "has radiances from -0.1"),
        (tiff(np.full((2, 2), np.nan, np.float32)), "not finite"),
        (tiff(GREY.astype(np.uint32)), "32 bits, of unspecified full scale"),
        (tiff(GREY.astype(np.int16)), "signed integers (int16)"),
        (tiff(GREY.astype(np.complex64)), "real numbers"),
        (tiff(np.stack([GREY, GREY]), photometric="minisblack"), "single grey or colour"),
        (tiff(np.dstack([COLOUR, GREY]), photometric="rgb", extrasamples=["assocalpha"]), "premultiplied alpha"),
        (b"not a picture", "cannot be read as an image"),
    ],
)
def test_numbers_without_a_known_meaning_are_refused(content: bytes, reason: str) -> None:
    with pytest.raises(PictureFileError) as caught:
        radiances(content)
    assert reason in str(caught.value)


def png_16_bits(colour_type: int, *values: int, **chunks: bytes) -> bytes:
    """Return a PNG of 1 x 1 pixel, which Pillow does not write."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", 1, 1, 16, colour_type, 0, 0, 0)
    line = b"\0" + struct.pack(f">{len(values)}H", *values)
    parts = [(b"IHDR", head), *((name.encode(), data) for name, data in chunks.items()), (b"IDAT", zlib.compress(line))]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in (*parts, (b"IEND", b"")))


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (png_16_bits(2, 1000, 2000, 3000), "16 bits per channel in colour"),
        (png_16_bits(6, 1000, 2000, 3000, 4000), "16 bits per channel in colour"),
        (png_16_bits(4, 1000, 2000), "16 bits per channel in grey with opacity"),
        (png_16_bits(0, 1000, tRNS=struct.pack(">H", 1000)), "transparent value among 16-bit"),
    ],
)
def test_16_bit_values_are_not_cut_to_8_bits(content: bytes, reason: str) -> None:
    assert radiances(png_16_bits(0, 1000))[0, 0] == pytest.approx(1000 / 65535)
    with pytest.raises(PictureFileError, match=reason):
        radiances(content)


@pytest.mark.parametrize("shape", [(1, 5), (5, 1), (1, 1)])
@pytest.mark.parametrize("colour", [False, True])
def test_tiff_files_of_one_row_or_column(shape: tuple[int, int], colour: bool) -> None:
    values = np.random.default_rng(3).integers(0, 256, (*shape, 3), dtype=np.uint8)
    content = tiff(values, photometric="rgb") if colour else tiff(values[..., 0])
    expected = values / 255 @ [0.2126, 0.7152, 0.0722] if colour else values[..., 0] / 255
    np.testing.assert_allclose(radiances(content), expected, atol=1e-6)


@pytest.mark.parametrize(
    ("samples", "options", "reason"),
    [
        (3, {"photometric": "minisblack"}, "grey with 3 samples"),
        (4, {"photometric": "minisblack"}, "grey with 4 samples"),
        (4, {"photometric": "rgb", "extrasamples": ["unspecified"]}, "unspecified (ExtraSamples 0)"),
        (5, {"photometric": "rgb", "extrasamples": ["unassalpha", "unspecified"]}, "colour with 5 samples"),
    ],
)
def test_further_channels_of_a_tiff_file_are_no_opacity(samples: int, options: dict[str, Any], reason: str) -> None:
    """As infrared or masks, which would cut a surface out."""
    values = np.random.default_rng(4).integers(1, 255, (4, 6, samples), dtype=np.uint8)
    with pytest.raises(PictureFileError) as caught:
        radiances(tiff(values, planarconfig="contig", **options))
    assert reason in str(caught.value)


def test_an_unspecified_channel_of_full_values_is_opaque() -> None:
    values = np.dstack([COLOUR, np.full_like(GREY, 255)])
    content = tiff(values, photometric="rgb", extrasamples=["unspecified"])
    np.testing.assert_allclose(radiances(content), LUMINANCE, atol=1e-6)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("form", ["PNG", "TIFF"])
def test_orientation_is_that_in_which_a_picture_is_seen(orientation: int, form: str) -> None:
    # Stored row 0 and column 0 are, in this order, as Exif defines them.
    stored = {
        1: GREY,
        2: GREY[:, ::-1],
        3: GREY[::-1, ::-1],
        4: GREY[::-1],
        5: GREY.T,
        6: np.rot90(GREY, 1),
        7: np.rot90(GREY, 2).T,
        8: np.rot90(GREY, -1),
    }[orientation]
    exif = Image.Exif()
    exif[274] = orientation
    options = {"exif": exif} if form == "PNG" else {"tiffinfo": {274: orientation}}
    content = saved(Image.fromarray(np.ascontiguousarray(stored)), form, **options)
    np.testing.assert_allclose(radiances(content), GREY / 255, atol=1e-6)
    # glTF ignores it.
    if form == "PNG":
        found = decode_picture(content, obey_metadata=False).radiances("linear")
        np.testing.assert_allclose(found, stored / 255, atol=1e-6)


def png_info(**chunks: bytes) -> PngImagePlugin.PngInfo:
    info = PngImagePlugin.PngInfo()
    for name, data in chunks.items():
        info.add(name.encode(), data)
    return info


def exif(colour_space: int) -> Image.Exif:
    found = Image.Exif()
    found[0x8769] = {0xA001: colour_space}
    return found


SRGB = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


@pytest.mark.parametrize(
    ("content", "stated"),
    [
        (saved(Image.fromarray(GREY), pnginfo=png_info(sRGB=b"\0")), "srgb"),
        (saved(Image.fromarray(GREY), pnginfo=png_info(gAMA=(45455).to_bytes(4, "big"))), "srgb"),
        (saved(Image.fromarray(GREY), pnginfo=png_info(gAMA=(100000).to_bytes(4, "big"))), "linear"),
        (saved(Image.fromarray(COLOUR), icc_profile=SRGB), "srgb"),
        (saved(Image.fromarray(COLOUR), "JPEG", icc_profile=SRGB), "srgb"),
        (saved(Image.fromarray(COLOUR), "TIFF", icc_profile=SRGB), "srgb"),
        (saved(Image.fromarray(GREY), pnginfo=png_info(cICP=bytes([1, 13, 0, 1]))), "srgb"),
        (saved(Image.fromarray(GREY), pnginfo=png_info(cICP=bytes([1, 8, 0, 1]))), "linear"),
        (saved(Image.fromarray(COLOUR), "JPEG", exif=exif(1)), "srgb"),
        (saved(Image.fromarray(COLOUR), "JPEG", exif=exif(65535)), None),
        (saved(Image.fromarray(GREY)), None),
    ],
)
def test_files_that_state_their_encoding(content: bytes, stated: str | None) -> None:
    picture = decode_picture(content)
    assert picture.encoding == stated
    if stated == "srgb":
        # Nothing is assumed about numbers that are not proportional to radiance.
        with pytest.raises(PictureFileError, match="set encoding"):
            picture.radiances(None)
        mid = float(DecodedPicture(np.array([[188]], np.uint8), 255, None, None, "").radiances("srgb")[0, 0])
        assert mid == pytest.approx(0.5029, abs=1e-4)
    else:
        np.testing.assert_array_equal(picture.radiances(None), picture.radiances("linear"))


def test_other_encodings_are_refused() -> None:
    with pytest.raises(PictureFileError, match=r"transfer function 16 \(cICP\)"):
        decode_picture(saved(Image.fromarray(GREY), pnginfo=png_info(cICP=bytes([9, 16, 0, 1]))))
    with pytest.raises(PictureFileError, match="Adobe RGB"):
        decode_picture(saved(Image.fromarray(COLOUR), "JPEG", exif=exif(2)))
    with pytest.raises(PictureFileError, match=r"gamma of 0\.5"):
        decode_picture(saved(Image.fromarray(GREY), pnginfo=png_info(gAMA=(50000).to_bytes(4, "big"))))
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
    with pytest.raises(PictureFileError, match="colour profile"):
        decode_picture(saved(Image.fromarray(COLOUR), icc_profile=profile))


def test_opacity_is_kept(tmp_path: Any) -> None:
    content = saved(Image.fromarray(np.dstack([COLOUR, GREY])))
    alpha = decode_picture(content).alpha
    assert alpha is not None
    np.testing.assert_allclose(alpha, GREY / 255, atol=1e-6)
    assert decode_picture(saved(Image.fromarray(np.dstack([COLOUR, np.full_like(GREY, 255)])))).alpha is None
    imageio.imwrite(tmp_path / "a.png", COLOUR)
    assert decode_picture((tmp_path / "a.png").read_bytes()).alpha is None
