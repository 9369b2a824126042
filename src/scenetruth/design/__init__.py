"""Design of experiments: attainable precision, sources of uncertainty, and better rigs and patterns."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenetruth.design.optimisation import DesignResult, DesignSpec, load_design_spec, optimise
    from scenetruth.design.patterns import (
        Pattern,
        PatternAssessment,
        PatternRig,
        assess_pattern,
        export_pattern,
        generate_pattern,
    )
    from scenetruth.design.prediction import PredictedValue, Prediction, PredictionInputs, predict, recommend
    from scenetruth.design.sweeps import Sweep, sweep
    from scenetruth.design.uncertainty import Budget, Calibration, budget

__all__ = [
    "Budget",
    "Calibration",
    "DesignResult",
    "DesignSpec",
    "Pattern",
    "PatternAssessment",
    "PatternRig",
    "PredictedValue",
    "Prediction",
    "PredictionInputs",
    "Sweep",
    "assess_pattern",
    "budget",
    "export_pattern",
    "generate_pattern",
    "load_design_spec",
    "optimise",
    "predict",
    "recommend",
    "sweep",
]

_HOMES = {
    "Budget": "uncertainty",
    "Calibration": "uncertainty",
    "DesignResult": "optimisation",
    "DesignSpec": "optimisation",
    "Pattern": "patterns",
    "PatternAssessment": "patterns",
    "PatternRig": "patterns",
    "PredictedValue": "prediction",
    "Prediction": "prediction",
    "PredictionInputs": "prediction",
    "Sweep": "sweeps",
    "assess_pattern": "patterns",
    "budget": "uncertainty",
    "export_pattern": "patterns",
    "generate_pattern": "patterns",
    "load_design_spec": "optimisation",
    "optimise": "optimisation",
    "predict": "prediction",
    "recommend": "prediction",
    "sweep": "sweeps",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        msg = f"module 'scenetruth.design' has no attribute '{name}'"
        raise AttributeError(msg)
    value = getattr(import_module(f"scenetruth.design.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
