"""Rendered scenes with exact ground truth for measuring depth and 3D motion from a camera on a linear stage."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from scenetruth.compilation import keep_compiled_code

if TYPE_CHECKING:
    from scenetruth.camera import two_point_correction
    from scenetruth.comparison import Comparison, compare
    from scenetruth.dataset.reading import open_dataset
    from scenetruth.dataset.recipe.load import load_recipe, recipe_from_plain
    from scenetruth.dataset.run import run_dataset
    from scenetruth.design.budget import Budget
    from scenetruth.design.optimise import Design
    from scenetruth.design.predict import Prediction, predict
    from scenetruth.design.sweep import Sweep, sweep
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
    from scenetruth.export import export_data, export_formats
    from scenetruth.pipeline import RunFolder, export_run, run_scene, verify_folder
    from scenetruth.resources import Limits
    from scenetruth.scene import Scene, load_scene, scene_from_plain
    from scenetruth.schema import make_estimate, make_recording
    from scenetruth.scoring import Score, score, surface_growth, write_report
    from scenetruth.simulation import simulate
    from scenetruth.storage import load, open_store, save
    from scenetruth.truth import make_truth, track_points

    __version__: str

keep_compiled_code()

__all__ = [
    "BackendUnavailableError",
    "Budget",
    "Comparison",
    "Design",
    "EstimateError",
    "EstimateWarning",
    "ExportError",
    "Limits",
    "MachineError",
    "MismatchError",
    "OutputExistsError",
    "Prediction",
    "Problem",
    "RecipeError",
    "RecordingError",
    "RenderError",
    "RunFolder",
    "Scene",
    "SceneError",
    "SceneWarning",
    "ScenetruthError",
    "Score",
    "ScoreError",
    "StoreError",
    "Sweep",
    "compare",
    "estimate",
    "export_data",
    "export_formats",
    "export_run",
    "load",
    "load_recipe",
    "load_scene",
    "make_estimate",
    "make_recording",
    "make_truth",
    "open_dataset",
    "open_store",
    "predict",
    "recipe_from_plain",
    "run_dataset",
    "run_scene",
    "save",
    "scene_from_plain",
    "score",
    "simulate",
    "surface_growth",
    "sweep",
    "track_points",
    "two_point_correction",
    "verify_folder",
    "write_report",
]

_HOMES = {
    "Budget": "design.budget",
    "Comparison": "comparison",
    "Design": "design.optimise",
    "Prediction": "design.predict",
    "Sweep": "design.sweep",
    "predict": "design.predict",
    "sweep": "design.sweep",
    "Limits": "resources",
    "compare": "comparison",
    "load_recipe": "dataset.recipe.load",
    "open_dataset": "dataset.reading",
    "recipe_from_plain": "dataset.recipe.load",
    "run_dataset": "dataset.run",
    "Scene": "scene",
    "load_scene": "scene",
    "scene_from_plain": "scene",
    "simulate": "simulation",
    "make_estimate": "schema",
    "make_recording": "schema",
    "estimate": "estimators",
    "Score": "scoring",
    "score": "scoring",
    "load": "storage",
    "open_store": "storage",
    "RunFolder": "pipeline",
    "export_data": "export",
    "export_formats": "export",
    "export_run": "pipeline",
    "run_scene": "pipeline",
    "verify_folder": "pipeline",
    "save": "storage",
    "make_truth": "truth",
    "surface_growth": "scoring",
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
