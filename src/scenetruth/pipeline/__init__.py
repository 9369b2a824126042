"""Pipeline from a scene to a run directory, in stages."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenetruth.pipeline.figure_worker import FigureWorker, open_figure_worker
    from scenetruth.pipeline.finished_runs import VerificationResult, export_run, verify_run
    from scenetruth.pipeline.precompilation import precompile
    from scenetruth.pipeline.preflight import compute_method_workload, method_choices, run_problems
    from scenetruth.pipeline.run_directory import MethodPaths, RunDirectory
    from scenetruth.pipeline.runner import PipelineRunner, RunResult
    from scenetruth.pipeline.scene_pipeline import STAGES, RunStage, run_pipeline, run_scene

__all__ = [
    "STAGES",
    "FigureWorker",
    "MethodPaths",
    "PipelineRunner",
    "RunDirectory",
    "RunResult",
    "RunStage",
    "VerificationResult",
    "compute_method_workload",
    "export_run",
    "method_choices",
    "open_figure_worker",
    "precompile",
    "run_pipeline",
    "run_problems",
    "run_scene",
    "verify_run",
]

# The second process starts while the libraries of the stages are loaded.
_HOMES = {
    "FigureWorker": "figure_worker",
    "MethodPaths": "run_directory",
    "RunDirectory": "run_directory",
    "RunResult": "runner",
    "PipelineRunner": "runner",
    "VerificationResult": "finished_runs",
    "compute_method_workload": "preflight",
    "export_run": "finished_runs",
    "open_figure_worker": "figure_worker",
    "method_choices": "preflight",
    "run_problems": "preflight",
    "verify_run": "finished_runs",
    "precompile": "precompilation",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        msg = f"module 'scenetruth.pipeline' has no attribute '{name}'"
        raise AttributeError(msg)
    value = getattr(import_module(f"scenetruth.pipeline.{_HOMES.get(name, 'scene_pipeline')}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
