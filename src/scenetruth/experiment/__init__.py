"""Experiments that answer a question about the method, or about the images, by many virtual measurements."""

from scenetruth.experiment.emva import run_emva
from scenetruth.experiment.fidelity import run_fidelity
from scenetruth.experiment.figure2 import run_figure2

__all__ = ["run_emva", "run_fidelity", "run_figure2"]
