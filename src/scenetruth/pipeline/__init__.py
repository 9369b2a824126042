"""From a scene to a folder of results, stage by stage."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenetruth.pipeline.exporting import export_run
    from scenetruth.pipeline.folder import MethodFiles, RunFolder
    from scenetruth.pipeline.helping import FigureHelper, figure_help
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

# The second process starts while the libraries that the stages need are loaded.
_HOMES = {
    "FigureHelper": "helping",
    "MethodFiles": "folder",
    "RunFolder": "folder",
    "RunResults": "runner",
    "Runner": "runner",
    "Verdict": "verifying",
    "effort_of": "requirements",
    "export_run": "exporting",
    "figure_help": "helping",
    "method_choices": "requirements",
    "run_problems": "requirements",
    "verify_folder": "verifying",
    "warm_up": "warming",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        msg = f"module 'scenetruth.pipeline' has no attribute '{name}'"
        raise AttributeError(msg)
    value = getattr(import_module(f"scenetruth.pipeline.{_HOMES.get(name, 'scene_run')}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
