"""The figure of an original image."""

from __future__ import annotations

from pathlib import Path

from scenetruth.scoring.figures._common import FigureInfo, colorbar, map_height, new_figure, pixel_axes, save
from scenetruth.scoring.figures._views import Views

__all__ = ["draw_image"]


def draw_image(views: Views, folder: Path) -> FigureInfo:
    """Draw the reference camera's image."""
    title = f"Image of the reference camera, t = {views.image_frame}"
    figure = new_figure(6.4, map_height(views.image, 5.15, 0.75))
    axes = figure.add_subplot(title=title)
    drawn = axes.imshow(views.image, cmap="gray", extent=views.grid.extent)
    pixel_axes(axes)
    colorbar(figure, drawn, axes, "grey value [digital numbers]" if views.image_is_digital else "linear radiance [1]")
    save(figure, folder / "image.png")
    return FigureInfo(
        "image.png",
        title,
        f"The original image at s = 0 and t = {views.image_frame}. Black and white are its smallest and largest value.",
    )
