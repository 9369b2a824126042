"""Design of experiments: attainable precision, sources of uncertainty, and better rigs and patterns."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

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
    "Budget", "Calibration", "DesignResult", "DesignSpec", "Pattern", "PatternAssessment", "PatternRig",
    "PredictedValue", "Prediction", "PredictionInputs", "Sweep", "assess_pattern", "budget", "export_pattern",
    "generate_pattern", "load_design_spec", "optimise", "predict", "recommend", "sweep",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "optimisation": "DesignResult DesignSpec load_design_spec optimise",
        "patterns": "Pattern PatternAssessment PatternRig assess_pattern export_pattern generate_pattern",
        "prediction": "PredictedValue Prediction PredictionInputs predict recommend",
        "sweeps": "Sweep sweep",
        "uncertainty": "Budget Calibration budget",
    },
)
