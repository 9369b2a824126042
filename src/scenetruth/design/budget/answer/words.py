"""What limits a measurement and what helps most, in sentences with numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from scenetruth.design.budget.cause import Remedy
from scenetruth.design.budget.confirm.errors import GROWTH
from scenetruth.design.budget.parts import Part, Total, sorted_parts
from scenetruth.scoring.quantities import title_of

__all__ = ["number", "unit_words", "words_of"]

_UNITS = {"mm/frame": "mm per frame", "px/step": "px per step", "%/h": "% per hour"}
# A cause whose share of the sum of squares is less is not worth a sentence.
_WORTH_NAMING = 0.02
# Where the parts and the whole differ by more, they are no sum.
_AGREE = 0.2


def number(value: float) -> str:
    """Spell a number with two digits, without a power of ten where it is readable without."""
    if not math.isfinite(value):
        return "–"
    if value == 0 or 1e-4 <= abs(value) < 1e5:
        return f"{float(f'{value:.1e}'):.10g}" if abs(value) < 1e2 else f"{value:.0f}"
    return f"{value:.1e}"


def unit_words(unit: str) -> str:
    """Return a unit as people say it."""
    return _UNITS.get(unit, unit)


def words_of(parts: Sequence[Part], totals: Sequence[Total], remedies: Mapping[str, Remedy], region: str) -> list[str]:
    """Return what is to be said of each quantity: the error, the largest part, what helps, and what limits then.

    Parameters
    ----------
    parts, totals, remedies
        Those of a budget.
    region
        Where.
    """
    return [
        _of_quantity(sorted_parts(parts, one.quantity, region), one, remedies)
        for one in totals
        # The disparity is the depth again.
        if one.region == region and one.quantity != "disparity"
    ]


def _of_quantity(everything: Sequence[Part], total: Total, remedies: Mapping[str, Remedy]) -> str:
    quantity, parts = total.quantity, _known(everything)
    unit, title = unit_words(total.unit), title_of(quantity)
    if quantity == GROWTH:
        title = "Growth"
    if not math.isfinite(total.simulated):
        head = f"{title}: with everything on, nothing is told; the parts add up to {number(total.parts)} {unit}."
    else:
        head = f"{title}: {number(total.figure)} {unit} in all"
        head += (
            f", of a true {number(total.signal)} {unit}."
            if quantity != "depth" and total.signal > _NOTHING * total.figure
            else "."
        )
    if not parts:
        return head
    sentences = [head, *_largest(parts, total)]
    helped = _helped(parts, total, remedies)
    sentences += [helped] if helped else []
    if math.isfinite(total.simulated) and abs(total.parts - total.simulated) > _AGREE * total.simulated:
        text = f"The parts' squares add up to {number(total.parts)} {unit}"
        if math.isfinite(total.added) and abs(total.added - total.simulated) < _AGREE * total.simulated:
            text += f", but biases have signs: added up pixel by pixel, they make {number(total.added)}."
        elif not math.isfinite(parts[0].simulated):
            text += ", and the largest is predicted alone: confirm=1 (--confirm 1) simulates it too."
        else:
            text += ": together, causes do more or less than alone."
        sentences.append(text)
    silent = [one for one in everything if one.seen < _SEEN]
    sentences += [f"With {one.title}, {100 * one.seen:.0f} % of the pixels are still told." for one in silent]
    return " ".join(sentences)


_SEEN = 0.9
# Less than this share of its error is no motion or growth at all.
_NOTHING = 1e-3


def _known(parts: Sequence[Part]) -> list[Part]:
    return [one for one in parts if math.isfinite(one.figure) and one.figure > 0]


def _largest(parts: list[Part], total: Total) -> list[str]:
    whole = sum(one.figure**2 for one in parts)
    first, *others = parts
    size = f" ({first.size})" if first.size else ""
    sure = "" if math.isfinite(first.simulated) or first.cause in _OF_IDEAL else ", as predicted"
    text = f"{_capital(first.title)}{size} makes {number(first.figure)} of it{sure}"
    if first.cause in _PLURAL:
        text = text.replace(" makes ", " make ", 1)
    if math.isfinite(first.drawn) and not 1 / _BY_CHANCE < first.predicted / first.figure < _BY_CHANCE:
        text += f" in these draws, and {number(first.predicted)} is to be expected of others"
    named = [one for one in others[:2] if one.figure**2 > _WORTH_NAMING * whole]
    if named:
        text += "; then " + ", ".join(f"{one.title} {number(one.figure)}" for one in named)
    return [text + "."]


_OF_IDEAL = ("slope", "curvature", "edges", "rest")
_PLURAL = ("slope", "curvature", "edges")
# What few draws make differs from what many make by more than this only by chance.
_BY_CHANCE = 1.5


def _helped(parts: list[Part], total: Total, remedies: Mapping[str, Remedy]) -> str:
    """Say what the remedy of the largest part does, and what limits then."""
    first = parts[0]
    remedy = remedies.get(first.cause)
    if remedy is None or not remedy.factors:
        return ""
    left = {one.cause: one.figure * remedy.factors.get(one.cause, 1.0) for one in parts}
    after = math.sqrt(sum(value**2 for value in left.values()))
    # Where the parts are no sum, they say by which share it is less.
    after *= total.figure / math.sqrt(sum(one.figure**2 for one in parts))
    limits = max(left, key=lambda cause: left[cause])
    unit = unit_words(total.unit)
    text = f"{_capital(remedy.words)} brings it to {number(after)} {unit}"
    if limits == first.cause:
        return text + "; it limits still."
    title = next(one.title for one in parts if one.cause == limits)
    limit = "limit" if limits in _PLURAL else "limits"
    return f"{text}; then {title} {limit} ({number(left[limits])})."


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
