"""Validation studies: simulated measurements of sensors, estimators and renderers with exact references."""

from scenetruth.validation_studies.emva1288 import run_emva
from scenetruth.validation_studies.paper_figure2 import run_figure2
from scenetruth.validation_studies.rendering_accuracy import run_fidelity

__all__ = ["run_emva", "run_fidelity", "run_figure2"]
