"""Estimates against the truth: figures of merit, pictures and a report; pictures and a report without truth too."""

from scenetruth.scoring.evaluate import score, score_settings
from scenetruth.scoring.figures import FIGURES, FigureInfo, draw_all, draw_one
from scenetruth.scoring.growth import surface_growth
from scenetruth.scoring.quantities import QUANTITIES, Quantity, units_of
from scenetruth.scoring.regions import REGIONS, region_masks
from scenetruth.scoring.report import is_made_of, write_report
from scenetruth.scoring.score import Score
from scenetruth.scoring.slips import Slip, find_slips, slips_of_arrays
from scenetruth.scoring.statistics import STATISTICS

__all__ = [
    "FIGURES",
    "QUANTITIES",
    "REGIONS",
    "STATISTICS",
    "FigureInfo",
    "Quantity",
    "Score",
    "Slip",
    "draw_all",
    "draw_one",
    "find_slips",
    "is_made_of",
    "region_masks",
    "score",
    "score_settings",
    "slips_of_arrays",
    "surface_growth",
    "units_of",
    "write_report",
]
