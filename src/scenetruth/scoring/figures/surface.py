"""The figure of the reconstructed surface, seen obliquely from above."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scenetruth.scoring.figures._common import FigureInfo, new_figure, save
from scenetruth.scoring.figures._mesh import View, add_surface, shade, surface_axes, surface_of, texture
from scenetruth.scoring.figures._views import Views

__all__ = ["draw_surface"]

_PANELS = (("with the image on it", View(28.0, -70.0)), ("shaded", View(52.0, -80.0)))


def draw_surface(views: Views, folder: Path) -> FigureInfo:
    """Draw the estimated surface twice: with the image on it, and shaded from higher above."""
    title = f"Reconstructed surface, t = {views.frame}"
    points = views.surface_points()
    figure = new_figure(10.0, 4.6, layout=None)
    for at, (name, view) in enumerate(_PANELS, start=1):
        # The texture needs a finer mesh than the shape.
        surface = surface_of(points, views.map_focal_length_px, max_quads=80_000 if at == 1 else 40_000)
        axes = surface_axes(figure, (0.5 * at - 0.5, 0.02, 0.46, 0.9), surface.limits, view)
        grey = texture(views.image, surface) if at == 1 else shade(surface)
        add_surface(axes, surface, np.repeat(grey[:, None], 3, axis=1))
        figure.text(0.5 * at - 0.48, 0.94, f"Reconstructed surface, {name}", fontsize="large")
    save(figure, folder / "surface.png")
    above = " and ".join(f"{view.elevation_deg:.0f}°" for _, view in _PANELS)
    caption = (
        f"The estimated depth as a surface in parallel projection, true to scale, from {above} above the optical axis; "
        "the camera stands in front, Y points down. Nothing is smoothed. There is no surface where there is no full "
        "estimate, nor across jumps of the depth."
    )
    return FigureInfo("surface.png", title, caption)
