"""Conformance of an estimator with the contract of methods and with image-independent requirements."""

from scenetruth.testing.conformance.check_runner import (
    CheckOutcome,
    ConformanceError,
    ConformanceReport,
    EstimatorCheck,
    check_estimator,
    estimator_checks,
)
from scenetruth.testing.conformance.synthetic_plane import SyntheticPlane

__all__ = [
    "CheckOutcome",
    "ConformanceError",
    "ConformanceReport",
    "EstimatorCheck",
    "SyntheticPlane",
    "check_estimator",
    "estimator_checks",
]
