"""Whether an estimator keeps to the contract of methods, and to what must hold for any images."""

from scenetruth.testing.conformance.report import ConformanceError, ConformanceReport, Outcome
from scenetruth.testing.conformance.run import EstimatorCheck, check_estimator, estimator_checks
from scenetruth.testing.conformance.scenes import Plane

__all__ = [
    "ConformanceError",
    "ConformanceReport",
    "EstimatorCheck",
    "Outcome",
    "Plane",
    "check_estimator",
    "estimator_checks",
]
