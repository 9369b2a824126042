"""Rendered scenes with exact ground truth for measuring depth and 3D motion from a camera on a linear stage."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from scenetruth.compilation import keep_compiled_code
from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.benchmark import BenchmarkResult, compare
    from scenetruth.bound import cramer_rao_bound
    from scenetruth.capture import average_frames, correct_images, read_images, undistort_images
    from scenetruth.dataset.dataset_estimation import estimate_dataset
    from scenetruth.dataset.dataset_export import export, verify
    from scenetruth.dataset.generation import check_recipe, run_dataset
    from scenetruth.dataset.pages.card import write_card
    from scenetruth.dataset.pages.preview_page import preview_dataset
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
        CaptureError,
        CaptureWarning,
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
    from scenetruth.simulation import Simulation, make_truth, simulate
    from scenetruth.storage import load_store, open_store, save_store
    from scenetruth.strain import GoodPracticeReport, StrainScore, compute_strain, report_good_practice, score_strain
    from scenetruth.truth import track_points

    __version__: str

keep_compiled_code()

__all__ = [
    "ArgumentError", "BackendUnavailableError", "BenchmarkResult", "Budget", "CaptureError", "CaptureWarning",
    "DesignResult", "DesignSpecError", "EstimateError", "EstimateWarning", "ExportError", "GoodPracticeReport",
    "Limits", "MachineError", "MismatchError", "OutputExistsError", "Prediction", "Problem", "Recipe", "RecipeError",
    "RecordingError", "RenderError", "RunDirectory", "Scene", "SceneError", "SceneWarning", "ScenetruthError", "Score",
    "ScoreError", "Simulation", "StoreError", "StrainScore", "Sweep", "assess_pattern", "average_frames", "budget",
    "check_recipe", "compare", "compute_growth_rate", "compute_strain", "correct_images", "cramer_rao_bound",
    "detect_convention_mismatches", "estimate", "estimate_dataset", "export", "export_formats", "generate_pattern",
    "load_recipe", "load_scene", "load_store", "make_estimate", "make_recording", "make_truth", "open_dataset",
    "open_store", "optimise", "predict", "preview_dataset", "read_images", "report_good_practice", "run_dataset",
    "run_scene", "save_store", "score", "score_strain", "simulate", "sweep", "track_points", "undistort_images",
    "verify", "write_card", "write_report",
]  # fmt: skip

_import_name, _list_names = export_lazily(
    __name__,
    {
        "benchmark": "BenchmarkResult compare",
        "bound": "cramer_rao_bound",
        "capture": "average_frames correct_images read_images undistort_images",
        "dataset.dataset_estimation": "estimate_dataset",
        "dataset.dataset_export": "export verify",
        "dataset.generation": "check_recipe run_dataset",
        "dataset.pages.card": "write_card",
        "dataset.pages.preview_page": "preview_dataset",
        "dataset.reading": "open_dataset",
        "dataset.recipe_loader": "Recipe load_recipe",
        "design.optimisation": "DesignResult optimise",
        "design.patterns": "assess_pattern generate_pattern",
        "design.prediction": "Prediction predict",
        "design.sweeps": "Sweep sweep",
        "design.uncertainty": "Budget budget",
        "errors": (
            "ArgumentError BackendUnavailableError CaptureError CaptureWarning DesignSpecError EstimateError "
            "EstimateWarning ExportError MachineError MismatchError OutputExistsError Problem RecipeError "
            "RecordingError RenderError SceneError SceneWarning ScenetruthError ScoreError StoreError"
        ),
        "estimators": "estimate",
        "exporters": "export_formats",
        "pipeline": "RunDirectory run_scene",
        "resources": "Limits",
        "scene": "Scene load_scene",
        "schema": "make_estimate make_recording",
        "scoring": "Score compute_growth_rate detect_convention_mismatches score write_report",
        "simulation": "Simulation make_truth simulate",
        "storage": "load_store open_store save_store",
        "strain": "GoodPracticeReport StrainScore compute_strain report_good_practice score_strain",
        "truth": "track_points",
    },
)

_NAMESPACES = ("bound", "camera", "capture", "dataset", "design", "errors", "estimators", "testing")
"""Public subpackages, imported on access."""


def __dir__() -> list[str]:
    return sorted({*_list_names(), "__version__"})


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _installed_version()
    if name in _NAMESPACES:
        return import_module(f"scenetruth.{name}")
    return _import_name(name)


def _installed_version() -> str:
    """Return the installed version, which is derived from the tag (docs/explanation/decisions/0052)."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("scenetruth")
    except PackageNotFoundError:
        return "0+unknown"  # source files without installation
