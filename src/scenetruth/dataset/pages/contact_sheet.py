"""Many small pictures on one sheet, each with its number, and a line that says what they are."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont

__all__ = ["ON_A_SHEET", "THUMBNAIL_PX", "draw_contact_sheet", "shown_grey"]

ON_A_SHEET = 48
"""Pictures of a full sheet."""
THUMBNAIL_PX = 160
"""Most pixels along a side of each."""
_COLUMNS = 8
_GAP, _CAPTION, _FOOT = 4, 15, 24
_GAMMA = 1 / 2.0
_BRIGHT, _ABOVE = 99.8, 1.15
"""White is a little brighter than so many per cent of all pixels of a sheet."""


def shown_grey(images: Sequence[NDArray[Any]]) -> list[NDArray[np.uint8]]:
    """Return linear images as grey values of a screen, all on one scale, so that dark ones look dark.

    Parameters
    ----------
    images
        Linear radiances of all pictures of a sheet.
    """
    if not images:
        return []
    values = np.concatenate([np.asarray(image, dtype=np.float64).ravel() for image in images])
    white = _ABOVE * float(np.percentile(values, _BRIGHT)) or 1.0
    return [np.round(255 * np.clip(np.asarray(image) / white, 0, 1) ** _GAMMA).astype(np.uint8) for image in images]


def draw_contact_sheet(images: Sequence[tuple[str, NDArray[np.uint8]]], foot: str, path: Path) -> None:
    """Draw small pictures in rows of eight.

    Parameters
    ----------
    images
        Captions, and grey values of shape (height, width); at least one.
    foot
        What they are, in one line below them.
    path
        The PNG file; the same bytes for the same pictures.
    """
    from PIL import Image, ImageDraw
    from PIL.PngImagePlugin import PngInfo

    height = max(image.shape[0] for _, image in images)
    width = max(image.shape[1] for _, image in images)
    columns = min(_COLUMNS, len(images))
    rows = -(-len(images) // columns)
    small, font = _font(10), _font(11)
    size = (
        max(columns * (width + _GAP) + _GAP, round(font.getlength(foot)) + 3 * _GAP),
        rows * (height + _CAPTION + _GAP) + _GAP + _FOOT,
    )
    sheet = Image.new("L", size, 255)
    pen = ImageDraw.Draw(sheet)
    for number, (caption, image) in enumerate(images):
        row, column = divmod(number, columns)
        x, y = _GAP + column * (width + _GAP), _GAP + row * (height + _CAPTION + _GAP)
        sheet.paste(Image.fromarray(image), (x, y))
        pen.text((x, y + height), caption, fill=90, font=small)
    pen.text((_GAP, size[1] - _FOOT + 4), foot, fill=60, font=font)
    information = PngInfo()
    information.add_text("Software", "scenetruth")
    sheet.save(path, format="PNG", pnginfo=information)


@cache
def _font(size: int) -> FreeTypeFont:
    from matplotlib import get_data_path
    from PIL import ImageFont

    return ImageFont.truetype(Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", size)
