"""The figures of an estimate, after figure 3 of the seed paper, and those that tell where its errors lie."""

from scenetruth.scoring.figures._common import FigureInfo
from scenetruth.scoring.figures.draw import draw_all

__all__ = ["FigureInfo", "draw_all"]
