"""The figures of an estimate, after figure 3 of the seed paper, and figures of its errors."""

from scenetruth.scoring.figures.error_figures import draw_error_bars, iterate_error_samples
from scenetruth.scoring.figures.figure_arrays import collect_figure_arrays
from scenetruth.scoring.figures.figure_set import FIGURES, plot_all, plot_one
from scenetruth.scoring.figures.figure_style import FigureInfo
from scenetruth.scoring.figures.map_figures import (
    draw_coherence,
    draw_estimated_growth,
    draw_growth,
    draw_image,
    draw_velocity_z,
    growth_limits,
    pick_row,
)
from scenetruth.scoring.figures.surface_figures import (
    SurfaceView,
    arrow_factor,
    build_surface,
    draw_surface,
    draw_velocity_arrows,
    texture,
)

__all__ = [
    "FIGURES", "FigureInfo", "SurfaceView", "arrow_factor", "build_surface", "collect_figure_arrays", "draw_coherence",
    "draw_error_bars", "draw_estimated_growth", "draw_growth", "draw_image", "draw_surface", "draw_velocity_arrows",
    "draw_velocity_z", "growth_limits", "iterate_error_samples", "pick_row", "plot_all", "plot_one",
    "texture",
]  # fmt: skip
