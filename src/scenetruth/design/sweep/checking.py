"""What keeps the points of a sweep from being made, told before any work; and what renders them."""

from __future__ import annotations

import json
import pickle
import warnings
from collections.abc import Sequence
from dataclasses import replace

from scenetruth.comparison.contestants import Contestant
from scenetruth.dataset.recipe.paths import assign
from scenetruth.design.sweep.jobs import Job
from scenetruth.design.sweep.least import BOUND
from scenetruth.design.sweep.measure import contestants_of_scene
from scenetruth.design.sweep.plan import Plan
from scenetruth.design.sweep.problems import SweepError
from scenetruth.errors import EstimateError, Problem, SceneError
from scenetruth.progress import Progress

__all__ = ["refuse_methods", "refuse_unmakeable", "with_backends"]

_MOST_TOLD = 20


def refuse_methods(contestants: Sequence[Contestant], workers: int) -> None:
    """Refuse methods that are called as bounds are, and those that other processes cannot be given.

    Parameters
    ----------
    contestants
        The methods.
    workers
        How many other processes there are.

    Raises
    ------
    EstimateError
        With each of them.
    """
    problems = []
    for one in contestants:
        if one.label.split(" ")[0] == BOUND:
            problems.append(Problem("methods", "is what the bound of noise is called; give another label", one.label))
        if not workers:
            continue
        try:
            pickle.dumps(one)
        except Exception as error:  # whatever pickling raises
            message = f"cannot be sent to another process ({error}); give 'module:function', or workers=0"
            problems.append(Problem("methods", message, one.label))
    if problems:
        raise EstimateError(problems)


def with_backends(plan: Plan) -> Plan:
    """Return the plan with scenes that say what renders them, so that every process renders alike."""
    from scenetruth.render import choose_renderer
    from scenetruth.scene.world import build_world

    plains = []
    for number, plain in enumerate(plan.plains):
        own = [place for places in plan.places[number] for place in places]
        if plain["render"]["backend"] == "auto" and not any(f"{place}.".startswith("render.") for place in own):
            changed = json.loads(json.dumps(plain))
            scenes = [plan.scene(place * plan.each) for place, point in enumerate(plan.points) if point.scene == number]
            with choose_renderer(scenes[0], build_world(scenes[0], painted=False)).renderer as renderer:
                name = renderer.name
            if name == "raycast" or any(scene.needs_rays for scene in scenes):
                assign(changed, "render.backend", "raycast")
            else:
                assign(changed, "render.backend", "pyrender")
                assign(changed, "render.platform", name.partition("(")[2].rstrip(")") or "auto")
            plain = changed
        plains.append(plain)
    return replace(plan, plains=tuple(plains))


def refuse_unmakeable(job: Job, numbers: Sequence[int], progress: Progress | None) -> None:
    """Refuse points whose scene passes a bound, shows nothing, or cannot be estimated by a method.

    Parameters
    ----------
    job
        The simulations.
    numbers
        Those that are to be made.
    progress
        Called with (what, done, total).

    Raises
    ------
    SweepError
        With every reason, at the first point that has it.
    """
    from scenetruth.estimators import find_method, requirements, validate_settings
    from scenetruth.provenance import blank_recording
    from scenetruth.resources import refuse_beyond_bounds
    from scenetruth.scene.check import check_scene
    from scenetruth.scene.world import build_world

    plan, problems = job.plan, dict[tuple[str, str], Problem]()
    points = sorted({number - number % plan.each for number in numbers})
    for done, number in enumerate(points):
        if progress is not None:
            progress("checks", done, len(points))
        scene = plan.scene(number)
        where = job.told(number).rpartition(", seed")[0]
        wrong: list[Problem] = []
        try:
            refuse_beyond_bounds(scene, job.limits)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                check_scene(scene, build_world(scene, painted=False))
        except SceneError as error:
            wrong += error.problems
        blank = blank_recording(scene)
        for one in job.contestants or contestants_of_scene(scene):
            method = find_method(one.method)
            wrong += requirements(blank, method, validate_settings(method, one.settings))
        for problem in wrong:
            told = Problem(problem.path, f"{problem.message}; at {where}", problem.value)
            problems.setdefault((problem.path, problem.message), told)
        if len(problems) >= _MOST_TOLD:
            break
    if progress is not None and points:
        progress("checks", len(points), len(points))
    if problems:
        raise SweepError(list(problems.values()))
