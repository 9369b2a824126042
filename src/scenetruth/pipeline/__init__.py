"""Pipeline from a scene to a run directory, in stages."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.pipeline.figure_worker import FigureWorker, open_figure_worker
    from scenetruth.pipeline.finished_runs import StrainRun, VerificationResult, export_run, run_strain, verify_run
    from scenetruth.pipeline.precompilation import precompile
    from scenetruth.pipeline.preflight import (
        compute_method_workload,
        compute_recording_workload,
        method_choices,
        run_problems,
    )
    from scenetruth.pipeline.run_directory import MethodPaths, RunDirectory
    from scenetruth.pipeline.runner import PipelineRunner, RunResult, write_estimate
    from scenetruth.pipeline.scene_pipeline import STAGES, RunStage, estimate_run_cost, run_pipeline, run_scene

__all__ = [
    "STAGES",
    "FigureWorker",
    "MethodPaths",
    "PipelineRunner",
    "RunDirectory",
    "RunResult",
    "RunStage",
    "StrainRun",
    "VerificationResult",
    "compute_method_workload",
    "compute_recording_workload",
    "estimate_run_cost",
    "export_run",
    "method_choices",
    "open_figure_worker",
    "precompile",
    "run_pipeline",
    "run_problems",
    "run_scene",
    "run_strain",
    "verify_run",
    "write_estimate",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "figure_worker": "FigureWorker open_figure_worker",
        "finished_runs": "StrainRun VerificationResult export_run run_strain verify_run",
        "precompilation": "precompile",
        "preflight": "compute_method_workload compute_recording_workload method_choices run_problems",
        "run_directory": "MethodPaths RunDirectory",
        "runner": "PipelineRunner RunResult write_estimate",
        "scene_pipeline": "STAGES RunStage estimate_run_cost run_pipeline run_scene",
    },
)
