"""The figures of an estimate, after figure 3 of the seed paper, and those that tell where its errors lie."""

from scenetruth.scoring.figures._common import FigureInfo
from scenetruth.scoring.figures.draw import FIGURES, draw_all, draw_one

__all__ = ["FIGURES", "FigureInfo", "draw_all", "draw_one"]
