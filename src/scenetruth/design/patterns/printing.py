"""Export of a pattern: SVG and PDF pages at true scale, an image texture, and lines for a scene file."""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from scenetruth.design.patterns.generation import Pattern
from scenetruth.design.patterns.page_layout import PageLine, PageText, PrintPage, lay_out_pages
from scenetruth.design.patterns.pattern_model import Array, GreyPicture, InkAreas, InkDots, Marks

__all__ = ["export_pattern", "format_scene_lines", "write_texture_image"]


_DIGITS, _OUTLINE_DIGITS = 4, 3  # decimal digits; outlines, which have many points, are written in whole µm


def render_svg(pattern: Pattern, page: PrintPage) -> str:
    """Return a page as an SVG document with mm as user units."""
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
        f"<desc>{escape('scenetruth ' + pattern.model.kind + ' pattern, ' + pattern.description)}</desc>",
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
    if isinstance(marks, InkDots):
        radius = _number(marks.diameter_mm / 2)
        return [f'<circle cx="{_number(x)}" cy="{_number(y)}" r="{radius}"/>' for x, y in marks.centres_mm.tolist()]
    if isinstance(marks, InkAreas):
        return [f'<path d="{"".join(map(_outline, marks.outlines_mm))}"/>']
    return [_picture(marks)]


def _outline(points: Array) -> str:
    # Steps in integer units of the last digit, so that rounding errors do not accumulate.
    whole = np.round(points * 10**_OUTLINE_DIGITS).astype(np.int64)
    steps = np.diff(whole, axis=0)
    parts = (whole[:1] / 10**_OUTLINE_DIGITS, steps[steps.any(axis=1)] / 10**_OUTLINE_DIGITS)
    start, way = (" ".join(f"{x:g} {y:g}" for x, y in part.tolist()) for part in parts)
    return f"M{start}l{way}z" if way else ""


def _picture(marks: GreyPicture) -> str:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(marks.values).save(stream, format="PNG")
    x, y, width, height = (_number(value) for value in marks.box_mm)
    data = base64.b64encode(stream.getvalue()).decode()
    place = f'x="{x}" y="{y}" width="{width}" height="{height}" preserveAspectRatio="none"'
    return f'<image {place} xlink:href="data:image/png;base64,{data}"/>'


def _line(line: PageLine) -> str:
    ends = " ".join(f'{name}="{_number(getattr(line, name))}"' for name in ("x0", "y0", "x1", "y1"))
    ends = ends.replace("x1=", "x2=").replace("y1=", "y2=").replace("x0=", "x1=").replace("y0=", "y1=")
    return f'<line {ends} stroke-width="{_number(line.width)}"/>'


def _text(text: PageText) -> str:
    x, y = _number(text.x), _number(text.y)
    turned = f' transform="rotate(-90 {x} {y})"' if text.upright else ""
    return (
        f'<text x="{x}" y="{y}" font-size="{_number(text.size)}" text-anchor="{text.anchor}"{turned}>'
        f"{escape(text.content)}</text>"
    )


_MM_PER_INCH = 25.4
_POINTS_PER_MM = 72 / _MM_PER_INCH


