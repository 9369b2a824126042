"""Full simulations over whatever varies: lists, ranges or Sobol's points, the same seeds at every point."""

from scenetruth.design.sweep.result import Sweep
from scenetruth.design.sweep.run import sweep

__all__ = ["Sweep", "sweep"]
