"""Pages as SVG, in mm at true scale."""

from __future__ import annotations

import base64
import io
from xml.sax.saxutils import escape

import numpy as np

from scenetruth.design.pattern.base import Areas, Array, Dots, Grey, Marks
from scenetruth.design.pattern.make import Pattern
from scenetruth.design.pattern.printing.layout import Line, Page, Text

__all__ = ["svg_of"]

# Digits behind the point; outlines, which have many points, are told in whole µm.
_DIGITS, _OUTLINE_DIGITS = 4, 3


def svg_of(pattern: Pattern, page: Page) -> str:
    """Return a page as an SVG document whose user unit is a mm.

    Parameters
    ----------
    pattern
        The pattern.
    page
        One of its pages.
    """
    width, height = (_number(side) for side in page.size_mm)
    left, top = page.place_mm[:2]
    shift = f"translate({_number(left - page.tile_mm[0])} {_number(top - page.tile_mm[1])})"
    box = " ".join(
        f'{name}="{_number(v)}"' for name, v in zip(("x", "y", "width", "height"), page.tile_mm, strict=True)
    )
    parts = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" width="{width}mm" '
        f'height="{height}mm" viewBox="0 0 {width} {height}">',
        f"<title>{escape(page.texts[-1].content)}</title>",
        f"<desc>{escape('scenetruth ' + pattern.model.kind + ' pattern, ' + pattern.told)}</desc>",
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
        f'<clipPath id="tile"><rect {box}/></clipPath>',
        f'<g id="pattern" transform="{shift}"><g clip-path="url(#tile)">',
        *_marks(pattern.marks(page.tile_mm)),
        "</g></g>",
        '<g id="rulers" stroke="#000" fill="none">',
        *map(_line, page.lines),
        "</g>",
        '<g id="texts" font-family="DejaVu Sans, Arial, Helvetica, sans-serif" fill="#000">',
        *map(_text, page.texts),
        "</g>",
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _number(value: float) -> str:
    text = f"{value:.{_DIGITS}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def _marks(marks: Marks) -> list[str]:
    if isinstance(marks, Dots):
        radius = _number(marks.diameter_mm / 2)
        return [f'<circle cx="{_number(x)}" cy="{_number(y)}" r="{radius}"/>' for x, y in marks.centres_mm.tolist()]
    if isinstance(marks, Areas):
        return [f'<path d="{"".join(map(_outline, marks.outlines_mm))}"/>']
    return [_picture(marks)]


def _outline(points: Array) -> str:
    # Steps in whole units of the last digit: their sum does not drift.
    whole = np.round(points * 10**_OUTLINE_DIGITS).astype(np.int64)
    steps = np.diff(whole, axis=0)
    parts = (whole[:1] / 10**_OUTLINE_DIGITS, steps[steps.any(axis=1)] / 10**_OUTLINE_DIGITS)
    start, way = (" ".join(f"{x:g} {y:g}" for x, y in part.tolist()) for part in parts)
    return f"M{start}l{way}z" if way else ""


def _picture(marks: Grey) -> str:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(marks.values).save(stream, format="PNG")
    x, y, width, height = (_number(value) for value in marks.box_mm)
    data = base64.b64encode(stream.getvalue()).decode()
    place = f'x="{x}" y="{y}" width="{width}" height="{height}" preserveAspectRatio="none"'
    return f'<image {place} xlink:href="data:image/png;base64,{data}"/>'


def _line(line: Line) -> str:
    ends = " ".join(f'{name}="{_number(getattr(line, name))}"' for name in ("x0", "y0", "x1", "y1"))
    ends = ends.replace("x1=", "x2=").replace("y1=", "y2=").replace("x0=", "x1=").replace("y0=", "y1=")
    return f'<line {ends} stroke-width="{_number(line.width)}"/>'


def _text(text: Text) -> str:
    x, y = _number(text.x), _number(text.y)
    turned = f' transform="rotate(-90 {x} {y})"' if text.upright else ""
    return (
        f'<text x="{x}" y="{y}" font-size="{_number(text.size)}" text-anchor="{text.anchor}"{turned}>'
        f"{escape(text.content)}</text>"
    )
