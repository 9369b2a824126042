"""Estimate and truth in; figures of merit, pictures and a report out."""

from scenetruth.score.figures import FigureInfo, draw_all
from scenetruth.score.growth import surface_growth
from scenetruth.score.quantities import QUANTITIES, Quantity, units_of
from scenetruth.score.regions import REGIONS, region_masks
from scenetruth.score.report import write_report
from scenetruth.score.score import Score, score, score_settings
from scenetruth.score.statistics import STATISTICS

__all__ = [
    "QUANTITIES",
    "REGIONS",
    "STATISTICS",
    "FigureInfo",
    "Quantity",
    "Score",
    "draw_all",
    "region_masks",
    "score",
    "score_settings",
    "surface_growth",
    "units_of",
    "write_report",
]
