"""Rendered scenes with exact ground truth for measuring depth and 3D motion from a camera on a linear stage."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from scenetruth.compilation import keep_compiled_code

if TYPE_CHECKING:
    from scenetruth.benchmark import BenchmarkResult, compare
    from scenetruth.bound import cramer_rao_bound
    from scenetruth.dataset.dataset_export import export, verify
    from scenetruth.dataset.generation import run_dataset
    from scenetruth.dataset.reading import open_dataset
    from scenetruth.dataset.recipe_loader import Recipe, load_recipe
    from scenetruth.design.optimisation import DesignResult, optimise
    from scenetruth.design.patterns import assess_pattern, generate_pattern
    from scenetruth.design.prediction import Prediction, predict
    from scenetruth.design.sweeps import Sweep, sweep
    from scenetruth.design.uncertainty import Budget, budget
    from scenetruth.errors import (
        ArgumentError,
        BackendUnavailableError,
        DesignSpecError,
        EstimateError,
        EstimateWarning,
        ExportError,
        MachineError,
        MismatchError,
        OutputExistsError,
        Problem,
        RecipeError,
        RecordingError,
        RenderError,
        SceneError,
        ScenetruthError,
        SceneWarning,
        ScoreError,
        StoreError,
    )
    from scenetruth.estimators import estimate
    from scenetruth.exporters import export_formats
    from scenetruth.pipeline import RunDirectory, run_scene
    from scenetruth.resources import Limits
    from scenetruth.scene import Scene, load_scene
    from scenetruth.schema import make_estimate, make_recording
    from scenetruth.scoring import Score, compute_growth_rate, detect_convention_mismatches, score, write_report
    from scenetruth.simulation import simulate
    from scenetruth.storage import load_store, open_store, save_store
    from scenetruth.truth import make_truth, track_points

    __version__: str

keep_compiled_code()

__all__ = [
    "ArgumentError",
    "BackendUnavailableError",
    "BenchmarkResult",
    "Budget",
    "DesignResult",
    "DesignSpecError",
    "EstimateError",
    "EstimateWarning",
    "ExportError",
    "Limits",
    "MachineError",
    "MismatchError",
    "OutputExistsError",
    "Prediction",
    "Problem",
    "Recipe",
    "RecipeError",
    "RecordingError",
    "RenderError",
    "RunDirectory",
    "Scene",
    "SceneError",
    "SceneWarning",
    "ScenetruthError",
    "Score",
    "ScoreError",
    "Simulation",
    "StoreError",
    "Sweep",
    "assess_pattern",
    "budget",
    "compare",
    "compute_growth_rate",
    "cramer_rao_bound",
    "detect_convention_mismatches",
    "estimate",
    "export",
    "export_formats",
    "generate_pattern",
    "load_recipe",
    "load_scene",
    "load_store",
    "make_estimate",
    "make_recording",
    "make_truth",
    "open_dataset",
    "open_store",
    "optimise",
    "predict",
    "run_dataset",
    "run_scene",
    "save_store",
    "score",
    "simulate",
    "sweep",
    "track_points",
    "verify",
    "write_report",
]

_HOMES = {
    "budget": "design.uncertainty",
    "optimise": "design.optimisation",
    "generate_pattern": "design.patterns",
    "assess_pattern": "design.patterns",
    "cramer_rao_bound": "bound",
    "detect_convention_mismatches": "scoring",
    "Budget": "design.uncertainty",
    "BenchmarkResult": "benchmark",
    "DesignResult": "design.optimisation",
    "Prediction": "design.prediction",
    "Sweep": "design.sweeps",
    "predict": "design.prediction",
    "sweep": "design.sweeps",
    "Limits": "resources",
    "compare": "benchmark",
    "load_recipe": "dataset.recipe_loader",
    "open_dataset": "dataset.reading",
    "Recipe": "dataset.recipe_loader",
    "run_dataset": "dataset.generation",
    "Scene": "scene",
    "load_scene": "scene",
    "Simulation": "simulation",
    "simulate": "simulation",
    "make_estimate": "schema",
    "make_recording": "schema",
    "estimate": "estimators",
    "Score": "scoring",
    "score": "scoring",
    "load_store": "storage",
    "open_store": "storage",
    "RunDirectory": "pipeline",
    "export": "dataset.dataset_export",
    "export_formats": "exporters",
    "run_scene": "pipeline",
    "verify": "dataset.dataset_export",
    "save_store": "storage",
    "make_truth": "truth",
    "compute_growth_rate": "scoring",
    "track_points": "truth",
    "write_report": "scoring",
}

_NAMESPACES = ("bound", "camera", "dataset", "design", "errors", "estimators", "testing")
"""Public subpackages, imported on access."""


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _installed_version()
    if name in _NAMESPACES:
        return import_module(f"scenetruth.{name}")
    if name not in __all__:
        msg = f"module 'scenetruth' has no attribute '{name}'"
        raise AttributeError(msg)
    value = getattr(import_module(f"scenetruth.{_HOMES.get(name, 'errors')}"), name)
    globals()[name] = value
    return value


def _installed_version() -> str:
    """Return the installed version, which is derived from the tag (docs/explanation/decisions/0052)."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("scenetruth")
    except PackageNotFoundError:
        return "0+unknown"  # source files without installation


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
