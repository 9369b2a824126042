"""Suggestions for unknown keys and words in scene files: the closest valid key, or its correct location."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

from pydantic import BaseModel

from scenetruth.estimators import MethodChoice, choose
from scenetruth.scene.scene_models import Scene
from scenetruth.validation_problems import kinds_of, listed, models_in, nearest_words, question

__all__ = ["collect_keys", "suggest_key", "suggest_setting"]

_HERE, _ELSEWHERE = 0.6, 0.75
"""Minimum similarity of a suggested word, at the same location and elsewhere (higher, because there are more keys)."""
_MOST = 3  # suggestions of each type

Path = tuple[str, ...]


@dataclass(frozen=True)
class _Place:
    """Location of a mapping in the scene format (path with N for every index) and its model."""

    path: Path
    model: type[BaseModel]
    kind: str
    """Discriminator value of the innermost enclosing union; empty if the location exists in all its members."""


def collect_keys() -> frozenset[str]:
    """Return all keys of scene files, except method settings."""
    return _collect_keys()


def suggest_key(location: Sequence[str | int]) -> str:
    """Return a suggestion for an unknown key, as the end of a message."""
    *around, last = location
    path, models = _place_at(around)
    here = sorted({name for model in models for name in _list_fields(model)})
    key, pattern = str(last), _pattern(path)
    guesses = [f"'{name}'" for name in nearest_words(key, here, _HERE)]
    others = sorted({place.kind for place in _places() if place.path == pattern and key in _list_fields(place.model)})
    if others:
        return f"; it belongs to `kind` {listed(others)}" + (question(guesses) or _list_keys(here))
    elsewhere = _where(key, path)
    if not guesses and not elsewhere:
        elsewhere = [text for name in nearest_words(key, collect_keys(), _ELSEWHERE) for text in _where(name, path)]
    return question(guesses + elsewhere[:_MOST]) or _list_keys(here)


def suggest_setting(name: str) -> str:
    """Return the location of a key that is not a method setting, as the end of a message, or an empty string."""
    belongs = [text for text in _where(name, ("estimate",)) if not text.startswith("'estimate.")]
    return question(belongs[:_MOST])


def _list_keys(here: Sequence[str]) -> str:
    return f"; valid keys: {', '.join(here)}" if here else "; see `scenetruth schema` for valid keys"


def _where(key: str, path: Sequence[str]) -> list[str]:
    """Return the closest paths that end in a key, with the `kind` values if not all members have the key."""
    kinds: dict[Path, set[str]] = {}
    for place in _places():
        if key in _list_fields(place.model):
            kinds.setdefault(place.path, set()).add(place.kind)
    pattern = _pattern(path)
    distances = {other: _distance(pattern, other) for other in kinds}
    least = min(distances.values(), default=0)
    nearest = [other for other in sorted(kinds) if distances[other] == least]
    return [_spelled(other, key, kinds[other], path) for other in nearest]


def _pattern(path: Sequence[str]) -> Path:
    return tuple("N" if re.fullmatch("[0-9]+", part) else part for part in path)


def _distance(one: Path, other: Path) -> int:
    """Return the number of steps between two locations through their common ancestor."""
    return len(one) + len(other) - 2 * _common(one, other)


def _common(one: Path, other: Path) -> int:
    pairs = enumerate(zip(one, other, strict=False))
    return next((index for index, (a, b) in pairs if a != b), min(len(one), len(other)))


def _spelled(place: Path, key: str, kinds: set[str], path: Sequence[str]) -> str:
    if not place:
        return f"'{key}' at the top level"
    shared = _common(place, _pattern(path))
    text = f"'{'.'.join((*path[:shared], *place[shared:], key))}'"
    every = {other.kind for other in _places() if other.path == place}
    return text if kinds == every else f"{text} of `kind` {listed(sorted(kinds))}"


def _place_at(location: Sequence[str | int]) -> tuple[list[str], list[type[BaseModel]]]:
    """Return the path of a location without union members, and the models allowed there."""
    path: list[str] = []
    models: list[type[BaseModel]] = [Scene]
    for part in location:
        if isinstance(part, int):
            path.append(str(part))
            continue
        chosen = [model for model in models if part in (_get_kind(model), model.__name__)]
        if len(models) > 1 and chosen:
            models = chosen
            continue
        inner = [found for model in models if part in _list_fields(model) for _, found in _list_models(model, part)]
        if inner or any(part in _list_fields(model) for model in models):
            path.append(part)
            models = inner
    return path, models


@cache
def _collect_keys() -> frozenset[str]:
    return frozenset(name for place in _places() if place.path != ("estimate",) for name in _list_fields(place.model))


@cache
def _places() -> tuple[_Place, ...]:
    return tuple(dict.fromkeys(_walk(Scene, (), "", ())))


def _walk(model: type[BaseModel], path: Path, kind: str, above: tuple[type[BaseModel], ...]) -> Iterator[_Place]:
    """Yield the location of a model and all locations inside it."""
    yield _Place(path, model, kind)
    for name in _list_fields(model):
        inner = _list_models(model, name)
        several = len({found for _, found in inner}) > 1
        for in_list, found in inner:
            if found not in above:
                place = (*path, name, *(("N",) if in_list else ()))
                yield from _walk(found, place, _get_kind(found) if several else kind, (*above, model))


def _list_fields(model: type[BaseModel]) -> tuple[str, ...]:
    if model is MethodChoice:
        return ("method", *type(choose({}).settings).model_fields)
    return tuple(model.model_fields)


def _list_models(model: type[BaseModel], field: str) -> list[tuple[bool, type[BaseModel]]]:
    """Return the models allowed in a field, and whether in a list."""
    if model is MethodChoice:
        return []
    return list(models_in(model.model_fields[field].annotation))


def _get_kind(model: type[BaseModel]) -> str:
    return next(iter(kinds_of(model)), "")
