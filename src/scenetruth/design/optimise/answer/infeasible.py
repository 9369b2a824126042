"""Goals that cannot be met: which constraint excludes them, and the nearest rig."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from scenetruth.design.optimise.goal.spec import Goal
from scenetruth.design.optimise.parts import Constraint
from scenetruth.design.optimise.problems import GoalError
from scenetruth.design.optimise.rig.evaluate import Evaluation, sorted_by_worth
from scenetruth.design.optimise.words import told_value
from scenetruth.errors import Problem

__all__ = ["refuse_unmet"]


def refuse_unmet(goal: Goal, found: Sequence[Evaluation]) -> None:
    """Refuse a goal that no rig meets.

    Parameters
    ----------
    goal
        The goal.
    found
        All rigs that were tried.

    Raises
    ------
    GoalError
        If none satisfies all constraints: with those that exclude all, and the nearest rig.
    """
    if any(one.holds for one in found):
        return
    made = [one for one in found if one.constraints]
    if not made:
        (problem, count), *_ = Counter(one.problem for one in found).most_common(1)
        raise GoalError([Problem("free", f"none of {len(found):,} rigs can be made; {count:,} of them: {problem}")])
    nearest = sorted_by_worth(made)[0]
    problems = [_told(goal, one, made) for one in nearest.constraints if not one.holds]
    values = ", ".join(f"{name} = {told_value(value)}" for name, value in nearest.values.items())
    if not problems:
        problems.append(Problem("objectives", f"are told of none of {len(made):,} rigs"))
    problems.append(Problem("free", f"the nearest of {len(found):,} rigs that were tried has {values}"))
    raise GoalError(problems)


def _told(goal: Goal, one: Constraint, made: Sequence[Evaluation]) -> Problem:
    """Return how a constraint excludes the nearest rig, and whether it excludes all others too."""
    kinds = [str(getattr(limit, "kind", "")) for limit in goal.constraints]
    path = f"constraints.{kinds.index(one.kind)}" if one.kind in kinds else one.kind
    same = [
        each
        for rig in made
        for each in rig.constraints
        if (each.kind, each.title, each.sense) == (one.kind, one.title, one.sense)
    ]
    holding = sum(each.holds for each in same)
    unit = "" if one.unit == "1" else f" {one.unit}"
    here = f"{one.title} must be {one.sense} {one.limit:.4g}{unit}; the nearest rig has {one.value:.4g}"
    if holding:
        return Problem(path, f"{here}; {holding:,} of {len(same):,} rigs satisfy it, but none of them all the others")
    best = max(same, key=lambda each: each.margin)
    return Problem(path, f"{here}; it excludes all of {len(same):,} rigs, of which the best has {best.value:.4g}")