def write_pdf(file: Path, pattern: Pattern, pages: Sequence[PrintPage]) -> None:
    """Write pages to a PDF file, with reproducible bytes."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure

    values: dict[str, Any] = {
        "Title": f"scenetruth {pattern.model.kind} pattern",
        "Subject": pattern.description,
        "Creator": "scenetruth",
        "CreationDate": None,
    }
    # Keep all points of outlines, and text as text.
    settings = {"path.simplify": False, "pdf.fonttype": 42, "font.family": "DejaVu Sans", "pdf.compression": 6}
    with rc_context(settings), PdfPages(file, metadata=values) as pdf:
        for page in pages:
            figure = Figure(figsize=tuple(side / _MM_PER_INCH for side in page.size_mm))
            _draw(figure, pattern, page)
            pdf.savefig(figure)


def _draw(figure: Any, pattern: Pattern, page: PrintPage) -> None:
    from matplotlib.collections import LineCollection

    width, height = page.size_mm
    left, top, wide, high = page.place_mm
    # Axes are clipped at their borders, as is the tile.
    tile = figure.add_axes((left / width, 1 - (top + high) / height, wide / width, high / height))
    x, y = page.tile_mm[:2]
    tile.set(xlim=(x, x + wide), ylim=(y + high, y))
    tile.axis("off")
    _add(tile, pattern.marks(page.tile_mm))
    whole = figure.add_axes((0, 0, 1, 1))
    whole.set(xlim=(0, width), ylim=(height, 0))
    whole.axis("off")
    lines = [[(line.x0, line.y0), (line.x1, line.y1)] for line in page.lines]
    widths = [line.width * _POINTS_PER_MM for line in page.lines]
    whole.add_collection(LineCollection(lines, linewidths=widths, colors="black", capstyle="butt"), autolim=False)
    for text in page.texts:
        whole.text(
            text.x,
            text.y,
            text.content,
            fontsize=text.size * _POINTS_PER_MM,
            rotation=90 if text.upright else 0,
            rotation_mode="anchor",
            ha={"start": "left", "middle": "center"}[text.anchor],
            va="baseline",
            parse_math=False,
        )


def _add(axes: Any, marks: Marks) -> None:
    from matplotlib.collections import EllipseCollection
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    if isinstance(marks, InkDots):
        size = [marks.diameter_mm]
        dots = EllipseCollection(
            size, size, [0], units="xy", offsets=marks.centres_mm, offset_transform=axes.transData, facecolors="black"
        )
        dots.set_linewidth(0)
        axes.add_collection(dots, autolim=False)
    elif isinstance(marks, InkAreas):
        pieces = [np.vstack([piece, piece[:1]]) for piece in marks.outlines_mm]
        if pieces:
            codes = [[Outline.MOVETO] + [Outline.LINETO] * (len(piece) - 2) + [Outline.CLOSEPOLY] for piece in pieces]
            path = Outline(np.concatenate(pieces), np.concatenate(codes))
            # Not as a patch: automatic axis limits would be computed from all outlines.
            axes.add_artist(PathPatch(path, facecolor="black", edgecolor="none", linewidth=0))
    else:
        left, top, width, height = marks.box_mm
        extent = (left, left + width, top + height, top)
        axes.imshow(marks.values, cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="none", aspect="auto")


SIGN, PDF, IMAGE, SCENE_LINES = "pattern.json", "pattern.pdf", "pattern.png", "scene_lines.yaml"
"""Names of the output files, except SVG pages."""

_PER_PX, _MOST_TEXELS = 4, 64_000_000  # texels of the image per px of the rig, and their largest number


def export_pattern(pattern: Pattern, folder: str | Path, *, page: str = "A4", margin_mm: float = 10.0) -> list[Path]:
    """Write a pattern to an existing folder.

    Parameters
    ----------
    pattern
        The pattern.
    folder
        The output folder.
    page, margin_mm
        Page size and margin, as in `scenetruth.design.patterns.page_layout.lay_out_pages`.

    Returns
    -------
    list of pathlib.Path
        ``pattern.pdf`` with all pages; ``pattern.svg`` or one SVG file per page; ``pattern.png``, the pattern as an
        image texture; ``scene_lines.yaml``, lines for a scene file; and ``pattern.json``, the parameters.

    Raises
    ------
    ArgumentError
        If the page size is unknown or too small.

    See Also
    --------
    scenetruth.design.patterns.generate_pattern : Generates a pattern.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from scenetruth.design.patterns import generate_pattern, PatternRig, export_pattern
    >>> rig = PatternRig.from_scene(focal_length_px=2500, distance_mm=500)
    >>> pattern = generate_pattern(rig, size_mm=(10, 10), seed=1)
    >>> with TemporaryDirectory() as folder:
    ...     files = export_pattern(pattern, folder, page="A5")
    ...     print(*(file.name for file in files))
    ...     print(Path(folder, "scene_lines.yaml").read_text(), end="")
    pattern.pdf pattern.svg pattern.png scene_lines.yaml pattern.json
    # dots of 0.800 mm (4.00 px), 50 % covered, centres at least 1 diameters apart; seed 1
    objects:
      - name: pattern
        mesh: {kind: plane, size_mm: [10, 10]}
        pose: {position_mm: [0, 0, 500]}
        texture: {kind: image, file: pattern.png, encoding: linear}
    """
    pages = lay_out_pages(pattern, page, margin_mm)
    place = Path(folder)
    files = [place / PDF]
    write_pdf(files[0], pattern, pages)
    digits = len(str(len(pages)))
    for number, each in enumerate(pages, start=1):
        name = "pattern.svg" if len(pages) == 1 else f"pattern_{number:0{digits}}.svg"
        files.append(place / name)
        files[-1].write_text(render_svg(pattern, each), encoding="utf-8")
    write_texture_image(place / IMAGE, pattern)
    (place / SCENE_LINES).write_text(format_scene_lines(pattern), encoding="utf-8")
    values = {
        "scenetruth": version("scenetruth"),
        "pattern": pattern.to_dict(),
        "rig": pattern.rig.model_dump(mode="json"),
        "page": page,
        "pages": len(pages),
    }
    (place / SIGN).write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    return [*files, place / IMAGE, place / SCENE_LINES, place / SIGN]


def format_scene_lines(pattern: Pattern, file: str = IMAGE) -> str:
    """Return the lines of a scene file that show the pattern on a plane."""
    width, height = pattern.size_mm
    return (
        f"# {pattern.description}; seed {pattern.seed}\n"
        "objects:\n"
        "  - name: pattern\n"
        f"    mesh: {{kind: plane, size_mm: [{width:g}, {height:g}]}}\n"
        f"    pose: {{position_mm: [0, 0, {pattern.rig.distance_mm:.6g}]}}\n"
        f"    texture: {{kind: image, file: {file}, encoding: linear}}\n"
    )


def write_texture_image(file: Path, pattern: Pattern) -> None:
    """Write a pattern as an image texture of linear reflectance, with four texels per px of the rig."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    width, height = pattern.size_mm
    pitch = max(pattern.rig.mm_per_px / _PER_PX, math.sqrt(width * height / _MOST_TEXELS))
    shape = (max(round(height / pitch), 2), max(round(width / pitch), 2))
    reflectance = pattern.radiance((0.0, 0.0, width, height), shape)
    values = PngInfo()
    values.add_text("Software", "scenetruth")
    values.add_text("Description", f"linear reflectance; {pattern.description}; seed {pattern.seed}")
    options: dict[str, Any] = {"pnginfo": values, "dpi": (shape[1] / width * 25.4, shape[0] / height * 25.4)}
    if pattern.model.kind == "grey_noise":
        Image.fromarray(np.round(65535 * reflectance).astype(np.uint16)).save(file, **options)
    else:
        Image.fromarray(np.round(255 * reflectance).astype(np.uint8)).save(file, **options)
