"""Estimates against the truth: figures of merit, pictures and a report; pictures and a report without truth too."""

from scenetruth.scoring.evaluate import score, score_settings
from scenetruth.scoring.figures import FigureInfo, draw_all
from scenetruth.scoring.growth import surface_growth
from scenetruth.scoring.quantities import QUANTITIES, Quantity, units_of
from scenetruth.scoring.regions import REGIONS, region_masks
from scenetruth.scoring.report import write_report
from scenetruth.scoring.score import Score
from scenetruth.scoring.statistics import STATISTICS

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
