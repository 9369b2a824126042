"""Whether a recipe can be followed, before the first sample: every end of every range, some draws, what is accepted."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scenetruth.dataset.distributions.base import Derived
from scenetruth.dataset.engine.in_order import in_order
from scenetruth.dataset.recipe.paths import PathError, assign
from scenetruth.dataset.sampler import Draw, Sampler
from scenetruth.errors import Problem, RecipeError, SceneError
from scenetruth.progress import Progress
from scenetruth.scene import scene_from_plain

__all__ = ["Trial", "range_problems", "refuse_recipe", "try_draws"]

_TRIED = 16
"""Draws that are made into scenes before the first sample: what ends of single ranges do not show."""
_MOST_TOLD = 40


@dataclass(frozen=True)
class Trial:
    """What became of some draws.

    Parameters
    ----------
    accepted
        How many samples were accepted.
    drawn
        How many draws that took.
    reasons
        Why draws were refused, and how many.
    problems
        Samples that cannot be drawn.
    """

    accepted: int
    drawn: int
    reasons: Mapping[str, int]
    problems: tuple[Problem, ...] = ()

    def __str__(self) -> str:
        if not self.reasons:
            return f"rejected: none of {self.drawn}"
        rejected = self.drawn - self.accepted
        told = ", ".join(
            f"{reason}" + (f" ({count})" if len(self.reasons) > 1 else "")
            for reason, count in sorted(self.reasons.items(), key=lambda one: (-one[1], one[0]))[:_REASONS]
        )
        more = f", and {len(self.reasons) - _REASONS} more reasons" if len(self.reasons) > _REASONS else ""
        return f"rejected: {rejected} of {self.drawn}: {told}{more}"


_REASONS = 6


def refuse_recipe(sampler: Sampler, *, tried: int = _TRIED) -> None:
    """Refuse a recipe of which single values, or some of the first samples, make no scene.

    Parameters
    ----------
    sampler
        The recipe with its base scenes.
    tried
        How many of the first samples are made into scenes.

    Raises
    ------
    RecipeError
        With every value that a scene's field forbids, and every sample among the first that makes no scene.
    """
    problems = range_problems(sampler) or _first_problems(sampler, tried)
    if problems:
        raise RecipeError(problems)


def range_problems(sampler: Sampler) -> list[Problem]:
    """Return what scenes' fields forbid of what they may be given: both ends of ranges, every choice, every step.

    Parameters
    ----------
    sampler
        The recipe with its base scenes; each value is tried with all others in the middle of their ranges.

    Returns
    -------
    list of Problem
        One for each value that is forbidden, with where it stands in the recipe.
    """
    problems: dict[tuple[str, str], Problem] = {}

    def add(where: str, message: str, value: Any) -> None:
        problems.setdefault((where, message), Problem(where, message, value))

    for number in range(len(sampler.bases)):
        of = f" (in base {number})" if len(sampler.bases) > 1 else ""
        try:
            middle = sampler.middle(number)
            known = {(one.path, one.message) for one in _scene_problems(middle)}
        except SceneError as error:
            for one in error.problems:
                add(one.path, f"{one.message}{of}", one.value)
            continue
        tried = [
            (f"{item.where}.{part}", item.places, value)
            for item in sampler.varied
            if item.places and not isinstance(item.distribution, Derived)
            for part, value in item.distribution.trials()
        ]
        tried += [(f"paired.{path}", places, value) for path, places, value in sampler.ladders]
        told = set[tuple[str, str]]()
        for where, places, value in tried:
            for one in _problems_with(middle, places, value):
                own = any(_is_inside(one.path, place) for place in places)
                if own or (one.path, one.message) not in known:
                    add(where, f"{one.message if one.path in places else f'{one.path}: {one.message}'}{of}", one.value)
                    told.add((one.path, one.message))
        for one in _scene_problems(middle):
            if (one.path, one.message) not in told:
                add(one.path, f"{one.message}, with every value in the middle of its range{of}", one.value)
    return list(problems.values())[:_MOST_TOLD]


def try_draws(
    sampler: Sampler,
    samples: int | Sequence[int],
    progress: Progress | None = None,
    keep: Callable[[Draw], None] | None = None,
    workers: int = 0,
) -> Trial:
    """Draw some samples, and count what is accepted.

    Parameters
    ----------
    sampler
        The recipe with its base scenes.
    samples
        How many of the first samples, or numbers of draws.
    progress
        Called with (what, done, total).
    keep
        Called with every draw that was accepted.
    workers
        Processes that look at the geometry, where bounds ask for it; 0 for this one.
    """
    drawn, reasons, problems = 0, Counter[str](), list[Problem]()
    numbers = range(min(samples, sampler.recipe.samples)) if isinstance(samples, int) else samples
    count = len(numbers)
    # Without bounds a draw takes less time than handing it to a process.
    drawings = in_order(_drawn, sampler, numbers, workers if sampler.recipe.accept else 0)
    for done, (draw, found) in enumerate(zip(numbers, drawings, strict=True)):
        if progress is not None:
            progress("draw", done, count)
        if isinstance(found, RecipeError):
            problems += found.problems
            drawn += sampler.recipe.most_draws
            continue
        if isinstance(found, SceneError):
            problems += [_of_sample(draw, one) for one in found.problems]
            continue
        drawn += found.attempts
        reasons.update(found.rejected)
        if keep is not None:
            keep(found)
    if progress is not None:
        progress("draw", count, count)
    return Trial(count - len(problems), drawn, reasons, tuple(problems[:_MOST_TOLD]))


def _drawn(sampler: Sampler, draw: int) -> Draw | RecipeError | SceneError:
    try:
        return sampler.draw(draw * sampler.recipe.steps)
    except (RecipeError, SceneError) as error:
        return error


def _problems_with(middle: Mapping[str, Any], places: tuple[str, ...], value: Any) -> tuple[Problem, ...]:
    """Return what is wrong with a scene in which some fields have a value."""
    plain = copy.deepcopy(dict(middle))
    try:
        for place in places:
            assign(plain, place, copy.deepcopy(value))
    except PathError as error:
        return (Problem(places[0], str(error), value),)
    return _scene_problems(plain)


def _is_inside(path: str, place: str) -> bool:
    return path == place or path.startswith(f"{place}.")


def _scene_problems(plain: Mapping[str, Any]) -> tuple[Problem, ...]:
    try:
        scene_from_plain(plain)
    except SceneError as error:
        return error.problems
    return ()


def _first_problems(sampler: Sampler, tried: int) -> list[Problem]:
    """Return what is wrong with the scenes of the first samples."""
    problems: list[Problem] = []
    for draw in range(min(tried, sampler.recipe.samples)):
        try:
            for step in range(sampler.recipe.steps):
                sampler.draw(draw * sampler.recipe.steps + step).scene()
        except RecipeError as error:
            # One that cannot be accepted is as good as many.
            return [*problems, *error.problems]
        except SceneError as error:
            problems += [_of_sample(draw, one) for one in error.problems]
    return problems[:_MOST_TOLD]


def _of_sample(draw: int, problem: Problem) -> Problem:
    return Problem(problem.path, f"{problem.message} (in sample {draw})", problem.value)
