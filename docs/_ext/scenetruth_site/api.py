"""Public names by topic, as pages of the reference."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from importlib import import_module
from typing import Any

from pydantic import BaseModel

__all__ = ["API", "api_in_markdown", "documented_names"]

API: dict[str, dict[str, tuple[str, ...]]] = {
    "scenes": {
        "scenetruth": ("load_scene", "Scene", "Limits"),
        "scenetruth.scene": ("leaf_material", "BladeSpectrum"),
    },
    "simulation": {
        "scenetruth": (
            "simulate",
            "Simulation",
            "make_truth",
            "track_points",
            "run_scene",
            "RunDirectory",
            "verify",
        ),
        "scenetruth.camera": ("two_point_correction", "demosaic"),
        "scenetruth.camera.sensor": ("demosaic_wave", "predict_displacement"),
        "scenetruth.capture": ("simulate_capture", "CaptureSimulation"),
    },
    "capture": {
        "scenetruth": ("read_images", "average_frames", "correct_images", "undistort_images"),
        "scenetruth.capture": (
            "load_capture",
            "Capture",
            "write_capture_file",
            "capture_text",
            "check_capture",
            "CaptureReport",
            "CaptureFinding",
            "run_capture",
            "CaptureRun",
            "calibrate_capture",
            "import_capture",
            "add_calibration_errors",
            "region_mean",
            "RegionMean",
            "measure_noise",
            "SensorNoise",
            "find_defects",
            "fit_gamma",
            "GammaFit",
            "measure_linearity",
            "Linearity",
            "compare_exposures",
            "run_twin",
            "make_twin",
            "TwinRun",
            "TwinPrediction",
            "Twin",
            "RegionError",
            "Comparison",
        ),
    },
    "calibration": {
        "scenetruth.capture.calibration": (
            "calibrate",
            "BoardImage",
            "RigCalibration",
            "observe_boards",
            "observe_strip",
            "import_calibration",
            "import_camera",
            "export_calibration",
            "CalibrationError",
        )
    },
    "data": {"scenetruth": ("make_recording", "make_estimate", "save_store", "load_store", "open_store")},
    "estimation": {
        "scenetruth": ("estimate",),
        "scenetruth.estimators": (
            "Estimator",
            "Method",
            "StreamingMethod",
            "EstimationTask",
            "MethodSettings",
            "MethodSpec",
            "Needs",
            "MethodEntry",
            "list_methods",
            "find_method",
            "validate_settings",
        ),
        "scenetruth.estimators.registry": ("DEFAULT_METHOD",),
        "scenetruth.estimators.external": (
            "CommandMethod",
            "ResultsFolder",
            "write_recording",
            "read_results",
            "recording_key",
        ),
    },
    "scoring": {
        "scenetruth.results": ("QuantityValue",),
        "scenetruth": ("score", "Score", "compute_growth_rate", "write_report", "detect_convention_mismatches"),
    },
    "strain": {
        "scenetruth": ("compute_strain", "score_strain", "StrainScore", "report_good_practice", "GoodPracticeReport"),
        "scenetruth.strain": ("StrainSettings", "compute_true_strain"),
    },
    "comparison": {
        "scenetruth": ("compare", "BenchmarkResult", "cramer_rao_bound"),
        "scenetruth.bound": ("closed_form_bound", "ClosedFormBound", "texture_gradient"),
    },
    "datasets": {
        "scenetruth": (
            "load_recipe",
            "Recipe",
            "check_recipe",
            "preview_dataset",
            "run_dataset",
            "estimate_dataset",
            "open_dataset",
            "write_card",
        ),
        "scenetruth.dataset": ("RecipeReport", "DatasetRunResult"),
    },
    "design": {
        "scenetruth": (
            "predict",
            "Prediction",
            "sweep",
            "Sweep",
            "budget",
            "Budget",
            "optimise",
            "DesignResult",
            "generate_pattern",
            "assess_pattern",
        ),
        "scenetruth.design.prediction": ("PredictedValue", "PredictionInputs", "recommend"),
        "scenetruth.design.uncertainty": ("Calibration",),
        "scenetruth.design.optimisation": ("load_design_spec", "DesignSpec"),
        "scenetruth.design.optimisation.report.design_report": ("write_design_page",),
        "scenetruth.design.patterns": (
            "generate_board",
            "export_board",
            "export_pattern",
            "Pattern",
            "PatternRig",
            "PatternAssessment",
        ),
    },
    "export": {"scenetruth": ("export", "export_formats")},
    "testing": {
        "scenetruth.testing": (
            "estimator_checks",
            "EstimatorCheck",
            "check_estimator",
            "ConformanceReport",
            "ConformanceError",
            "assert_accuracy",
            "LimitError",
        )
    },
    "errors": {
        "scenetruth": (
            "ScenetruthError",
            "ArgumentError",
            "DesignSpecError",
            "Problem",
            "SceneError",
            "RecipeError",
            "RecordingError",
            "CaptureError",
            "EstimateError",
            "ScoreError",
            "MismatchError",
            "RenderError",
            "BackendUnavailableError",
            "MachineError",
            "StoreError",
            "OutputExistsError",
            "ExportError",
            "SceneWarning",
            "EstimateWarning",
            "CaptureWarning",
        )
    },
}
"""Pages, each with modules and their public names."""


_FILES = {"Scene": "scene_file/scene", "DesignSpec": "design_specification", "Capture": "capture_file"}
"""Models of files, and the pages that describe their fields."""


def documented_names() -> dict[str, str]:
    """Return the full names of all documented objects by their last part; the first page takes precedence."""
    found: dict[str, str] = {}
    for modules in API.values():
        for module, names in modules.items():
            for name in names:
                found.setdefault(name, f"{module}.{name}")
    return found


def api_in_markdown(page: str) -> str:
    """Return a page of the reference: a table of names for each module, then each name with its docstring.

    Parameters
    ----------
    page
        A key of ``API``.
    """
    return "\n".join(line for module, names in API[page].items() for line in _module(module, names))


def _module(module: str, names: tuple[str, ...]) -> Iterator[str]:
    yield f"## From `{module}`\n"
    yield "```{eval-rst}"
    yield f".. currentmodule:: {module}\n"
    yield ".. autosummary::\n   :nosignatures:\n"
    yield from (f"   {name}" for name in names)
    yield "\n```\n"
    for name in names:
        yield f"### {name}\n"
        yield "```{eval-rst}"
        yield f".. currentmodule:: {module}\n"
        yield from _thing(name, getattr(import_module(module), name))
        yield "```\n"


def _thing(name: str, thing: Any) -> Iterator[str]:
    if inspect.isclass(thing) and issubclass(thing, BaseModel):
        # The signature of a model lists all fields of a file, which separate pages describe.
        page = _FILES.get(name)
        hidden = ["model_config", *(thing.model_fields if page else ())]
        yield f".. autoclass:: {name}(**fields)\n   :members:\n   :member-order: bysource"
        yield f"   :exclude-members: {', '.join(hidden)}\n"
        if page:
            yield f"   Its fields are those of the :doc:`file <../{page}>`.\n"
    elif inspect.isclass(thing):
        word = "autoexception" if issubclass(thing, BaseException) else "autoclass"
        yield f".. {word}:: {name}\n   :members:\n   :member-order: bysource\n"
    else:
        yield f".. {'autofunction' if callable(thing) else 'autodata'}:: {name}\n"
