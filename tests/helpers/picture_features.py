"""Features of pictures on surfaces: what their numbers mean, by hand."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image, ImageCms

from tests.helpers.file_features import FileFeature
from tests.helpers.gltf_features import GREYS, RAMP, chunk
from tests.helpers.polygon_features import SQUARE, UV, UV_QUAD, png

__all__ = ["PICTURE_FEATURES"]


def tiff(values: Any, **options: Any) -> bytes:
    """Return a TIFF file."""
    out = io.BytesIO()
    tifffile.imwrite(out, values, **options)
    return out.getvalue()


def on_square(name: str, content: bytes, suffix: str = "png", **more: Any) -> FileFeature:
    """Return a feature of a picture on a unit square of an OBJ file."""
    text = f"mtllib m.mtl\n{SQUARE}{UV}usemtl m\n{UV_QUAD}"
    files: dict[str, str | bytes] = {"a.obj": text, "m.mtl": f"newmtl m\nmap_Kd p.{suffix}\n", f"p.{suffix}": content}
    found = {"area": 1.0, **more}
    if "rejected" not in more:
        found.setdefault("shades", (((0.25, 0.75), 0.2), ((0.25, 0.25), 0.6), ((0.75, 0.75), 0.4)))
    return FileFeature("picture", name, files, **found)


GREY: NDArray[np.uint8] = np.array(GREYS, dtype=np.uint8)
RGB = np.dstack([GREY] * 3)
SIXTEEN = GREY.astype(np.uint16) * 257
ICC = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


def saved(image: Image.Image, form: str = "PNG", **options: Any) -> bytes:
    """Return the file of an image."""
    out = io.BytesIO()
    image.save(out, form, **options)
    return out.getvalue()


PALETTE = Image.fromarray(np.array([[0, 1], [2, 3]], dtype=np.uint8), "P")
PALETTE.putpalette([value for grey in (51, 102, 153, 204) for value in (grey, grey, grey)])

UNSET: dict[str, Any] = {"rejected": "set encoding", "of_colours": True}

PICTURE_FEATURES = (
    on_square("8-bit grey", png(GREY)),
    on_square("8-bit colour", png(RGB)),
    on_square("palette", saved(PALETTE)),
    on_square("16-bit grey PNG", saved(Image.fromarray(SIXTEEN))),
    on_square("16-bit grey TIFF", tiff(SIXTEEN), "tif"),
    on_square("16-bit colour TIFF", tiff(np.dstack([SIXTEEN] * 3), photometric="rgb"), "tif"),
    on_square("float TIFF", tiff((GREY / 255).astype(np.float32)), "tif"),
    on_square("float TIFF beyond 1", tiff(GREY.astype(np.float32)), "tif", rejected="divide them"),
    on_square("TIFF in which white is zero", tiff(255 - GREY, photometric="miniswhite"), "tif"),
    on_square(
        "TIFF of separate planes", tiff(np.moveaxis(RGB, 2, 0), photometric="rgb", planarconfig="separate"), "tif"
    ),
    on_square("TIFF of one row", tiff(GREY[:1]), "tif", shades=(((0.25, 0.5), 0.2), ((0.75, 0.5), 0.4))),
    on_square(
        "TIFF of four bands",
        tiff(np.dstack([RGB, GREY]), photometric="minisblack", planarconfig="contig"),
        "tif",
        rejected="4 samples",
    ),
    on_square(
        "TIFF with an unspecified channel",
        tiff(np.dstack([RGB, GREY]), photometric="rgb", extrasamples=["unspecified"]),
        "tif",
        rejected="unspecified",
    ),
    on_square(
        "TIFF with premultiplied opacity",
        tiff(np.dstack([RGB, GREY]), photometric="rgb", extrasamples=["assocalpha"]),
        "tif",
        rejected="premultiplied",
    ),
    on_square(
        "TIFF of several pages", tiff(np.stack([GREY, GREY]), photometric="minisblack"), "tif", rejected="2 pages"
    ),
    on_square("32-bit integers", tiff(GREY.astype(np.uint32)), "tif", rejected="32 bits"),
    on_square("signed integers", tiff(GREY.astype(np.int16)), "tif", rejected="signed"),
    on_square("CMYK", saved(Image.fromarray(RGB).convert("CMYK"), "JPEG"), "jpg", rejected="CMYK"),
    on_square(
        "Exif orientation 6",
        saved(
            Image.fromarray(np.ascontiguousarray(np.rot90(GREY))),
            exif=b"Exif\x00\x00II*\x00\x08\x00"
            b"\x00\x00\x01\x00\x12\x01\x03\x00\x01\x00\x00\x00\x06\x00\x00\x00\x00\x00\x00\x00",
        ),
    ),
    on_square("sRGB chunk, encoding not set", png(GREY, pnginfo=chunk(b"sRGB", b"\0")), **UNSET),
    on_square("sRGB profile, encoding not set", png(RGB, icc_profile=ICC), **UNSET),
    on_square("cICP of sRGB, encoding not set", png(GREY, pnginfo=chunk(b"cICP", bytes([1, 13, 0, 1]))), **UNSET),
    on_square("cICP of PQ", png(GREY, pnginfo=chunk(b"cICP", bytes([9, 16, 0, 1]))), rejected="transfer function 16"),
    on_square("gAMA of 1", png(GREY, pnginfo=chunk(b"gAMA", (100000).to_bytes(4, "big")))),
    on_square("gAMA of 1/2", png(GREY, pnginfo=chunk(b"gAMA", (50000).to_bytes(4, "big"))), rejected="gamma of 0.5"),
    on_square("opacity cuts the surface out", RAMP, area=0.5, shades=(((0.25, 0.4), 1.0),)),
    on_square(
        "animation",
        saved(Image.fromarray(GREY), "GIF", save_all=True, append_images=[Image.fromarray(255 - GREY)]),
        "gif",
        rejected="2 pages",
    ),
    on_square("cut off", png(GREY)[:45], rejected="cannot be read"),
    on_square(
        "Radiance HDR",
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n\x80\x80\x80\x80",
        "hdr",
        rejected="not recognised",
    ),
)
