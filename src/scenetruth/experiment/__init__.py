"""Experiments that answer a question about the method by many virtual measurements."""

from scenetruth.experiment.emva import run_emva
from scenetruth.experiment.figure2 import run_figure2

__all__ = ["run_emva", "run_figure2"]
