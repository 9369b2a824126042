"""The metrology suite: how accurate methods of estimation are, what breaks them, and where the bound of noise lies."""

from scenetruth.comparison.compare import compare
from scenetruth.comparison.result import Comparison

__all__ = ["Comparison", "compare"]
