"""Drawn values as charts need them: numbers with units, or categories."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scenetruth.dataset.pages.labels import bracketed, label_of, split_unit
from scenetruth.dataset.sampler import Sampler

__all__ = ["Quantity", "drawn_quantities", "quantities_of"]

_MOST_CATEGORIES = 12
_LONGEST = 40
_AXES = ("X", "Y", "Z")


@dataclass(frozen=True)
class Quantity:
    """Something that varies, with its values.

    Parameters
    ----------
    title
        What it is.
    unit
        Its unit; empty for none.
    numbers
        Its values; empty if they are no numbers.
    counts
        How often each value occurs, of what is no number.
    log
        Whether its logarithm is what is spread evenly.
    """

    title: str
    unit: str = ""
    numbers: tuple[float, ...] = ()
    counts: tuple[tuple[str, int], ...] = ()
    log: bool = False

    @property
    def label(self) -> str:
        """Title and unit."""
        return bracketed(self.title, self.unit)

    @property
    def is_constant(self) -> bool:
        """Whether all values are alike."""
        return len(self.counts) == 1 or (bool(self.numbers) and min(self.numbers) == max(self.numbers))


def drawn_quantities(sampler: Sampler, drawn: Mapping[str, Sequence[Any]]) -> list[Quantity]:
    """Return what a recipe varies, with the values that were drawn.

    Parameters
    ----------
    sampler
        The recipe.
    drawn
        Values by key; what was not drawn is None.
    """
    plain = sampler.bases[0].to_plain()
    found: list[Quantity] = []
    for item in sampler.varied:
        values = [value for value in drawn.get(item.key, ()) if value is not None]
        if values:
            title, unit = label_of(item.key, plain)
            kind = getattr(item.distribution, "kind", "")
            found += quantities_of(title, unit, values, log=kind == "log_uniform")
    return found


def quantities_of(title: str, unit: str, values: Sequence[Any], *, log: bool = False) -> list[Quantity]:
    """Return values as one quantity, or, of lists and mappings of numbers, as one for each number.

    Parameters
    ----------
    title, unit
        What they are.
    values
        The values, at least one.
    log
        Whether their logarithms are what is spread evenly.

    Examples
    --------
    >>> quantities_of("shape", "", ["oval", "round", "oval"])[0].counts
    (('oval', 2), ('round', 1))
    >>> turns = [[{"axis": [0.0, 0.0, 1.0], "angle_deg": float(n)}] for n in range(20)]
    >>> [found.label for found in quantities_of("rotations", "", turns)]
    ['rotations axis X', 'rotations axis Y', 'rotations axis Z', 'rotations angle [°]']
    """
    if all(_is_number(value) for value in values):
        numbers = tuple(float(value) for value in values)
        return [Quantity(title, unit, numbers, log=log and min(numbers) > 0)]
    texts = [json.dumps(value, sort_keys=True) for value in values]
    if len(set(texts)) > _MOST_CATEGORIES:
        split = [dict(_leaves(value, "", unit)) for value in values]
        names = list(split[0])
        if names and all(list(one) == names for one in split):
            return [
                Quantity(f"{title} {name}".strip(), own, tuple(one[name, own] for one in split)) for name, own in names
            ]
    return [Quantity(title, unit, counts=tuple(_counted(values, texts)))]


def _leaves(value: Any, name: str, unit: str) -> Iterator[tuple[tuple[str, str], float]]:
    """Yield the numbers in a value with their names and units; of what else is in it, none."""
    if _is_number(value):
        yield (name, unit), float(value)
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            told, own = split_unit(str(key))
            yield from _leaves(entry, f"{name} {told}".strip(), own or unit)
    elif isinstance(value, list | tuple):
        axes = len(value) == len(_AXES) and all(_is_number(entry) for entry in value)
        for index, entry in enumerate(value):
            told = _AXES[index] if axes else f"({index})" if len(value) > 1 else ""
            yield from _leaves(entry, f"{name} {told}".strip(), unit)


def _counted(values: Sequence[Any], texts: Sequence[str]) -> Iterator[tuple[str, int]]:
    """Yield categories with their counts: the most frequent first, what is alike by name."""
    by_text = dict(zip(texts, values, strict=True))
    short = {text: _short(value) for text, value in by_text.items()}
    if len(set(short.values())) < len(short):
        short = {text: _cut(text) for text in short}
    counts = sorted(Counter(texts).items(), key=lambda one: (-one[1], one[0]))
    kept = counts if len(counts) <= _MOST_CATEGORIES else counts[: _MOST_CATEGORIES - 1]
    yield from ((short[text], count) for text, count in kept)
    if len(kept) < len(counts):
        rest = counts[len(kept) :]
        yield f"{len(rest):,} others", sum(count for _, count in rest)


def _short(value: Any) -> str:
    if isinstance(value, Mapping) and isinstance(value.get("kind"), str):
        return _cut(value["kind"])
    return _cut(value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
