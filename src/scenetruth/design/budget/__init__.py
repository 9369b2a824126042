"""The error budget: which error of depth, motion and growth comes from where, and what helps most."""

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.evaluate import budget
from scenetruth.design.budget.result import Budget

__all__ = ["Budget", "Calibration", "budget"]
