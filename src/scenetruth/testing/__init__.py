"""Tests of estimators: conformance with the contract of methods, and assertions on accuracy."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

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
    "ConformanceError",
    "ConformanceReport",
    "EstimatorCheck",
    "LimitError",
    "assert_accuracy",
    "check_estimator",
    "estimator_checks",
]

_HOMES = {"LimitError": "tolerances", "assert_accuracy": "accuracy"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        msg = f"module 'scenetruth.testing' has no attribute '{name}'"
        raise AttributeError(msg)
    value = getattr(import_module(f"scenetruth.testing.{_HOMES.get(name, 'conformance')}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
