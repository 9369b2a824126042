"""Descents from all choices of lens, camera and stage: linear programs within a radius; the promising part goes on.

Objectives and bounded properties of rigs are nearly powers of the continuous variables. Their logarithms are linear
within a part of the range, so that a linear program gives the best rig there, and the constraints that it reaches. It
changes f-number, baseline and interval together, as another lens requires; changes of single parameters keep the first
lens.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.optimisation.design_records import Objective
from scenetruth.design.optimisation.evaluation_log import EvaluationLog
from scenetruth.design.optimisation.rig_evaluation import DesignSpace, Evaluation

__all__ = ["descend_from_choices"]

Array = NDArray[np.float64]
Group = tuple[Any, ...]
Goal = tuple[Objective, ...]

_PHASE = "descents"
_FIRST, _LARGEST, _LEAST = 0.25, 0.5, 0.003  # radii in the unit cube
_PROBE = 0.01
_GROWN, _SHRUNK, _FAILED = 1.5, 0.8, 0.4
_PENALTY = 50.0  # of a violated constraint, per unit of its logarithm: above the slopes of objectives
_MILD_PENALTY = 10.0  # of a violation that a model extrapolates
_INSIDE = 1e-6
_GAIN = 1e-4  # relative improvement of a descent that still moves
_IDLE = 3
_SAMPLED = 0.25  # largest share of the evaluations for choices that were not met twice
_CHOOSING = 0.6  # share of the evaluations of a goal for the selection of choices
_EXPLORED = 4  # steps from further choices, before those near the best go on
_FAR, _NEAR = 1.0, 0.4  # log objectives that such a descent may still gain: before the next goal, and to its end


def _merit(one: Evaluation, goal: Goal) -> float:
    """Return the sum of the log objectives, regardless of the constraints."""
    return sum(math.log(one.predicted[each.title]) if one.predicted[each.title] > 0 else math.inf for each in goal)


def _rank(one: Evaluation, goal: Goal) -> tuple[float, float]:
    return one.excess, _merit(one, goal)


def _is_better(one: Evaluation, other: Evaluation, goal: Goal) -> bool:
    (excess, merit), (former, least) = _rank(one, goal), _rank(other, goal)
    return excess < former or (excess == former and merit < least - _GAIN)


@dataclass
class _Descent:
    """A descent: its best rig, the radius of its next step, steps without improvement, and what its model promises."""

    best: Evaluation
    goal: Goal
    radius: float = _FIRST
    idle: int = 0
    promise: float = math.inf
    fixed: int | None = None  # number of a parameter that does not change

    @property
    def rank(self) -> tuple[float, float]:
        """Violation and merit of the best rig."""
        return _rank(self.best, self.goal)

    @property
    def ended(self) -> bool:
        """Whether further steps gain nothing."""
        return self.radius < _LEAST or self.idle >= _IDLE


def descend_from_choices(
    ledger: EvaluationLog, space: DesignSpace, objectives: Sequence[Objective], count: int, seed: int
) -> bool:
    """Search for the best rigs, for the product of the objectives and for each objective, with up to ``count`` rigs.

    Returns whether the best of all was confirmed for every goal: a descent from a random rig with the same choices,
    and descents with one position more and one less, have not ended at a better rig.
    """
    goals: list[Goal] = [tuple(objectives)]
    goals += [(one,) for one in objectives] if len(objectives) > 1 else []
    search = _Search(ledger, space, len(ledger) + count, np.random.default_rng(seed))
    search.sample_choices(int(_SAMPLED * count))
    confirmed: dict[Goal, float] = {}

    def left() -> list[Goal]:
        return [goal for goal in goals if not search.is_best(goal, confirmed.get(goal))]

    before = -1
    while before < len(ledger):
        before = len(ledger)
        waiting = left()
        for number, goal in enumerate(waiting):
            # The first goal meets the choices, and it may gain from what the others find.
            parts = 2 if number == 0 < len(waiting) - 1 else len(waiting) - number + (goal not in confirmed)
            best = search.descend(goal, len(ledger) + search.room // parts, choosing=goal not in confirmed)
            if best is not None:
                confirmed[goal] = _merit(best, goal)
        if not waiting and not search.explore(goals):
            break
    return not left()


@dataclass
class _Search:
    """Descents with a common number of evaluations, and the choices from which they have started."""

    ledger: EvaluationLog
    space: DesignSpace
    end: int
    generator: np.random.Generator

    def __post_init__(self) -> None:
        self.tried: set[Group] = set()
        free = sum(not one.choices for one in self.space.parameters)
        self.cost = free + 3  # most evaluations of a step

    @property
    def room(self) -> int:
        """Evaluations that are left."""
        return self.end - len(self.ledger)

    def sample_choices(self, count: int) -> None:
        """Evaluate random rigs until every combination of choices, or a random part of them, has two."""
        space, generator = self.space, self.generator
        kinds = [number for number, one in enumerate(space.parameters) if one.choices]
        counts = [space.parameters[number].levels for number in kinds]
        total = math.prod(counts)
        if total <= 1:
            return
        there = Counter(_group(one.values, space) for one in self.ledger.evaluations)
        points: list[list[float]] = []
        for one in generator.permutation(total).tolist():
            entries = dict(zip(kinds, np.unravel_index(one, counts), strict=True))
            chosen = {number: (int(entry) + 0.5) / space.parameters[number].levels for number, entry in entries.items()}
            random = generator.random((2, len(space))).tolist()
            places = [[chosen.get(number, unit) for number, unit in enumerate(place)] for place in random]
            points += places[: max(0, 2 - there[_group(space.values(places[0]), space)])]
            if len(points) >= count:
                break
        self.ledger.ask(points[:count], _PHASE)

    def is_best(self, goal: Goal, merit: float | None) -> bool:
        """Return whether no rig is better than a confirmed one."""
        valid = [one for one in self.ledger.evaluations if not one.problem]
        best = min(valid, key=lambda one: _rank(one, goal), default=None)
        return best is not None and merit is not None and _merit(best, goal) > merit - _GAIN

    def descend(self, goal: Goal, end: int, *, choosing: bool) -> Evaluation | None:
        """Search for the best rig of a goal; return it if it was confirmed."""
        starts = self._starts(goal)
        if not starts:
            return None
        # A third goes on with twice the steps: two rounds cost less than 2 n steps.
        number = max(2, int(_CHOOSING * (end - len(self.ledger)) / (2 * self.cost))) if choosing else 2
        descents = [_Descent(one, goal) for one in starts[:number]]
        steps = 1
        while len(descents) > 2:
            for one in descents:
                for _ in range(steps):
                    self._step(one, end)
            descents = sorted(descents, key=lambda one: one.promise)[: max(2, len(descents) // 3)]
            steps *= 2
        self.tried |= {_group(one.best.values, self.space) for one in descents}
        for one in descents:
            self._finish(one, end)
        best = min(descents, key=lambda one: one.rank).best
        while len(self.ledger) + self.cost < end:
            better = self._neighbour(best, goal, end) or self._restarted(best, goal, end)
            if better is None:
                return best if len(self.ledger) + self.cost < end else None
            best = better
        return None

    def explore(self, goals: Sequence[Goal]) -> bool:
        """Descend from further choices, for every goal, until one is better; return whether one is."""
        best = {goal: self._starts(goal)[0] for goal in goals}
        for start in self._starts(goals[0]):
            group = _group(start.values, self.space)
            if group in self.tried:
                continue
            self.tried.add(group)
            for goal in goals:
                one, least = _Descent(start, goal), _merit(best[goal], goal)
                for _ in range(_EXPLORED):
                    self._step(one, self.end)
                excess, merit = one.rank
                if excess <= best[goal].excess and merit < least + _NEAR * len(goal):
                    self._finish(one, self.end)
                if _is_better(one.best, best[goal], goal):
                    return True
                if excess > 0 or merit > least + _FAR * len(goal):
                    break
        return False

    def _starts(self, goal: Goal) -> list[Evaluation]:
        """Return the best rig of every combination of choices: first those that no constraint excludes."""
        groups: dict[Group, list[Evaluation]] = {}
        for one in self.ledger.evaluations:
            if not one.problem:
                groups.setdefault(_group(one.values, self.space), []).append(one)
        best = {group: min(members, key=lambda one: _rank(one, goal)) for group, members in groups.items()}
        order = sorted(best, key=lambda group: (_fixed_excess(groups[group]), _rank(best[group], goal)))
        return [best[group] for group in order]

    def _finish(self, one: _Descent, end: int) -> None:
        while not one.ended and self._step(one, end):
            pass

    def _neighbour(self, best: Evaluation, goal: Goal, end: int) -> Evaluation | None:
        """Return a better rig with one more or one less of a whole number and all others adapted, if there is one."""
        place = self.space.point(best.values)
        for number, parameter in enumerate(self.space.parameters):
            for side in () if parameter.choices or not parameter.levels else (1, -1):
                unit = place[number] + side / parameter.levels
                if not 0 < unit < 1 or len(self.ledger) >= end:
                    continue
                better = self._descended([*place[:number], unit, *place[number + 1 :]], best, goal, end, number)
                if better is not None:
                    return better
        return None

    def _restarted(self, best: Evaluation, goal: Goal, end: int) -> Evaluation | None:
        """Return a better rig by a descent from a random rig with the same choices, if there is one."""
        random = self.generator.random(len(self.space)).tolist()
        place = zip(self.space.point(best.values), random, self.space.parameters, strict=True)
        return self._descended([unit if one.choices else new for unit, new, one in place], best, goal, end)

    def _descended(
        self, place: Sequence[float], best: Evaluation, goal: Goal, end: int, fixed: int | None = None
    ) -> Evaluation | None:
        (start,) = self.ledger.ask([place], _PHASE)
        one = _Descent(start, goal, fixed=fixed)
        if not start.problem:
            self._finish(one, end)
        return one.best if _is_better(one.best, best, goal) else None

    def _step(self, descent: _Descent, end: int) -> bool:
        """Take a step: slopes from probes, the rig that a linear program proposes, and one that corrects it.

        Returns False, without evaluations, if too few are left for it.
        """
        if descent.ended or len(self.ledger) + self.cost > end:
            return False
        goal, start = descent.goal, descent.best
        model = _LinearModel.of(self.ledger, self.space, descent)
        descent.promise = model.promise()
        ends: list[Evaluation] = []
        proposed = model.proposed(descent.radius)
        if proposed is not None:
            ends = self.ledger.ask([model.moved(proposed), model.moved(proposed, 0.5)], _PHASE)
            first = ends[0]
            if first.excess > 0 and not first.problem and _merit(first, goal) < _merit(start, goal):
                # Constraints are curved: the same step with the violations that it has shown.
                corrected = model.proposed(descent.radius, after=first)
                if corrected is not None:
                    ends += self.ledger.ask([model.moved(corrected)], _PHASE)
        best = min([*model.probed, *ends], key=lambda one: _rank(one, goal), default=start)
        if not _is_better(best, start, goal):
            descent.radius *= _FAILED
            descent.idle += 1
            return True
        is_whole_step = any(best is one for one in (*ends[:1], *ends[2:]))
        descent.best = best
        descent.radius = min(_LARGEST, descent.radius * (_GROWN if is_whole_step else _SHRUNK))
        descent.idle = 0
        return True


def _group(values: Mapping[str, Any], space: DesignSpace) -> Group:
    return tuple(repr(values[one.name]) for one in space.parameters if one.choices)


def _fixed_excess(members: Sequence[Evaluation]) -> float:
    """Return the violation of constraints that only the choices determine: all rigs have the same value."""
    values: dict[str, set[float]] = {}
    margins: dict[str, float] = {}
    for one in members if len(members) > 1 else ():
        for each in one.constraints:
            name = f"{each.title}, {each.sense}"
            values.setdefault(name, set()).add(each.value)
            margins[name] = min(each.margin, 0.0)
    return -sum(margins[name] for name, there in values.items() if len(there) == 1)


@dataclass(frozen=True)
class _LinearModel:
    """Logarithms of the objectives and of the constraints around a rig."""

    space: DesignSpace
    place: Array
    free: tuple[int, ...]  # numbers of the parameters without choices
    probed: tuple[Evaluation, ...]
    slope: Array  # of the merit, by free parameter
    merit: float
    constraints: Mapping[str, float]  # at most 0 if satisfied
    slopes: Array  # of the constraints, shape (constraints, free)

    @classmethod
    def of(cls, ledger: EvaluationLog, space: DesignSpace, descent: _Descent) -> _LinearModel:
        """Return the model around the best rig of a descent, from one probe for each free parameter."""
        start, goal = descent.best, descent.goal
        place = np.array(space.point(start.values))
        free = tuple(n for n, one in enumerate(space.parameters) if not one.choices and n != descent.fixed)
        steps, points = [], []
        for number in free:
            levels = space.parameters[number].levels
            step = 1 / levels if levels else _PROBE
            steps.append(step if place[number] + step < 1 else -step)
            points.append([*place[:number], place[number] + steps[-1], *place[number + 1 :]])
        probed = ledger.ask(points, _PHASE)
        merit, constraints = _merit(start, goal), _excesses(start)
        slope, slopes = np.zeros(len(free)), np.zeros((len(constraints), len(free)))
        for column, (one, step) in enumerate(zip(probed, steps, strict=True)):
            if one.problem:
                continue
            change = _merit(one, goal) - merit
            slope[column] = change / step if math.isfinite(change) else 0.0
            there = _excesses(one)
            slopes[:, column] = [(there.get(name, value) - value) / step for name, value in constraints.items()]
        return cls(space, place, free, tuple(probed), slope, merit, constraints, slopes)

    def proposed(self, radius: float, after: Evaluation | None = None) -> Array | None:
        """Return the best change of the free parameters within a radius; whole numbers change by whole steps.

        ``after``: A rig that shows the constraints at the end of a step.
        """
        offsets = np.array(list(self.constraints.values()))
        if after is not None:
            there = _excesses(after)
            moved = np.array(self.space.point(after.values))[list(self.free)] - self.place[list(self.free)]
            offsets = np.array([there.get(name, value) for name, value in self.constraints.items()])
            offsets = offsets - self.slopes @ moved
        low, high = np.full(len(self.free), -radius), np.full(len(self.free), radius)
        steps = np.array([1 / levels if (levels := self.space.parameters[n].levels) else 0.0 for n in self.free])
        low, high = np.minimum(low, -steps), np.maximum(high, steps)
        place = self.place[list(self.free)]
        low, high = np.maximum(low, steps / 2 - place), np.minimum(high, 1 - steps / 2 - place)
        change = self._solved(offsets, low, high)
        whole = steps > 0
        if change is not None and whole.any():
            low[whole] = high[whole] = np.round(change[whole] / steps[whole]) * steps[whole]
            change = self._solved(offsets, low, high)
        return change

    def _solved(self, offsets: Array, low: Array, high: Array) -> Array | None:
        """Return the solution of the linear program, in which violations of constraints are penalised."""
        from scipy.optimize import linprog

        count = len(offsets)
        found = linprog(
            np.concatenate([self.slope, np.full(count, _PENALTY)]),
            A_ub=np.hstack([self.slopes, -np.eye(count)]) if count else None,
            b_ub=-offsets - _INSIDE if count else None,
            bounds=[*zip(low, high, strict=True), *[(0.0, None)] * count],
            method="highs",
        )
        return np.asarray(found.x[: len(self.free)]) if found.status == 0 else None

    def promise(self) -> float:
        """Return the merit that the model promises within the largest radius, with a penalty for violations."""
        change = self.proposed(_LARGEST)
        if change is None:
            return math.inf
        offsets = np.array(list(self.constraints.values()))
        over = float(np.maximum(offsets + self.slopes @ change, 0.0).sum())
        return self.merit + float(self.slope @ change) + _MILD_PENALTY * over

    def moved(self, change: Array, share: float = 1.0) -> list[float]:
        """Return the place after a share of a change; whole numbers change in whole."""
        place = self.place.copy()
        for number, step in zip(self.free, change.tolist(), strict=True):
            whole = self.space.parameters[number].levels > 0
            place[number] = min(max(place[number] + (step if whole else share * step), 0.0), 1.0)
        return [float(unit) for unit in place]


def _excesses(one: Evaluation) -> dict[str, float]:
    """Return the logarithm of every bounded property over its bound, by constraint: above 0 if violated."""
    found: dict[str, float] = {}
    for each in one.constraints:
        if each.value > 0 and each.limit > 0 and math.isfinite(each.value):
            ratio = math.log(each.value / each.limit)
            found[f"{each.title}, {each.sense}"] = ratio if each.sense == "at most" else -ratio
        elif math.isfinite(each.margin):
            found[f"{each.title}, {each.sense}"] = -each.margin
    return found
