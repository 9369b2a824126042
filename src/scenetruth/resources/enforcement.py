"""Rejection of scenes that exceed a limit or the resources of the machine, before any work begins."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from scenetruth.errors import MachineError, Problem, SceneError
from scenetruth.resources.cost_estimate import Forecast
from scenetruth.resources.limits import Limits
from scenetruth.resources.quick_preview import preview_with_problems
from scenetruth.resources.system import Machine
from scenetruth.resources.workload import ObjectWorkload, limit_problems, list_object_workloads, object_problems
from scenetruth.scene.built_scene import BuiltScene, build_scene
from scenetruth.scene.scene_loader import Overrides, SceneLike, SceneReading, read_scene
from scenetruth.scene.scene_models import Scene
from scenetruth.scene.scene_report import check_scene, find_problems_of_contents, find_setting_problems

__all__ = [
    "build_checked_scene",
    "find_problems",
    "limited_objects",
    "load_checked_scene",
    "machine_problems",
    "raising_all_problems",
    "read_checked_scene",
    "refuse_beyond_limits",
    "refuse_resources",
]

_GB = 1e9
_HOUR_S = 3600.0


def load_checked_scene(scene: SceneLike, *, overrides: Overrides = (), limits: Limits | None = None) -> Scene:
    """Load a scene as `load_scene` does; the error of an invalid scene also lists the problems of its contents.

    ``limits``: Limits that its contents must meet; None if they are not checked here.
    """
    return read_checked_scene(scene, overrides=overrides, limits=limits).required()


def read_checked_scene(scene: SceneLike, *, overrides: Overrides = (), limits: Limits | None = None) -> SceneReading:
    """Read a scene as `read_scene` does; the problems of an invalid scene include those of its contents."""
    reading = read_scene(scene, overrides=overrides)
    rest = reading.remainder
    if not reading.problems or rest is None:
        return reading
    problems = _joined(reading.problems, find_problems(rest.scene, limits, without=rest.shapeless))
    return replace(reading, problems=tuple(problems))


def build_checked_scene(scene: Scene, *, painted: bool = True) -> BuiltScene:
    """Build a scene for rendering, or raise an error with the problems of all objects and lamps."""
    with raising_all_problems(scene):
        world = build_scene(scene, painted=painted)
        check_scene(scene, world)
    return world


@contextmanager
def raising_all_problems(scene: Scene) -> Iterator[None]:
    """Add all other problems of a scene within its limits to those of an error of the first of several checks."""
    try:
        yield
    except SceneError as error:
        raise SceneError(_joined(error.problems, find_problems(scene, None)), source=error.source) from error


def _joined(first: Sequence[Problem], more: Sequence[Problem]) -> list[Problem]:
    """Return problems, without those of quick checks at paths of the first."""
    paths = {problem.path for problem in first}
    return [*first, *(problem for problem in more if problem.path not in paths)]


def find_problems(
    scene: Scene, limits: Limits | None, folder: Path = Path(), *, without: Collection[str] = ()
) -> list[Problem]:
    """Return all problems of the contents of a scene, from quick checks.

    ``limits``: None if exceeded limits are no problems. ``without``: Paths of objects and plants that are not examined.
    """
    most = limits or Limits()
    beyond = limit_problems(scene, most)
    if beyond:
        # With this many objects, the individual checks are skipped.
        return [*(beyond if limits else ()), *find_setting_problems(scene)]
    parts, wrong = list_object_workloads(scene, folder)
    parts = [part for part in parts if not _is_within(part.path, without)]
    # The file of a texture does not depend on the shape.
    wrong = [each for each in wrong if each.path.endswith(".file") or not _is_within(each.path, without)]
    beyond = object_problems(parts, most)
    parts = [part for part in parts if not object_problems([part], most)]
    found = [*wrong, *(beyond if limits else ())]
    if not parts:
        return _joined(found, find_setting_problems(scene))
    preview, moving = preview_with_problems(scene, parts, folder)
    return _joined(found, [*moving, *find_problems_of_contents(scene, preview.world, preview.times)])


def _is_within(path: str, items: Collection[str]) -> bool:
    """Return whether a path leads into one of several objects or plants."""
    return ".".join(path.split(".")[:2]) in items


def limited_objects(scene: Scene, limits: Limits, folder: Path = Path()) -> list[ObjectWorkload]:
    """Return the objects of a scene with their workloads, or raise if the scene exceeds a limit."""
    found: list[Problem] = limit_problems(scene, limits)
    if not found:
        parts, wrong = list_object_workloads(scene, folder)
        found = [*wrong, *object_problems(parts, limits)]
        if not found:
            return parts
    # Files may have changed since: the first problems are listed in any case.
    raise SceneError(_joined(found, find_problems(scene, limits, folder)))


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
    estimate = f"estimated at about {_format_value(wanted)} {unit}, limit {_format_value(most)} {unit}"
    return Problem(what, f"{estimate}: {remedy}={_up(wanted)}")


def _format_value(value: float) -> str:
    if 0 < value < 1e-3:
        return f"{value:.6f}"
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
