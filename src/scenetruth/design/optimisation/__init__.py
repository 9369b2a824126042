"""Optimisation of a rig: specification, catalogues, constraints, search, and confirmation by simulation."""

from scenetruth.design.optimisation.confirmation import check_rank_consistency
from scenetruth.design.optimisation.design_records import (
    ConstraintValue,
    Discrepancy,
    Objective,
    PredictionInterval,
    RigDesign,
    RuleOfThumb,
    Sensitivity,
)
from scenetruth.design.optimisation.design_result import DesignResult
from scenetruth.design.optimisation.optimiser import optimise
from scenetruth.design.optimisation.problem_setup import prepare_problem
from scenetruth.design.optimisation.rig_evaluation import DesignSpace, Evaluation, Parameter
from scenetruth.design.optimisation.specification import DesignSpec, load_design_spec

__all__ = [
    "ConstraintValue",
    "DesignResult",
    "DesignSpace",
    "DesignSpec",
    "Discrepancy",
    "Evaluation",
    "Objective",
    "Parameter",
    "PredictionInterval",
    "RigDesign",
    "RuleOfThumb",
    "Sensitivity",
    "check_rank_consistency",
    "load_design_spec",
    "optimise",
    "prepare_problem",
]
