"""The figures of an estimate, after figure 3 of the seed paper, and figures of its errors."""

from scenetruth.scoring.figures.figure_set import FIGURES, plot_all, plot_one
from scenetruth.scoring.figures.figure_style import FigureInfo

__all__ = ["FIGURES", "FigureInfo", "plot_all", "plot_one"]
