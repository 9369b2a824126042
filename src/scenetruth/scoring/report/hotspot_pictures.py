"""Pictures of the places with the largest errors: the image with local contrast, and the errors, with a marker."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["HotspotPicture", "draw_hotspot", "draw_hotspot_map", "encode_png", "show_errors", "stretch_grey"]

Pixels = NDArray[np.float64]

_HALF = 32
"""Half of the side of the section, in pixels of the map."""
_ENLARGED, _DOUBLED = 3, 2
_GAP = 6
_MARKER = np.array([1.0, 0.82, 0.25])
_INVALID = np.array([0.66, 0.69, 0.72]), np.array([0.54, 0.57, 0.61])


@dataclass(frozen=True)
class HotspotPicture:
    """A picture as a data URL with its width in px; ``limit``: the error of the strongest colour."""

    address: str
    width: int
    limit: float


def draw_hotspot(
    image: Pixels, errors: Pixels, row: int, column: int, square: tuple[int, int, int] | None = None
) -> HotspotPicture:
    """Return the section around a pixel: the image (dark to light: 2nd to 98th percentile) and the errors.

    Parameters
    ----------
    image, errors
        Grey values and errors of the same pixels; invalid errors are not finite.
    row, column
        The pixel in the middle.
    square
        First row, first column and side of the marked square; default: a square around the pixel.
    """
    rows, columns = (
        slice(max(0, at - _HALF), min(size, at + _HALF + 1))
        for at, size in zip((row, column), errors.shape, strict=True)
    )
    grey, part = stretch_grey(image[rows, columns]), errors[rows, columns]
    finite = np.abs(part[np.isfinite(part)])
    limit = float(np.percentile(finite, 98)) if finite.size else 0.0
    limit = limit or float(finite.max(initial=0.0)) or 1.0
    both = [_enlarge(grey), _enlarge(show_errors(part, limit))]
    for one in both:
        if square is None:
            _mark(one, row - rows.start, column - columns.start)
        else:
            top, left, side = square
            _outline(one, _ENLARGED * (top - rows.start), _ENLARGED * (left - columns.start), _ENLARGED * side)
    gap = np.ones((both[0].shape[0], _GAP, 3))
    whole = np.concatenate([both[0], gap, both[1]], axis=1)
    return HotspotPicture(f"data:image/png;base64,{encode_png(whole)}", whole.shape[1], limit)


def draw_hotspot_map(image: Pixels, errors: Pixels, limit: float) -> str:
    """Return a PNG in base64: the whole image and its errors, with a mark at the largest; no mark without errors."""
    both = [stretch_grey(image), show_errors(errors, limit)]
    both = [np.repeat(np.repeat(one, _DOUBLED, axis=0), _DOUBLED, axis=1) for one in both]
    if np.isfinite(errors).any():
        row, column = np.unravel_index(int(np.nanargmax(np.abs(errors))), errors.shape)
        for one in both:
            _mark(one, int(row), int(column), _DOUBLED)
    gap = np.ones((both[0].shape[0], 2 * _GAP, 3))
    return encode_png(np.concatenate([both[0], gap, both[1]], axis=1))


def stretch_grey(image: Pixels) -> Pixels:
    """Return grey values from 0 to 1 as RGB, from the 2nd to the 98th percentile of the section."""
    known = image[np.isfinite(image)]
    low, high = np.percentile(known, [2, 98]) if known.size else (0.0, 1.0)
    grey = np.clip((np.nan_to_num(image, nan=float(low)) - low) / max(float(high - low), 1e-12), 0, 1)
    return np.repeat(grey[..., None], 3, axis=-1)


def show_errors(errors: Pixels, limit: float) -> Pixels:
    """Return errors as RGB: blue is negative, red is positive, a grey hatching is invalid."""
    from matplotlib import colormaps

    colours = np.array(colormaps["RdBu_r"](np.clip(np.nan_to_num(errors) / (2 * limit) + 0.5, 0, 1))[..., :3])
    y, x = np.indices(errors.shape)
    stripes = np.where(((x + y) // 3 % 2 == 0)[..., None], *_INVALID)
    return np.where(np.isfinite(errors)[..., None], colours, stripes)


def _enlarge(colours: Pixels) -> Pixels:
    return np.repeat(np.repeat(colours, _ENLARGED, axis=0), _ENLARGED, axis=1)


def _mark(picture: Pixels, row: int, column: int, enlarged: int = _ENLARGED) -> None:
    """Draw the outline of a square around a pixel, dark within light."""
    y, x = (np.arange(size) for size in picture.shape[:2])
    centre = ((one + 0.5) * enlarged for one in (row, column))
    far = np.maximum.outer(*(np.abs(place + 0.5 - at) for place, at in zip((y, x), centre, strict=True)))
    half = 4.5 * enlarged
    picture[(far > half - 1) & (far <= half + 2)] = 0.0
    picture[(far > half) & (far <= half + 1)] = _MARKER


def _outline(picture: Pixels, top: int, left: int, side: int) -> None:
    """Draw the outline of a square, dark within light, inside its border."""
    y, x = (np.arange(size) for size in picture.shape[:2])
    depths = (np.minimum(at - start, start + side - 1 - at) for at, start in ((y, top), (x, left)))
    depth = np.minimum.outer(*depths)
    picture[(depth >= 0) & (depth < 3)] = 0.0
    picture[depth == 1] = _MARKER


def encode_png(colours: Pixels) -> str:
    """Return RGB from 0 to 1 as a PNG in base64."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(np.rint(255 * colours).astype(np.uint8)).save(stream, "PNG", optimize=True)
    return base64.b64encode(stream.getvalue()).decode("ascii")
