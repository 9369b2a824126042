"""Common parts of all figures: description, style, colours, pixel axes, and saving."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.number_format import format_unit

__all__ = [
    "BLUE",
    "GREY",
    "ORANGE",
    "VECTOR_FORMATS",
    "VOID",
    "FigureInfo",
    "also_as",
    "colorbar",
    "hatch",
    "hatched_swatch",
    "map_height",
    "new_figure",
    "pixel_axes",
    "robust_limits",
    "save",
    "show_map",
    "style",
    "swatch",
    "symmetric_limit",
    "unit_label",
    "void_legend",
]

Map = NDArray[np.float64]

BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "#6b7280"
"""Line colours that are distinguishable with colour-vision deficiency (after Okabe and Ito)."""
VOID = "#dbe7ee"
"""Colour of pixels without a value; it occurs in no colour map in use."""
_HATCH = "////"


VECTOR_FORMATS = ("pdf",)
"""Figure formats available in addition to PNG."""
_VECTOR_DPI = 300
"""Resolution in dpi of rasterised parts of vector figures: maps, and surfaces of several thousand facets."""

_also: ContextVar[tuple[str, ...]] = ContextVar("additional figure formats", default=())


@dataclass(frozen=True)
class FigureInfo:
    """A figure on disk: file name, title and caption."""

    file: str
    title: str
    caption: str


def style() -> AbstractContextManager[None]:
    """Return a context with a fixed style, independent of the user's settings."""
    import matplotlib.style

    settings = {
        "font.size": 9,
        "axes.titlesize": 10,
        "axes.titlelocation": "left",
        # Automatic placement of titles takes 20 % of the total time, and nothing above the axes interferes with them.
        "axes.titley": 1.0,
        "axes.labelsize": 9,
        "axes.linewidth": 0.6,
        "xtick.labelsize": 8,
        "ytick.labelsize": 8,
        "xtick.major.width": 0.6,
        "ytick.major.width": 0.6,
        "legend.fontsize": 8,
        "legend.frameon": False,
        # Text stays text, as journals require.
        "pdf.fonttype": 42,
        "lines.linewidth": 1.0,
        "image.interpolation": "none",
        "axes.axisbelow": True,
        "grid.color": "#d7dbe0",
        "grid.linewidth": 0.5,
    }
    context: AbstractContextManager[None] = matplotlib.style.context(["default", settings])
    return context


def new_figure(width: float, height: float, layout: Any = "constrained") -> Any:
    """Return an empty figure of a size in inches on a separate canvas."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=160, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def map_height(values: Map, width: float, extra: float) -> float:
    """Return the height in inches of a figure with a map of the given width and extra space above and below."""
    ratio: float = values.shape[0] / values.shape[1]
    return extra + min(max(width * ratio, 0.8), 12.0)


@contextmanager
def also_as(formats: Collection[str]) -> Iterator[None]:
    """Provide a context in which `save` also writes every figure in the given `VECTOR_FORMATS`."""
    before = _also.set(tuple(formats))
    try:
        yield
    finally:
        _also.reset(before)


def svg_of(figure: Any) -> str:
    """Return a figure as an SVG element, with the same identifiers in every run."""
    from io import StringIO

    from matplotlib import rc_context

    text = StringIO()
    with rc_context({"svg.hashsalt": "scenetruth"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    found = text.getvalue()
    return found[found.index("<svg") :]


def save(figure: Any, path: Path) -> None:
    """Write a figure as PNG and in the formats of `also_as`; the output is reproducible byte for byte."""
    layout = figure.get_layout_engine()
    if layout is not None:
        # Axes with a fixed aspect ratio move during layout, and their labels with them, so one pass is not enough.
        layout.execute(figure)
        layout.execute(figure)
        # The layout is frozen: saving would repeat it twice and draw the figure once more without output.
        figure.set_layout_engine(None)
    # The default compression level takes longer than drawing.
    figure.savefig(path, metadata={"Software": "scenetruth"}, pil_kwargs={"compress_level": 4})
    for name in _also.get():
        vector = path.with_suffix(f".{name}")
        metadata = {"Creator": "scenetruth", "CreationDate": None}
        figure.savefig(vector, format=name, dpi=_VECTOR_DPI, metadata=metadata)
        # Identifies files drawn by scenetruth; readers ignore data after the end.
        with vector.open("ab") as file:
            file.write(b"% drawn by scenetruth\n")


def pixel_axes(axes: Any, *, label_y: bool = True) -> None:
    """Label axes in pixels."""
    axes.set_xlabel("x [px]")
    if label_y:
        axes.set_ylabel("y [px]")


def show_map(axes: Any, values: Map, **options: Any) -> Any:
    """Draw a map with `VOID` for pixels without a value; ``extent`` specifies its position in px."""
    axes.set_facecolor(VOID)
    return axes.imshow(np.ma.masked_invalid(values), **options)


def hatch(axes: Any, where: NDArray[np.bool_], x: Map, y: Map) -> None:
    """Hatch pixels of a map."""
    if where.any():
        axes.contourf(x, y, where, levels=(0.5, 1.5), colors="none", hatches=(_HATCH,))


def hatched_swatch(label: str) -> Any:
    """Return a legend handle of a hatched area."""
    from matplotlib.patches import Patch

    return Patch(facecolor="none", edgecolor=GREY, linewidth=0.5, hatch=_HATCH, label=label)


def colorbar(figure: Any, drawn: Any, axes: Any, label: str, **options: Any) -> Any:
    """Add a thin colour bar with the height of the axes."""
    from matplotlib.ticker import ScalarFormatter

    bar = figure.colorbar(drawn, cax=axes.inset_axes((1.025, 0.0, 0.035, 1.0)), label=label, **options)
    bar.outline.set_linewidth(0.6)
    if isinstance(bar.formatter, ScalarFormatter):
        bar.ax.ticklabel_format(useOffset=False)
    return bar


def void_legend(
    figure: Any, text: str = "no valid estimate", extra: tuple[Any, ...] = (), columns: int | None = None
) -> None:
    """Add a legend for the colour `VOID` below a figure, after the handles of further entries."""
    figure.legend(handles=[*extra, swatch(VOID, text)], loc="outside lower left", ncols=columns or 1 + len(extra))


def swatch(colour: str, label: str) -> Any:
    """Return a legend handle of a uniformly coloured area."""
    from matplotlib.patches import Patch

    return Patch(facecolor=colour, edgecolor=GREY, linewidth=0.5, label=label)


def unit_label(unit: str) -> str:
    """Return a unit in brackets for the label of an axis; nothing for ratios."""
    return f" [{format_unit(unit)}]" if format_unit(unit) else ""


def symmetric_limit(*maps: Map, percent: float = 2.0) -> float:
    """Return the limit of a symmetric scale that excludes the given percentage of the finite values."""
    return robust_limits(*(np.abs(values) for values in maps), percent=percent)[1]


def robust_limits(*maps: Map, percent: float = 1.0) -> tuple[float, float]:
    """Return limits that exclude the given percentage of the finite values at either end."""
    values = np.concatenate([values[np.isfinite(values)] for values in maps])
    if values.size == 0:
        return 0.0, 1.0
    low, high = (float(value) for value in np.percentile(values, [percent, 100.0 - percent]))
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        pad = 0.05 * abs(low) or 1.0
        return low - pad, high + pad
    return low, high
