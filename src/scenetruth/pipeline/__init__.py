"""From a scene to a folder of results, stage by stage."""

from scenetruth.pipeline.exporting import export_run
from scenetruth.pipeline.figure_help import FigureHelper, figure_help
from scenetruth.pipeline.folder import MethodFiles, RunFolder
from scenetruth.pipeline.requirements import effort_of, method_choices, run_problems
from scenetruth.pipeline.runner import Runner, RunResults
from scenetruth.pipeline.scene_run import STAGES, Stage, run_scene
from scenetruth.pipeline.verifying import Verdict, verify_folder
from scenetruth.pipeline.warming import warm_up

__all__ = [
    "STAGES",
    "FigureHelper",
    "MethodFiles",
    "RunFolder",
    "RunResults",
    "Runner",
    "Stage",
    "Verdict",
    "effort_of",
    "export_run",
    "figure_help",
    "method_choices",
    "run_problems",
    "run_scene",
    "verify_folder",
    "warm_up",
]
