"""Experiments that answer a question about the method, or about the images, by many virtual measurements."""

from scenetruth.experiment.emva.run import run_emva
from scenetruth.experiment.fidelity.run import run_fidelity
from scenetruth.experiment.figure2.run import run_figure2

__all__ = ["run_emva", "run_fidelity", "run_figure2"]
