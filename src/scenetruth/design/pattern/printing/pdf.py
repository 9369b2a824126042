"""Pages as PDF at true scale, drawn by matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scenetruth.design.pattern.base import Areas, Dots, Marks
from scenetruth.design.pattern.make import Pattern
from scenetruth.design.pattern.printing.layout import Page

__all__ = ["write_pdf"]

_MM_PER_INCH = 25.4
_POINTS_PER_MM = 72 / _MM_PER_INCH


def write_pdf(file: Path, pattern: Pattern, pages: Sequence[Page]) -> None:
    """Write pages into a PDF file; the same bytes every time.

    Parameters
    ----------
    file
        What to write.
    pattern
        The pattern.
    pages
        Its pages.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure

    told: dict[str, Any] = {
        "Title": f"scenetruth {pattern.model.kind} pattern",
        "Subject": pattern.told,
        "Creator": "scenetruth",
        "CreationDate": None,
    }
    # Outlines keep all of their points; letters stay letters.
    settings = {"path.simplify": False, "pdf.fonttype": 42, "font.family": "DejaVu Sans", "pdf.compression": 6}
    with rc_context(settings), PdfPages(file, metadata=told) as pdf:
        for page in pages:
            figure = Figure(figsize=tuple(side / _MM_PER_INCH for side in page.size_mm))
            _draw(figure, pattern, page)
            pdf.savefig(figure)


def _draw(figure: Any, pattern: Pattern, page: Page) -> None:
    from matplotlib.collections import LineCollection

    width, height = page.size_mm
    left, top, wide, high = page.place_mm
    # Axes are cut off at their borders, as the tile is.
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

    if isinstance(marks, Dots):
        size = [marks.diameter_mm]
        dots = EllipseCollection(
            size, size, [0], units="xy", offsets=marks.centres_mm, offset_transform=axes.transData, facecolors="black"
        )
        dots.set_linewidth(0)
        axes.add_collection(dots, autolim=False)
    elif isinstance(marks, Areas):
        pieces = [np.vstack([piece, piece[:1]]) for piece in marks.outlines_mm]
        if pieces:
            codes = [[Outline.MOVETO] + [Outline.LINETO] * (len(piece) - 2) + [Outline.CLOSEPOLY] for piece in pieces]
            path = Outline(np.concatenate(pieces), np.concatenate(codes))
            # Not as a patch: limits of axes, which are known, would be looked for along all outlines.
            axes.add_artist(PathPatch(path, facecolor="black", edgecolor="none", linewidth=0))
    else:
        left, top, width, height = marks.box_mm
        extent = (left, left + width, top + height, top)
        axes.imshow(marks.values, cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="none", aspect="auto")
