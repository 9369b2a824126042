"""Scoring of estimates against ground truth: statistics, figures and reports."""

from scenetruth.scoring.common_statistics import COMMON_STATISTICS
from scenetruth.scoring.convention_check import detect_convention_mismatches
from scenetruth.scoring.convention_hypotheses import ConventionMismatch
from scenetruth.scoring.figures import FIGURES, FigureInfo, plot_all, plot_one
from scenetruth.scoring.growth_rate import compute_growth_rate
from scenetruth.scoring.quantities import QUANTITIES, Quantity, get_units
from scenetruth.scoring.regions import REGIONS, region_masks
from scenetruth.scoring.report import matches_fingerprint, write_report
from scenetruth.scoring.score_result import Score
from scenetruth.scoring.scorer import score, score_settings
from scenetruth.scoring.statistics import STATISTIC_TITLES, STATISTICS

__all__ = [
    "COMMON_STATISTICS", "FIGURES", "QUANTITIES", "REGIONS", "STATISTICS", "STATISTIC_TITLES", "ConventionMismatch",
    "FigureInfo", "Quantity", "Score", "compute_growth_rate", "detect_convention_mismatches", "get_units",
    "matches_fingerprint", "plot_all", "plot_one", "region_masks", "score", "score_settings", "write_report",
]  # fmt: skip
