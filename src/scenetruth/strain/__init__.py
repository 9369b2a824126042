"""Strain of surfaces with a stated gauge: computation, exact strain from geometry, and statistics of errors."""

from scenetruth.strain.computation import compute_strain, describe_missing_strain
from scenetruth.strain.gauge import MEASURES, StrainGauge, StrainSettings, strain_settings
from scenetruth.strain.good_practice import GoodPracticeReport, ReportField, report_good_practice
from scenetruth.strain.strain_score import StrainScore, score_strain
from scenetruth.strain.true_strain import compute_true_strain

__all__ = [
    "MEASURES", "GoodPracticeReport", "ReportField", "StrainGauge", "StrainScore", "StrainSettings", "compute_strain",
    "compute_true_strain", "describe_missing_strain", "report_good_practice", "score_strain", "strain_settings",
]  # fmt: skip
