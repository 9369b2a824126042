"""Sweeps: complete simulations over lists, ranges or Sobol points of factors, with the same seeds at every point."""

from scenetruth.design.sweeps.sweep_result import Sweep, SweepRecord
from scenetruth.design.sweeps.sweep_runner import sweep

__all__ = ["Sweep", "SweepRecord", "sweep"]
