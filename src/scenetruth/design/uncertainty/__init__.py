"""Uncertainty budget of depth, motion and growth: contributions of all sources, and mitigations."""

from scenetruth.design.uncertainty.budget_builder import budget
from scenetruth.design.uncertainty.source import Calibration
from scenetruth.design.uncertainty.uncertainty_budget import Budget

__all__ = ["Budget", "Calibration", "budget"]
