"""What limits a rig, in words: constraints that are used up, ends of ranges, and what its errors are made of."""

from __future__ import annotations

from collections.abc import Iterator

from scenetruth.design.optimise.parts import Constraint, Objective
from scenetruth.design.optimise.rig.evaluate import Evaluation
from scenetruth.design.optimise.rig.space import Space

__all__ = ["at_limit", "limits_of"]

_NEAR = 0.03
"""Share of its limit that is left of a constraint that limits."""
_AT_END = 0.01
"""Share of its range that a parameter is from an end that limits."""
_WORDS = {"noise": "the noise of the images", "stage": "the stage's errors", "scan": "motion during a scan"}


def limits_of(one: Evaluation, space: Space, objectives: tuple[Objective, ...]) -> str:
    """Return what limits a rig.

    Parameters
    ----------
    one
        The rig.
    space
        What is free.
    objectives
        What is to be known.
    """
    parts = [*_errors(one, objectives)]
    used = [
        f"{each.title} ({each.value:.4g} of {each.limit:.4g}{'' if each.unit == '1' else f' {each.unit}'})"
        for each in at_limit(one)
    ]
    if used:
        parts.append(f"used up: {', '.join(used)}")
    ends = list(_ends(one, space))
    if ends:
        parts.append(f"at the end of its range: {', '.join(ends)}")
    return "; ".join(parts)


def at_limit(one: Evaluation) -> list[Constraint]:
    """Return the constraints of a rig that leave nothing, the tightest first."""
    near = [each for each in one.constraints if each.margin < _NEAR]
    return sorted(near, key=lambda each: each.margin)


def _errors(one: Evaluation, objectives: tuple[Objective, ...]) -> Iterator[str]:
    for objective in objectives:
        parts = one.parts.get(objective.title, {})
        whole = sum(value * value for value in parts.values())
        if not whole:
            continue
        largest = max(parts, key=lambda name: parts[name])
        share = 100 * parts[largest] ** 2 / whole
        told = _WORDS[largest]
        yield f"{objective.title.lower()} is limited by {told} ({share:.0f} % of the predicted variance)"


def _ends(one: Evaluation, space: Space) -> Iterator[str]:
    for parameter in space.parameters:
        if parameter.choices:
            numbers = [v for v in parameter.choices if isinstance(v, int | float) and not isinstance(v, bool)]
            if len(numbers) == len(parameter.choices) and one.values[parameter.name] in (min(numbers), max(numbers)):
                yield f"{parameter.name} = {one.values[parameter.name]:g}"
            continue
        value = one.values[parameter.name]
        whole_ends = parameter.whole and value in (parameter.rounded(parameter.low), parameter.rounded(parameter.high))
        unit = parameter.unit(value)
        if whole_ends or (not parameter.whole and (unit < _AT_END or unit > 1 - _AT_END)):
            yield f"{parameter.name} = {value:g}"
