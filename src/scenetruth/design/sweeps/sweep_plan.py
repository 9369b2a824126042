"""The plan of a sweep: design points and replicates, with all problems reported before any work."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from os import PathLike
from pathlib import Path
from typing import Any

from scenetruth.dataset.distributions import (
    IntegersDistribution,
    LogUniformDistribution,
    RandomDistribution,
    UniformDistribution,
)
from scenetruth.dataset.sampler import UniformDraws
from scenetruth.design.sweeps.factors import Factor, format_level, parse_factors
from scenetruth.errors import ArgumentError, CollectedErrors, Problem, SceneError
from scenetruth.plain_data import seed_problems
from scenetruth.resources import read_checked_scene
from scenetruth.scene import Overrides, Scene, SceneLike
from scenetruth.scene.field_paths import PathError, assign, expand, order_paths, value_at
from scenetruth.scene.scene_loader import part_of

__all__ = ["SweepPlan", "SweepPoint", "build_plan"]


@dataclass(frozen=True)
class SweepPoint:
    """A design point: index of the scene, and levels in the order of the factors."""

    scene: int
    values: tuple[Any, ...]


@dataclass(frozen=True)
class SweepPlan:
    """All simulations of a sweep, numbered by design point and seed."""

    labels: tuple[str, ...]
    plains: tuple[Mapping[str, Any], ...] = field(repr=False)
    factors: tuple[str, ...]
    places: tuple[tuple[tuple[str, ...], ...], ...] = field(repr=False)  # paths without wildcards, by scene and factor
    points: tuple[SweepPoint, ...] = field(repr=False)
    seeds: tuple[tuple[int, ...], ...]  # of each scene
    is_grid: bool = True  # a full grid of levels, without Sobol points
    logarithmic: frozenset[str] = frozenset()  # factors with a logarithmic axis

    def __len__(self) -> int:
        """Return the number of simulations."""
        return len(self.points) * self.each

    @property
    def each(self) -> int:
        """Number of simulations of a point."""
        return len(self.seeds[0])

    def at(self, number: int) -> tuple[SweepPoint, int]:
        """Return the point and the seed of a simulation."""
        place, which = divmod(number, self.each)
        point = self.points[place]
        return point, self.seeds[point.scene][which]

    def is_first(self, number: int) -> bool:
        """Return whether a simulation is the first of its point."""
        return number % self.each == 0

    def scene(self, number: int) -> Scene:
        """Return the scene of a simulation."""
        point, seed = self.at(number)
        return Scene.from_dict({**self.plain(point), "seed": seed})

    def plain(self, point: SweepPoint) -> dict[str, Any]:
        """Return the scene of a point as plain data."""
        found = copy.deepcopy(dict(self.plains[point.scene]))
        factors = zip(self.places[point.scene], point.values, strict=True)
        values = {place: value for places, value in factors for place in places}
        for place in order_paths(values):
            assign(found, place, copy.deepcopy(values[place]))
        return found

    def values(self, point: SweepPoint) -> dict[str, Any]:
        """Return the levels of a point by factor."""
        return dict(zip(self.factors, point.values, strict=True))


MOST_SIMULATIONS = 100_000
"""Largest number of simulations, against input errors: more take over a month on one machine."""
_LARGEST_SEED = 2**63 - 1
_MOST_LISTED = 30
_DIGITS = 6
_NO_EFFECT = ("format", "description", "storage", "seed")
"""Sections of a scene without an effect on any statistic, and the seed, which is the same at every point."""


def build_plan(
    scenes: SceneLike | Sequence[SceneLike],
    vary: Mapping[str, Any],
    seeds: int | Sequence[int] = 3,
    sobol: int = 0,
    *,
    overrides: Overrides = (),
    own_methods: bool = True,
) -> SweepPlan:
    """Return the plan of a sweep; raise `SweepError` with all problems."""
    errors = CollectedErrors()
    labels, bases, wrong_parts = _loaded(scenes, overrides, errors)
    plains = tuple(base.to_dict() for base in bases)
    wrong_seeds = seed_problems(seeds, MOST_SIMULATIONS)
    problems = [*wrong_seeds, *_sobol_problems(sobol)]
    factors, wrong = parse_factors(vary, 0 if _sobol_problems(sobol) else sobol)
    problems += wrong
    placed: list[tuple[Factor, list[tuple[str, ...]]]] = []
    # Factors of parts of scenes with problems are not examined.
    for factor in (each for each in factors if not _is_within(each.path, wrong_parts)):
        places = [_places(plain, factor.path, problems) for plain in plains]
        here = [*_overlaps(factor, places, placed), *_integer_problems(factor, _is_integer(plains, places))]
        problems += here
        if places and all(places) and not here:
            placed.append((factor, places))
    plan = None
    with errors.collect():
        if placed:
            # The valid factors are checked even if others are invalid, so that all problems are reported together.
            some = 1 if wrong_seeds else seeds
            plan = _plan(labels, bases, plains, placed, some, 0 if _sobol_problems(sobol) else sobol)
            problems += [one for one in _find_impossible(plan) if not _is_within(one.path, wrong_parts)]
            if not wrong_parts:
                problems += _find_ineffective(plan, [factor for factor, _ in placed], own_methods)
    with errors.collect():
        if problems:
            raise ArgumentError(_each_once(problems), source="a sweep")
    errors.raise_all()
    assert plan is not None
    return plan


def _is_within(path: str, parts: Collection[str]) -> bool:
    """Return whether a path leads into one of several parts of scenes, or to all of it."""
    return any(f"{path}.".startswith(f"{part}.") or f"{part}.".startswith(f"{path}.") for part in parts)


def _plan(
    labels: tuple[str, ...],
    bases: Sequence[Scene],
    plains: tuple[Mapping[str, Any], ...],
    placed: Sequence[tuple[Factor, list[tuple[str, ...]]]],
    seeds: int | Sequence[int],
    sobol: int,
) -> SweepPlan:
    factors = [factor for factor, _ in placed]
    combinations = _combinations(factors, [_is_integer(plains, places) for _, places in placed], sobol)
    own = _list_seeds(bases, seeds)
    count = len(combinations) * len(bases) * len(own[0])
    if count > MOST_SIMULATIONS:
        message = f"gives {count:,} simulations, more than {MOST_SIMULATIONS:,}; reduce the levels or Sobol points"
        raise ArgumentError([Problem("vary", message)], source="a sweep")
    return SweepPlan(
        labels,
        plains,
        tuple(factor.path for factor in factors),
        tuple(tuple(places[number] for _, places in placed) for number in range(len(bases))),
        tuple(SweepPoint(number, values) for number in range(len(bases)) for values in combinations),
        own,
        not any(factor.is_filled for factor in factors),
        frozenset(factor.path for factor in factors if factor.logarithmic),
    )


def _each_once(problems: Sequence[Problem]) -> list[Problem]:
    """Return the problems without duplicates: several scenes may have the same."""
    return list({(one.path, one.message): one for one in problems}.values())


def _loaded(
    given: SceneLike | Sequence[SceneLike], overrides: Overrides, errors: CollectedErrors
) -> tuple[tuple[str, ...], list[Scene], frozenset[str]]:
    """Return labels and scenes, or the valid parts of scenes, and their parts with problems."""
    several = [given] if isinstance(given, Scene | Mapping | str | PathLike) else list(given)
    names = [Path(one).stem if isinstance(one, str | PathLike) else "" for one in several]
    labels = [
        (str(one) if names.count(name) > 1 else name)
        if name
        else f"scene {number + 1}"
        if len(several) > 1
        else "scene"
        for number, (one, name) in enumerate(zip(several, names, strict=True))
    ]
    with errors.collect():
        twice = sorted({label for label in labels if labels.count(label) > 1})
        problems = [Problem("scenes", "must be unique", label) for label in twice]
        problems += [] if several else [Problem("scenes", "must have at least one scene")]
        if problems:
            raise ArgumentError(problems, source="a sweep")
    kept, scenes, wrong = list[str](), list[Scene](), set[str]()
    for one, label in zip(several, labels, strict=True):
        with errors.collect():
            reading = read_checked_scene(one, overrides=overrides)
            if reading.valid_part is not None:
                kept.append(label)
                scenes.append(reading.valid_part)
            wrong |= {part_of(problem.path) for problem in reading.problems}
            reading.required()
    return tuple(kept), scenes, frozenset(wrong)


def _sobol_problems(sobol: int) -> list[Problem]:
    if isinstance(sobol, int) and not isinstance(sobol, bool) and 0 <= sobol <= MOST_SIMULATIONS:
        return []
    return [Problem("sobol_points", "must be a number of points (0 for none)", sobol)]


def _list_seeds(scenes: Sequence[Scene], seeds: int | Sequence[int]) -> tuple[tuple[int, ...], ...]:
    if isinstance(seeds, int):
        return tuple(tuple((scene.seed + n) % (_LARGEST_SEED + 1) for n in range(seeds)) for scene in scenes)
    return (tuple(seeds),) * len(scenes)


def _places(plain: Mapping[str, Any], path: str, problems: list[Problem]) -> tuple[str, ...]:
    if path == "seed":
        problems.append(Problem("vary.seed", "cannot be varied; specify the seeds with seeds=5 or --seeds 5"))
        return ()
    try:
        return tuple(expand(plain, path))
    except PathError as error:
        problems.append(Problem(f"vary.{path}", str(error).replace(", under 'set'", ", as with --set")))
        return ()


def _overlaps(
    factor: Factor, places: Sequence[tuple[str, ...]], others: Sequence[tuple[Factor, list[tuple[str, ...]]]]
) -> Iterator[Problem]:
    """Yield a problem for each other factor that sets the same fields."""
    for other, theirs in others:
        both = [
            here
            for own, their in zip(places, theirs, strict=True)
            for here in own
            for there in their
            if f"{here}.".startswith(f"{there}.") or f"{there}.".startswith(f"{here}.")
        ]
        if both:
            message = f"overlaps with '{other.path}'; vary only one of the two"
            yield Problem(f"vary.{factor.path}", message)


def _is_integer(plains: Sequence[Mapping[str, Any]], places: Sequence[tuple[str, ...]]) -> bool:
    """Return whether the fields hold integers in all scenes."""
    there = []
    for plain, own in zip(plains, places, strict=True):
        for place in own:
            try:
                there.append(value_at(plain, place))
            except PathError:
                return False
    return bool(there) and all(isinstance(value, int) and not isinstance(value, bool) for value in there)


def _integer_problems(factor: Factor, is_whole: bool) -> Iterator[Problem]:
    """Yield a problem for a range of an integer field with fewer than two integers."""
    if is_whole and factor.ends is not None and math.ceil(factor.ends[0]) >= math.floor(factor.ends[1]):
        shown = "..".join(map(format_level, factor.ends))
        yield Problem(f"vary.{factor.path}", "must contain at least two integers", shown)


def _combinations(factors: Sequence[Factor], whole: Sequence[bool], sobol: int) -> list[tuple[Any, ...]]:
    """Return the levels of all points, in the order of the factors."""
    fills = {
        number: _SobolRange.of(factor, whole=whole[number]) for number, factor in enumerate(factors) if factor.is_filled
    }
    uniforms = UniformDraws(0, max(sobol, 1), {factors[number].path: one.between for number, one in fills.items()})
    found: dict[tuple[str, ...], tuple[Any, ...]] = {}
    for sample in range(sobol if fills else 1):
        drawn = {
            number: (one.value(uniforms.of(factors[number].path, one.between, sample, 0)),)
            for number, one in fills.items()
        }
        axes = [
            drawn[number] if number in drawn else factor.listed(whole=whole[number])
            for number, factor in enumerate(factors)
        ]
        for values in product(*axes):
            found.setdefault(tuple(map(format_level, values)), values)  # integers may be drawn more than once
    return list(found.values())


@dataclass(frozen=True)
class _SobolRange:
    """A range that is sampled by Sobol points."""

    between: RandomDistribution
    whole: bool

    @classmethod
    def of(cls, factor: Factor, *, whole: bool) -> _SobolRange:
        assert factor.ends is not None
        low, high = factor.ends
        if factor.logarithmic:
            return cls(LogUniformDistribution(low=low, high=high, sampling="sobol"), whole)
        if whole:
            return cls(IntegersDistribution(low=math.ceil(low), high=math.floor(high), sampling="sobol"), whole)
        return cls(UniformDistribution(low=low, high=high, sampling="sobol"), whole)

    def value(self, uniforms: Sequence[float]) -> float | int:
        found = self.between.value(uniforms)
        return round(found) if self.whole else float(f"{found:.{_DIGITS}g}")


def _find_impossible(plan: SweepPlan) -> list[Problem]:
    found: dict[tuple[str, str], Problem] = {}
    for point in plan.points:
        try:
            Scene.from_dict(plan.plain(point))
        except SceneError as error:
            for one in error.problems:
                problem = _describe_problem(plan, point, one)
                found.setdefault((problem.path, one.message), problem)
        except PathError as error:
            found.setdefault(("vary", str(error)), Problem("vary", f"{error}; at {_spelled(plan, point)}"))
        if len(found) >= _MOST_LISTED:
            break
    return list(found.values())


def _describe_problem(plan: SweepPlan, point: SweepPoint, problem: Problem) -> Problem:
    """Return a problem of a scene as a problem of the factor that causes it, or with the point."""
    for factor, places in zip(plan.factors, plan.places[point.scene], strict=True):
        if any(f"{problem.path}.".startswith(f"{place}.") for place in places):
            below = problem.path if problem.path not in places or "*" in factor else factor
            return Problem(f"vary.{below}", problem.message, problem.value)
    return Problem(problem.path, f"{problem.message}; at {_spelled(plan, point)}", problem.value)


def _spelled(plan: SweepPlan, point: SweepPoint) -> str:
    text = ", ".join(f"{path} = {format_level(value)}" for path, value in plan.values(point).items())
    return f"{text} of {plan.labels[point.scene]}" if len(plan.labels) > 1 else text


def _find_ineffective(plan: SweepPlan, factors: Sequence[Factor], own_methods: bool) -> Iterator[Problem]:
    """Yield a problem for each factor without an effect on any statistic."""
    ignored = _NO_EFFECT if own_methods else (*_NO_EFFECT, "estimate")
    for number, factor in enumerate(factors):
        try:
            if any(_has_effect(plan, number, factor, scene, ignored) for scene in range(len(plan.labels))):
                continue
        except (SceneError, PathError):
            continue  # the invalid scene is reported already, or no point has this level
        message = "has no effect on any statistic"
        if not own_methods and factor.path.split(".")[0] == "estimate":
            message = "has no effect with given methods; omit them, or specify their settings as NAME[setting: 4]"
        yield Problem(f"vary.{factor.path}", message)


def _has_effect(plan: SweepPlan, number: int, factor: Factor, scene: int, ignored: Sequence[str]) -> bool:
    of_scene = [point for point in plan.points if point.scene == scene]
    others = of_scene[0].values
    first = None
    for value in {format_level(point.values[number]): point.values[number] for point in of_scene}.values():
        point = SweepPoint(scene, (*others[:number], value, *others[number + 1 :]))
        plain = Scene.from_dict(plan.plain(point)).to_dict()
        effect = {name: section for name, section in plain.items() if name not in ignored}
        first = effect if first is None else first
        if effect != first:
            return True
    return False
