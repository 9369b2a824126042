"""The plan of a sweep: design points and replicates, with all problems reported before any work."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
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
from scenetruth.errors import ArgumentError, Problem, SceneError
from scenetruth.scene import Overrides, Scene, SceneLike, load_scene
from scenetruth.scene.field_paths import PathError, assign, expand, value_at

__all__ = ["SweepError", "SweepPlan", "SweepPoint", "build_plan"]


class SweepError(ArgumentError):
    """A sweep that cannot be made; lists every problem with its path."""

    _noun = "sweep"


@dataclass(frozen=True)
class SweepPoint:
    """A scene, and the values of all that varies.

    ``scene``: Number of the scene.
    ``values``: The values, in the order of the factors.
    """

    scene: int
    values: tuple[Any, ...]


@dataclass(frozen=True)
class SweepPlan:
    """All simulations of a sweep, each made from its number.

    ``labels``: What the scenes are called.
    ``plains``: The scenes, as plain values.
    ``factors``: Paths of what varies.
    ``places``: Paths of the fields, without wildcards, by scene and factor.
    ``points``: The points.
    ``seeds``: The seeds of each scene.
    ``is_grid``: Whether points are all combinations of values, and none fill ranges.
    ``logarithmic``: Factors that are drawn on a logarithmic scale.
    """

    labels: tuple[str, ...]
    plains: tuple[Mapping[str, Any], ...] = field(repr=False)
    factors: tuple[str, ...]
    places: tuple[tuple[tuple[str, ...], ...], ...] = field(repr=False)
    points: tuple[SweepPoint, ...] = field(repr=False)
    seeds: tuple[tuple[int, ...], ...]
    is_grid: bool = True
    logarithmic: frozenset[str] = frozenset()

    def __len__(self) -> int:
        """Return how many simulations there are."""
        return len(self.points) * self.each

    @property
    def each(self) -> int:
        """How many simulations a point has."""
        return len(self.seeds[0])

    def at(self, number: int) -> tuple[SweepPoint, int]:
        """Return the point of a simulation, and its seed."""
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
        """Return the scene of a point as plain values."""
        found = copy.deepcopy(dict(self.plains[point.scene]))
        for places, value in zip(self.places[point.scene], point.values, strict=True):
            for place in places:
                assign(found, place, copy.deepcopy(value))
        return found

    def values(self, point: SweepPoint) -> dict[str, Any]:
        """Return the values of a point by what varies."""
        return dict(zip(self.factors, point.values, strict=True))


MOST_SIMULATIONS = 100_000
"""More simulations than any machine makes in a month are a slip of the pen."""
_LARGEST_SEED = 2**63 - 1
_MOST_LISTED = 30
_DIGITS = 6
_NO_EFFECT = ("format", "description", "storage", "seed")
"""Sections of a scene on which no figure depends, and the seed, which is the same at every point."""


def build_plan(
    scenes: SceneLike | Sequence[SceneLike],
    vary: Mapping[str, Any],
    seeds: int | Sequence[int] = 3,
    sobol: int = 0,
    *,
    overrides: Overrides = (),
    own_methods: bool = True,
) -> SweepPlan:
    """Return all simulations of a sweep."""
    labels, bases = _loaded(scenes, overrides)
    plains = tuple(base.to_dict() for base in bases)
    wrong_seeds = list(_seed_problems(seeds))
    problems = [*wrong_seeds, *_sobol_problems(sobol)]
    factors, wrong = parse_factors(vary, 0 if _sobol_problems(sobol) else sobol)
    problems += wrong
    placed: list[tuple[Factor, list[tuple[str, ...]]]] = []
    for factor in factors:
        places = [_places(plain, factor.path, problems) for plain in plains]
        here = [*_overlaps(factor, places, placed), *_integer_problems(factor, _is_integer(plains, places))]
        problems += here
        if all(places) and not here:
            placed.append((factor, places))
    plan = None
    if placed:
        # What can be varied is tried, whatever is wrong with the rest: all is told at once.
        plan = _plan(labels, bases, plains, placed, 1 if wrong_seeds else seeds, 0 if _sobol_problems(sobol) else sobol)
        problems += [*_find_impossible(plan), *_find_ineffective(plan, [factor for factor, _ in placed], own_methods)]
    if problems or plan is None:
        raise SweepError(_each_once(problems))
    return plan


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
        message = f"makes {count:,} simulations, more than {MOST_SIMULATIONS:,}: fewer values, or sobol points"
        raise SweepError([Problem("vary", message)])
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
    """Return problems, each once: several scenes may have the same."""
    return list({(one.path, one.message): one for one in problems}.values())


def _loaded(given: SceneLike | Sequence[SceneLike], overrides: Overrides) -> tuple[tuple[str, ...], list[Scene]]:
    """Return the scenes, with what they are called."""
    several = [given] if isinstance(given, Scene | Mapping | str | PathLike) else list(given)
    if not several:
        raise SweepError([Problem("scenes", "at least one scene is needed")])
    scenes: list[Scene] = []
    failed: list[SceneError] = []
    for one in several:
        try:
            scenes.append(load_scene(one, overrides=overrides))
        except SceneError as error:
            failed.append(error)
    if len(failed) == 1:
        raise failed[0]
    if failed:
        raise SceneError(
            [
                Problem(f"{error.source or 'scene'}: {one.path or '(top level)'}", one.message, one.value)
                for error in failed
                for one in error.problems
            ]
        )
    names = [Path(one).stem if isinstance(one, str | PathLike) else "" for one in several]
    labels = [
        (str(one) if names.count(name) > 1 else name)
        if name
        else f"scene {number + 1}"
        if len(several) > 1
        else "scene"
        for number, (one, name) in enumerate(zip(several, names, strict=True))
    ]
    twice = sorted({label for label in labels if labels.count(label) > 1})
    if twice:
        raise SweepError([Problem("scenes", "is there twice", label) for label in twice])
    return tuple(labels), scenes


def _seed_problems(seeds: int | Sequence[int]) -> Iterator[Problem]:
    if isinstance(seeds, int) and not isinstance(seeds, bool):
        if not 1 <= seeds <= MOST_SIMULATIONS:
            yield Problem("seeds", "must be at least 1: how many, or a list of them", seeds)
        return
    if not isinstance(seeds, Sequence) or isinstance(seeds, str) or not len(seeds):
        yield Problem("seeds", "must be a number of seeds, or a list of them", seeds)
    elif not all(isinstance(seed, int) and 0 <= seed <= _LARGEST_SEED for seed in seeds):
        yield Problem("seeds", "must be whole numbers from 0 on", list(seeds))
    elif len(set(seeds)) < len(seeds):
        yield Problem("seeds", "are there twice: the same seed makes the same images", list(seeds))


def _sobol_problems(sobol: int) -> list[Problem]:
    if isinstance(sobol, int) and not isinstance(sobol, bool) and 0 <= sobol <= MOST_SIMULATIONS:
        return []
    return [Problem("sobol", "must be a number of points, or 0 for none", sobol)]


def _list_seeds(scenes: Sequence[Scene], seeds: int | Sequence[int]) -> tuple[tuple[int, ...], ...]:
    if isinstance(seeds, int):
        return tuple(tuple((scene.seed + n) % (_LARGEST_SEED + 1) for n in range(seeds)) for scene in scenes)
    return (tuple(seeds),) * len(scenes)


def _places(plain: Mapping[str, Any], path: str, problems: list[Problem]) -> tuple[str, ...]:
    if path == "seed":
        problems.append(Problem("vary.seed", "is what seeds are for: give seeds=5, or --seeds 5"))
        return ()
    try:
        return tuple(expand(plain, path))
    except PathError as error:
        problems.append(Problem(f"vary.{path}", str(error).replace(", under 'set'", ", as with --set")))
        return ()


def _overlaps(
    factor: Factor, places: Sequence[tuple[str, ...]], others: Sequence[tuple[Factor, list[tuple[str, ...]]]]
) -> Iterator[Problem]:
    """Tell which factors set the same fields."""
    for other, theirs in others:
        both = [
            here
            for own, their in zip(places, theirs, strict=True)
            for here in own
            for there in their
            if f"{here}.".startswith(f"{there}.") or f"{there}.".startswith(f"{here}.")
        ]
        if both:
            message = f"sets what '{other.path}' sets, or a part of it: vary one of them"
            yield Problem(f"vary.{factor.path}", message)


def _is_integer(plains: Sequence[Mapping[str, Any]], places: Sequence[tuple[str, ...]]) -> bool:
    """Return whether fields hold whole numbers, as far as the scenes tell."""
    there = []
    for plain, own in zip(plains, places, strict=True):
        for place in own:
            try:
                there.append(value_at(plain, place))
            except PathError:
                return False
    return bool(there) and all(isinstance(value, int) and not isinstance(value, bool) for value in there)


def _integer_problems(factor: Factor, is_whole: bool) -> Iterator[Problem]:
    """Tell of a range of whole numbers that holds fewer than two."""
    if is_whole and factor.ends is not None and math.ceil(factor.ends[0]) >= math.floor(factor.ends[1]):
        shown = "..".join(map(format_level, factor.ends))
        yield Problem(f"vary.{factor.path}", "takes whole numbers, of which there are not two", shown)


def _combinations(factors: Sequence[Factor], whole: Sequence[bool], sobol: int) -> list[tuple[Any, ...]]:
    """Return the values of all points, in the order of the factors."""
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
            # Whole numbers may be drawn again.
            found.setdefault(tuple(map(format_level, values)), values)
    return list(found.values())


@dataclass(frozen=True)
class _SobolRange:
    """A range that Sobol's points fill."""

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
    """Return why points make no scenes, each reason once."""
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
    """Return a problem of a scene as one of what varies."""
    for factor, places in zip(plan.factors, plan.places[point.scene], strict=True):
        if any(f"{problem.path}.".startswith(f"{place}.") for place in places):
            below = problem.path if problem.path not in places or "*" in factor else factor
            return Problem(f"vary.{below}", problem.message, problem.value)
    return Problem(problem.path, f"{problem.message}; at {_spelled(plan, point)}", problem.value)


def _spelled(plan: SweepPlan, point: SweepPoint) -> str:
    told = ", ".join(f"{path} = {format_level(value)}" for path, value in plan.values(point).items())
    return f"{told} of {plan.labels[point.scene]}" if len(plan.labels) > 1 else told


def _find_ineffective(plan: SweepPlan, factors: Sequence[Factor], own_methods: bool) -> Iterator[Problem]:
    """Tell which factors no figure depends on."""
    ignored = _NO_EFFECT if own_methods else (*_NO_EFFECT, "estimate")
    for number, factor in enumerate(factors):
        try:
            if any(_has_effect(plan, number, factor, scene, ignored) for scene in range(len(plan.labels))):
                continue
        except (SceneError, PathError):
            # That this is no scene is told already, or no point has this value.
            continue
        message = "varies nothing: no figure depends on it"
        if not own_methods and factor.path.split(".")[0] == "estimate":
            message = "varies nothing: methods are given; leave them out, or give their settings as NAME[setting: 4]"
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
