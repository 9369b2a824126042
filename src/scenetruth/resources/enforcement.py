"""Refusal of a scene that exceeds a limit or the resources of the machine, before the work begins."""

from __future__ import annotations

from pathlib import Path

from scenetruth.errors import MachineError, Problem, SceneError
from scenetruth.resources.cost_estimate import Forecast
from scenetruth.resources.limits import Limits
from scenetruth.resources.system import Machine
from scenetruth.resources.workload import ObjectWorkload, limit_problems, list_object_workloads, object_problems
from scenetruth.scene.scene_models import Scene

__all__ = ["limited_objects", "machine_problems", "refuse_beyond_limits", "refuse_resources"]

_GB = 1e9
_HOUR_S = 3600.0


def limited_objects(scene: Scene, limits: Limits, folder: Path = Path()) -> list[ObjectWorkload]:
    """Return the objects of a scene that stays within its bounds, with their sizes."""
    problems = limit_problems(scene, limits)
    if problems:
        # So many objects are not worth looking at one by one.
        raise SceneError(problems)
    parts, wrong = list_object_workloads(scene, folder)
    problems = [*wrong, *object_problems(parts, limits)]
    if problems:
        raise SceneError(problems)
    return parts


def refuse_beyond_limits(scene: Scene, limits: Limits | None = None, folder: Path = Path()) -> None:
    """Refuse a scene that passes its bounds."""
    limited_objects(scene, limits or Limits(), folder)


def machine_problems(forecast: Forecast, machine: Machine, limits: Limits) -> list[Problem]:
    """Return what is foreseen to be more than the machine has, or than may be taken."""
    hungriest = max(forecast.stages, key=lambda name: forecast.stages[name].memory_bytes, default="")
    found = [
        _problem(
            f"memory of {hungriest}",
            forecast.memory_bytes / _GB,
            _most(limits.memory_gb, machine.memory_bytes),
            "GB",
            "make images, meshes or textures smaller, or insist: --limit memory_gb",
        ),
        _problem(
            "disk, with room for maps that pack badly",
            forecast.disk_wanted_bytes / _GB,
            _most(limits.disk_gb, machine.disk_bytes),
            "GB",
            "make images smaller or fewer, store the truth as float32 (storage.truth), or insist: --limit disk_gb",
        ),
        _problem(
            "time",
            forecast.seconds / _HOUR_S,
            limits.hours,
            "hours",
            "make images smaller or fewer, or allow more: --limit hours",
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
        f"about {_format_value(wanted)} {unit} are foreseen, and there are {_format_value(most)}: "
        f"{remedy}={_up(wanted)}",
    )


def _format_value(value: float) -> str:
    return f"{value:.3g}" if value < 100 else f"{value:,.0f}"


def _up(value: float) -> str:
    return f"{float(f'{1.05 * value:.2g}'):g}"


def refuse_resources(forecast: Forecast, machine: Machine, limits: Limits) -> None:
    """Refuse work whose results cannot be written, or that is foreseen to take more than there is or may be taken."""
    problems = machine_problems(forecast, machine, limits)
    if machine.unwritable:
        message = "results cannot be written here: choose another folder, or ask for the right to write in this one"
        problems.insert(0, Problem("output", message, machine.unwritable))
    if problems:
        raise MachineError(problems)
