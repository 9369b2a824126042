"""The figure of what the estimator says about itself: its confidence and the kind of each estimate."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.recording import KIND_FULL, KIND_NONE, KIND_NORMAL
from scenetruth.score.figures._common import (
    BLUE,
    VOID,
    FigureInfo,
    colorbar,
    map_height,
    new_figure,
    pixel_axes,
    save,
    show_map,
    swatch,
    void_legend,
)
from scenetruth.score.figures._views import Views

__all__ = ["draw_confidence"]

Map = NDArray[np.float64]

_KINDS = {KIND_FULL: (BLUE, "kind full"), KIND_NORMAL: ("#e69f00", "kind normal"), KIND_NONE: (VOID, "kind none")}


def draw_confidence(views: Views, folder: Path) -> FigureInfo | None:
    """Draw confidence and kind, or return None for an estimate that has neither."""
    confidence, kind = views.confidence, views.kind
    panels: list[Callable[[Any, Any], None]] = []
    if confidence is not None:
        known = confidence
        panels.append(lambda figure, axes: _draw_confidence(figure, axes, known))
    if kind is not None:
        codes = kind
        panels.append(lambda _, axes: _draw_kind(axes, codes))
    if not panels:
        return None
    figure = new_figure(4.4 * len(panels) + 0.6, map_height(views.image, 3.8, 1.0))
    for axes, draw in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        draw(figure, axes)
        pixel_axes(axes)
    if kind is None:
        void_legend(figure, "no value")
    else:
        void_legend(figure, "kind none, or no value", tuple(swatch(*_KINDS[code]) for code in (KIND_FULL, KIND_NORMAL)))
    save(figure, folder / "confidence.png")
    caption = "What the estimator says about itself, without any look at the truth."
    if confidence is not None:
        caption += " The confidence is between 0 and 1; larger is better."
    if kind is not None:
        shares = (
            f"{label.removeprefix('kind ')} {100 * np.mean(kind == code):.1f} %" for code, (_, label) in _KINDS.items()
        )
        caption += (
            " The kind tells what could be estimated: everything (full), only the part along the grey value gradient "
            f"(normal, the aperture problem), or nothing (none). Shares of the image: {', '.join(shares)}."
        )
    names = " and ".join(name for name, there in (("confidence", confidence), ("kind", kind)) if there is not None)
    return FigureInfo("confidence.png", f"{names.capitalize()} of the estimate, t = {views.frame}", caption)


def _draw_confidence(figure: Any, axes: Any, confidence: Map) -> None:
    drawn = show_map(axes, confidence, cmap="cividis", vmin=0, vmax=1)
    axes.set_title("Confidence")
    colorbar(figure, drawn, axes, "confidence [1]")


def _draw_kind(axes: Any, kind: NDArray[np.int64]) -> None:
    from matplotlib.colors import BoundaryNorm, ListedColormap

    colours = [_KINDS[code][0] for code in sorted(_KINDS)]
    axes.imshow(kind, cmap=ListedColormap(colours), norm=BoundaryNorm(np.arange(-0.5, len(_KINDS)), len(_KINDS)))
    axes.set_title("Kind")
