"""The figure of what the estimator says about itself: confidence, kinds of estimates, and where its model fails."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.schema import KIND_FULL, KIND_NONE, KIND_NORMAL
from scenetruth.scoring.figures._common import (
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
from scenetruth.scoring.figures._views import Views

__all__ = ["draw_confidence"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]
Panel = Callable[[Any, Any], None]
Extent = tuple[float, float, float, float]

_CODES = {KIND_FULL: (BLUE, "full"), KIND_NORMAL: ("#e69f00", "normal"), KIND_NONE: (VOID, "none")}
_TITLES = {"kind": "Kind", "kind_disparity": "Kind of disparity", "kind_motion": "Kind of motion"}
_VIOLATED = "#b0006d"


def draw_confidence(views: Views, folder: Path) -> FigureInfo | None:
    """Draw confidence, kinds and model violation, or return None for an estimate that has none of them."""
    # The kind of everything is the lesser of the other two, which say more.
    kinds = {name: kind for name, kind in views.kinds.items() if name != "kind" or len(views.kinds) < 3}
    extent = views.grid.extent
    panels, legend, names = [], [], []
    caption = "What the estimator says about itself, without any look at the truth."
    if views.confidence is not None:
        panels.append(_confidence_panel(views.confidence, extent))
        names.append("confidence")
        caption += " The confidence is between 0 and 1; larger is better."
    if kinds:
        panels += [_kind_panel(name, kind, extent) for name, kind in kinds.items()]
        names.append("kind")
        legend += [swatch(_CODES[code][0], f"kind {_CODES[code][1]}") for code in (KIND_FULL, KIND_NORMAL)]
        caption += (
            " The kind tells what could be estimated: everything (full), only the part along the grey value gradient "
            "(normal: the aperture problem), or, by methods that fit surfaces, a rough disparity; or nothing (none). "
            f"Shares of the image: {_shares(kinds)}."
        )
    if views.model_violation is not None:
        panels.append(_violation_panel(views.image, views.model_violation, extent))
        names.append("model violation")
        legend.append(swatch(_VIOLATED, "model violation"))
        caption += (
            " The model is violated where the images contradict one surface in one motion, as at occlusions and edges "
            f"of motion: {100 * np.mean(views.model_violation):.2f} % of the image, drawn on its grey values."
        )
    if not panels:
        return None
    columns = min(len(panels), 2)
    rows = math.ceil(len(panels) / columns)
    figure = new_figure(4.4 * columns + 0.6, 0.35 + rows * map_height(views.image, 3.9, 0.65))
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for place, draw in zip(axes, panels, strict=False):
        draw(figure, place)
        pixel_axes(place)
    for place in axes[len(panels) :]:
        place.remove()
    void_legend(figure, "kind none, or no value" if kinds else "no value", tuple(legend))
    save(figure, folder / "confidence.png")
    *most, last = names
    title = f"{', '.join(most)} and {last}" if most else last
    return FigureInfo("confidence.png", f"{title.capitalize()} of the estimate, t = {views.frame}", caption)


def _shares(kinds: dict[str, NDArray[np.int64]]) -> str:
    """Spell how much of the image is of every kind."""
    return "; ".join(
        (f"{_TITLES[name].lower()}, " if len(kinds) > 1 else "")
        + ", ".join(f"{label} {100 * np.mean(kind == code):.1f} %" for code, (_, label) in _CODES.items())
        for name, kind in kinds.items()
    )


def _confidence_panel(confidence: Map, extent: Extent) -> Panel:
    def draw(figure: Any, axes: Any) -> None:
        drawn = show_map(axes, confidence, cmap="cividis", vmin=0, vmax=1, extent=extent)
        axes.set_title("Confidence")
        colorbar(figure, drawn, axes, "confidence [1]")

    return draw


def _kind_panel(name: str, kind: NDArray[np.int64], extent: Extent) -> Panel:
    from matplotlib.colors import BoundaryNorm, ListedColormap

    colours = ListedColormap([_CODES[code][0] for code in sorted(_CODES)])
    norm = BoundaryNorm(np.arange(-0.5, len(_CODES)), len(_CODES))

    def draw(_: Any, axes: Any) -> None:
        axes.imshow(kind, cmap=colours, norm=norm, extent=extent)
        axes.set_title(_TITLES[name])

    return draw


def _violation_panel(image: Map, violation: Mask, extent: Extent) -> Panel:
    from matplotlib.colors import ListedColormap

    def draw(_: Any, axes: Any) -> None:
        # Pale, so that single violated pixels stand out.
        axes.imshow(image, cmap="gray", alpha=0.35, extent=extent)
        shown = np.ma.masked_where(~violation, violation)
        axes.imshow(shown, cmap=ListedColormap([_VIOLATED]), extent=extent)
        axes.set_title("Model violation")

    return draw
