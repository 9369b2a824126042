"""Trial draws of a recipe: values that violate constraints of the scene, and counts of rejected draws."""

from __future__ import annotations

import copy
from collections import Counter, deque
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

from scenetruth.dataset.distributions import DerivedDistribution
from scenetruth.dataset.sampler import Draw, Sampler, build_drawn_scene
from scenetruth.errors import Problem, RecipeError, SceneError
from scenetruth.jobs.executors import TaskExecutor, ordered_map
from scenetruth.progress import Progress
from scenetruth.random_streams import generator_for
from scenetruth.scene.field_paths import PathError, assign

__all__ = ["AcceptedDraws", "DrawReport", "draw_samples", "refuse_recipe", "select_numbers", "try_draws"]


_TRIED = 16
"""Number of trial draws before the first sample, for errors that the limits of single ranges do not show."""
_MAX_LISTED = 40


@dataclass(frozen=True)
class DrawReport:
    """Result of trial draws: counts of accepted and of all draws, and of rejections by reason."""

    accepted: int
    drawn: int
    reasons: Mapping[str, int]
    problems: tuple[Problem, ...] = ()

    def __str__(self) -> str:
        if not self.reasons:
            return f"rejected: none of {self.drawn}"
        rejected = self.drawn - self.accepted
        text = ", ".join(
            f"{reason}" + (f" ({count})" if len(self.reasons) > 1 else "")
            for reason, count in sorted(self.reasons.items(), key=lambda one: (-one[1], one[0]))[:_REASONS]
        )
        more = f", and {len(self.reasons) - _REASONS} more reasons" if len(self.reasons) > _REASONS else ""
        return f"rejected: {rejected} of {self.drawn}: {text}{more}"


_REASONS = 6


def refuse_recipe(sampler: Sampler, crew: TaskExecutor | None = None, *, tried: int = _TRIED) -> None:
    """Raise if single values or the first samples of a recipe yield invalid scenes; samples are drawn by ``crew``."""
    problems = range_problems(sampler) or _first_problems(sampler, tried, crew)
    if problems:
        raise RecipeError(problems)


def range_problems(sampler: Sampler) -> list[Problem]:
    """Return the problems of scenes for both limits of ranges, every choice and every step."""
    problems: dict[tuple[str, str], Problem] = {}

    def add(where: str, message: str, value: Any) -> None:
        problems.setdefault((where, message), Problem(where, message, value))

    folder, hidden = sampler.recipe.folder, sampler.unexamined
    for number in range(len(sampler.bases)):
        of = sampler.place_of(number)
        try:
            middle = sampler.middle(number)
            known = {(one.path, one.message) for one in _scene_problems(middle, folder)}
        except SceneError as error:
            for one in error.problems:
                add(one.path, f"{one.message}{of}", one.value)
            continue
        tried = [
            (f"{item.where}.{part}", item.places, value)
            for item in sampler.varied
            if item.places and not isinstance(item.distribution, DerivedDistribution) and sampler.is_examined(item, {})
            for part, value in item.distribution.trials()
        ]
        tried += [(f"paired_factors.{path}", places, value) for path, places, value in sampler.ladders]
        if hidden is not None:
            tried = [each for each in tried if not any(hidden.has(number, place) for place in each[1])]
        entries = set[tuple[str, str]]()
        for where, places, value in tried:
            for one in _problems_with(middle, places, value, folder):
                if hidden is not None and hidden.has(number, one.path):
                    continue
                own = any(_is_inside(one.path, place) for place in places)
                if own or (one.path, one.message) not in known:
                    add(where, f"{one.message if one.path in places else f'{one.path}: {one.message}'}{of}", one.value)
                    entries.add((one.path, one.message))
        for one in _scene_problems(middle, folder):
            if (one.path, one.message) not in entries and not (hidden and hidden.has(number, one.path)):
                add(one.path, f"{one.message}, with every value in the middle of its range{of}", one.value)
    return list(problems.values())[:_MAX_LISTED]


def try_draws(
    sampler: Sampler,
    samples: int | Sequence[int],
    progress: Progress | None = None,
    keep: Callable[[Draw], None] | None = None,
    workers: int = 1,
    scheduler: str | None = None,
) -> DrawReport:
    """Draw samples, and count the accepted samples."""
    drawn, reasons, problems = 0, Counter[str](), list[Problem]()
    numbers = range(min(samples, sampler.recipe.samples)) if isinstance(samples, int) else samples
    count = len(numbers)
    # Without acceptance criteria a draw takes less time than its transfer to a process.
    drawings = ordered_map(_drawn, sampler, numbers, *((workers, scheduler) if sampler.recipe.acceptance else ()))
    for done, (draw, found) in enumerate(zip(numbers, drawings, strict=True)):
        if progress is not None:
            progress("draw", done, count)
        if isinstance(found, RecipeError):
            problems += found.problems
            drawn += sampler.recipe.max_draws
            continue
        if isinstance(found, SceneError):
            problems += [_sample_problems(draw, one) for one in found.problems]
            continue
        drawn += found.attempts
        reasons.update(found.rejected)
        if keep is not None:
            keep(found)
    if progress is not None:
        progress("draw", count, count)
    return DrawReport(count - len(problems), drawn, reasons, tuple(problems[:_MAX_LISTED]))


