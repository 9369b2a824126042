"""Rejection of scenes that exceed a limit or the resources of the machine, before any work begins."""

from __future__ import annotations

from pathlib import Path

from scenetruth.errors import MachineError, Problem, SceneError
from scenetruth.resources.cost_estimate import Forecast
from scenetruth.resources.limits import Limits
from scenetruth.resources.system import Machine
from scenetruth.resources.workload import ObjectWorkload, limit_problems, list_object_workloads, object_problems
from scenetruth.scene.scene_models import Scene
from scenetruth.scene.scene_report import find_setting_problems

__all__ = ["limited_objects", "machine_problems", "refuse_beyond_limits", "refuse_resources"]

_GB = 1e9
_HOUR_S = 3600.0


def limited_objects(scene: Scene, limits: Limits, folder: Path = Path()) -> list[ObjectWorkload]:
    """Return the objects of a scene with their workloads, or raise if the scene exceeds a limit."""
    problems = limit_problems(scene, limits)
    if problems:
        # With this many objects, the individual checks are skipped.
        raise SceneError(problems)
    parts, wrong = list_object_workloads(scene, folder)
    problems = [*wrong, *object_problems(parts, limits)]
    if problems:
        raise SceneError([*problems, *find_setting_problems(scene)])
    return parts


def refuse_beyond_limits(scene: Scene, limits: Limits | None = None, folder: Path = Path()) -> None:
    """Raise an exception if a scene exceeds a limit."""
    limited_objects(scene, limits or Limits(), folder)


def machine_problems(forecast: Forecast, machine: Machine, limits: Limits) -> list[Problem]:
    """Return problems where the estimated cost exceeds the resources of the machine or a limit."""
    hungriest = max(forecast.stages, key=lambda name: forecast.stages[name].memory_bytes, default="")
    found = [
        _problem(
            f"memory of {hungriest}",
            forecast.memory_bytes / _GB,
            _most(limits.memory_gb, machine.memory_bytes),
            "GB",
            "reduce the size of images, meshes or textures, or set --limit memory_gb",
        ),
        _problem(
            "disk space, with a margin for compression",
            forecast.disk_wanted_bytes / _GB,
            _most(limits.disk_gb, machine.disk_bytes),
            "GB",
            "reduce the size or number of images, store the truth as float32 (storage.truth), or set --limit disk_gb",
        ),
        _problem(
            "time",
            forecast.seconds / _HOUR_S,
            limits.hours,
            "hours",
            "reduce the size or number of images, or set --limit hours",
        ),
    ]
    return [problem for problem in found if problem is not None]


def _most(given: float | None, there: int | None) -> float | None:
    if given is not None:
        return given
    return None if there is None else there / _GB


def _problem(what: str, wanted: float, most: float | None, unit: str, remedy: str) -> Problem | None:
    if most is None or wanted <= most:
        return None
    return Problem(
        what,
        f"estimated at about {_format_value(wanted)} {unit}, limit {_format_value(most)}: {remedy}={_up(wanted)}",
    )


def _format_value(value: float) -> str:
    return f"{value:.3g}" if value < 100 else f"{value:,.0f}"


def _up(value: float) -> str:
    return f"{float(f'{1.05 * value:.2g}'):g}"


def refuse_resources(forecast: Forecast, machine: Machine, limits: Limits) -> None:
    """Raise an exception if the output is not writable or the estimated cost exceeds a limit."""
    problems = machine_problems(forecast, machine, limits)
    if machine.unwritable:
        message = "results cannot be written here: choose another directory, or obtain write permission for this one"
        problems.insert(0, Problem("output", message, machine.unwritable))
    if problems:
        raise MachineError(problems)
