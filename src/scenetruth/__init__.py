"""Rendered scenes with exact ground truth for measuring depth and 3D motion from a camera on a linear stage."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from scenetruth.compilation import keep_compiled_code

if TYPE_CHECKING:
    from scenetruth.benchmark import BenchmarkResult, compare
    from scenetruth.camera import two_point_correction
    from scenetruth.dataset.dataset_export import export, verify
    from scenetruth.dataset.generation import run_dataset
    from scenetruth.dataset.reading import open_dataset
    from scenetruth.dataset.recipe_loader import Recipe, load_recipe
    from scenetruth.design.optimisation import DesignResult
    from scenetruth.design.prediction import Prediction, predict
    from scenetruth.design.sweeps import Sweep, sweep
    from scenetruth.design.uncertainty import Budget
    from scenetruth.errors import (
        BackendUnavailableError,
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
    from scenetruth.scoring import Score, compute_growth_rate, score, write_report
    from scenetruth.simulation import simulate
    from scenetruth.storage import load_store, open_store, save_store
    from scenetruth.truth import make_truth, track_points

    __version__: str

keep_compiled_code()

__all__ = [
    "BackendUnavailableError",
    "BenchmarkResult",
    "Budget",
    "DesignResult",
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
    "StoreError",
    "Sweep",
    "compare",
    "compute_growth_rate",
    "estimate",
    "export",
    "export_formats",
    "load_recipe",
    "load_scene",
    "load_store",
    "make_estimate",
    "make_recording",
    "make_truth",
    "open_dataset",
    "open_store",
    "predict",
    "run_dataset",
    "run_scene",
    "save_store",
    "score",
    "simulate",
    "sweep",
    "track_points",
    "two_point_correction",
    "verify",
    "write_report",
]

_HOMES = {
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
    "two_point_correction": "camera",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _installed_version()
    if name not in __all__:
        msg = f"module 'scenetruth' has no attribute '{name}'"
        raise AttributeError(msg)
    value = getattr(import_module(f"scenetruth.{_HOMES.get(name, 'errors')}"), name)
    globals()[name] = value
    return value


def _installed_version() -> str:
    """Return the version of the installation, which is made from the tag: docs/decisions/0052."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("scenetruth")
    except PackageNotFoundError:
        return "0+unknown"  # source files that nobody installed


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