def _drawn(sampler: Sampler, draw: int) -> Draw | RecipeError | SceneError:
    try:
        return sampler.draw(draw * sampler.recipe.steps)
    except (RecipeError, SceneError) as error:
        return error


def _problems_with(
    middle: Mapping[str, Any], places: tuple[str, ...], value: Any, folder: str | None
) -> tuple[Problem, ...]:
    plain = copy.deepcopy(dict(middle))
    try:
        for place in places:
            assign(plain, place, copy.deepcopy(value))
    except PathError as error:
        return (Problem(places[0], str(error), value),)
    return _scene_problems(plain, folder)


def _is_inside(path: str, place: str) -> bool:
    return path == place or path.startswith(f"{place}.")


def _scene_problems(plain: Mapping[str, Any], folder: str | None) -> tuple[Problem, ...]:
    try:
        build_drawn_scene(plain, folder)
    except SceneError as error:
        return error.problems
    return ()


def _first_problems(sampler: Sampler, tried: int, crew: TaskExecutor | None) -> list[Problem]:
    problems: list[Problem] = []
    with closing(_first_draws(sampler, min(tried, sampler.recipe.samples), crew)) as draws:
        for draw, found in enumerate(draws):
            if isinstance(found, RecipeError):
                # The first sample that cannot be accepted suffices.
                return [*problems, *found.problems]
            if isinstance(found, SceneError):
                problems += [_sample_problems(draw, one) for one in found.problems]
                continue
            sampler.known[draw] = found.rejected
            try:
                for step in range(sampler.recipe.steps):
                    sampler.draw(draw * sampler.recipe.steps + step).scene()
            except SceneError as error:
                problems += [_sample_problems(draw, one) for one in error.problems]
    return problems[:_MAX_LISTED]


def _first_draws(
    sampler: Sampler, count: int, crew: TaskExecutor | None
) -> Generator[Draw | RecipeError | SceneError, None, None]:
    """Yield the first draws in order; without acceptance criteria, a transfer would take longer than a draw."""
    if crew is None or crew.count == 1 or not sampler.recipe.acceptance:
        yield from (_drawn(sampler, draw) for draw in range(count))
        return
    under_way: deque[Future[Draw | RecipeError | SceneError]] = deque()
    try:
        for draw in range(count):
            while len(under_way) < min(crew.count, count - draw):
                under_way.append(crew.submit(_drawn, sampler, draw + len(under_way)))
            try:
                found = under_way.popleft().result()
            except crew.lost:
                # The run itself finds out whether processes can be started.
                found = _drawn(sampler, draw)
            yield found
    finally:
        for future in under_way:
            future.cancel()


def _sample_problems(draw: int, problem: Problem) -> Problem:
    return Problem(problem.path, f"{problem.message} (in sample {draw})", problem.value)


_FREE, _BOUNDED = 500, 48
"""Default number of draws; evaluation of the geometry of a draw takes a thousand times as long as the draw."""


@dataclass(frozen=True)
class AcceptedDraws:
    """Accepted draws by number, and the statistics of the others."""

    trial: DrawReport
    draws: list[Draw] = field(default_factory=list)

    def values(self) -> dict[str, list[object]]:
        """Return the values of all draws by key."""
        keys = self.draws[0].values if self.draws else {}
        return {key: [draw.values[key] for draw in self.draws] for key in keys}


def draw_samples(
    sampler: Sampler,
    count: int | None = None,
    progress: Progress | None = None,
    workers: int = 1,
    scheduler: str | None = None,
) -> AcceptedDraws:
    """Draw samples of a recipe; the selection is reproducible."""
    wanted = count or (_BOUNDED if sampler.recipe.acceptance else _FREE)
    draws: list[Draw] = []
    chosen = select_numbers(sampler.recipe.samples, wanted)
    trial = try_draws(sampler, chosen, progress, draws.append, workers, scheduler)
    return AcceptedDraws(trial, draws)


def select_numbers(total: int, wanted: int) -> list[int]:
    """Return ``wanted`` random sorted numbers below ``total``; a random choice avoids the periods of grids and lists.

    >>> select_numbers(3, 5), select_numbers(10**9, 3) == select_numbers(10**9, 3)
    ([0, 1, 2], True)
    """
    if wanted >= total:
        return list(range(total))
    chosen = generator_for(0, "some", total, wanted)
    found: set[int] = set()
    while len(found) < wanted:
        found.update(chosen.integers(total, size=wanted - len(found)).tolist())
    return sorted(found)
