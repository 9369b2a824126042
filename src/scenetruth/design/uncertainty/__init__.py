"""Uncertainty budget of depth, motion and growth: contributions of all sources, and mitigations."""

from scenetruth.design.uncertainty.budget_builder import budget
from scenetruth.design.uncertainty.contributions import CombinedUncertainty, Contribution
from scenetruth.design.uncertainty.source import Calibration, Mitigation
from scenetruth.design.uncertainty.uncertainty_budget import Budget

__all__ = [
    "Budget",
    "Calibration",
    "CombinedUncertainty",
    "Contribution",
    "Mitigation",
    "budget",
]
