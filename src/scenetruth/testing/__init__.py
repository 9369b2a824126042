"""Tests of estimators: conformance with the contract of methods, and assertions on accuracy."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.testing.accuracy import assert_accuracy
    from scenetruth.testing.conformance import (
        ConformanceError,
        ConformanceReport,
        EstimatorCheck,
        check_estimator,
        estimator_checks,
    )
    from scenetruth.testing.tolerances import LimitError

__all__ = [
    "ConformanceError", "ConformanceReport", "EstimatorCheck", "LimitError", "assert_accuracy", "check_estimator",
    "estimator_checks",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "accuracy": "assert_accuracy",
        "conformance": "ConformanceError ConformanceReport EstimatorCheck check_estimator estimator_checks",
        "tolerances": "LimitError",
    },
)
