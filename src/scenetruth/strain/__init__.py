"""Strain of surfaces with a stated gauge: computation, exact strain from geometry, and statistics of errors."""

from scenetruth.strain.computation import compute_strain
from scenetruth.strain.gauge import MEASURES, StrainGauge, StrainSettings

__all__ = ["MEASURES", "StrainGauge", "StrainSettings", "compute_strain"]
