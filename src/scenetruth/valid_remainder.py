"""Valid remainder of invalid input, which shows the problems that its errors would hide."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from scenetruth.errors import CaptureError, Problem, RecipeError
from scenetruth.validation_problems import Words, keys_in, list_problems

__all__ = ["FieldRepair", "Keys", "Reading", "Repair", "copied", "find_hidden_errors", "is_item", "read_model"]

Keys = Sequence[str]
"""Path as keys of mappings and indices of lists."""
M = TypeVar("M", bound=BaseModel)

_MOST_ROUNDS = 6  # validations of one input; each repairs all of its errors


class Repair:
    """Values of an input, in which fields with errors are removed or replaced.

    ``done``: Errors that are repaired, as the type of each and its path in the input.
    """

    def __init__(self, plain: Mapping[str, Any]) -> None:
        self.plain: dict[str, Any] = copied(plain)
        self.done: set[tuple[str, ...]] = set()

    def given(self, keys: Keys) -> tuple[str, ...]:
        """Return the path that a path of the values has in the input."""
        return tuple(keys)

    def apply(self, keys: Keys, error: str) -> None:
        """Remove or replace a field of the input with an error, and the fields whose check depends on it."""
        raise NotImplementedError

    def is_shown(self, keys: Keys, error: str) -> bool:
        """Return whether an error that follows a repair is one of the input, given its path there."""
        raise NotImplementedError


def find_hidden_errors(
    repair: Repair,
    error: ValidationError,
    validate: Callable[[Mapping[str, Any]], M],
    keys_of: Callable[[Mapping[str, Any], ErrorDetails], list[str]],
) -> tuple[M | None, list[tuple[Mapping[str, Any], list[ErrorDetails]]]]:
    """Return the valid remainder of an input, None if there is none, and the errors that become visible with it.

    ``keys_of``: Returns the path of an error in the values. The errors are listed with the values in which they are.
    """
    found: list[tuple[Mapping[str, Any], list[ErrorDetails]]] = []
    entries = error.errors(include_url=False)

    def given(entry: ErrorDetails) -> tuple[str, ...]:
        return repair.given(keys_of(repair.plain, entry))

    for _ in range(_MOST_ROUNDS):
        before = repair.done.copy()
        # Repairs shift the indices of lists.
        for keys, kind in [(given(each), each["type"]) for each in entries]:
            repair.apply(keys, kind)
        if repair.done == before:
            break
        try:
            return validate(repair.plain), found
        except ValidationError as following:
            entries = following.errors(include_url=False)
            shown = [each for each in entries if repair.is_shown(given(each), each["type"])]
            if shown:
                found.append((copied(repair.plain), shown))
    return None, found


def copied(value: Any) -> Any:
    """Return a copy of nested mappings and lists."""
    if isinstance(value, Mapping):
        return {key: copied(each) for key, each in value.items()}
    return [copied(each) for each in value] if isinstance(value, list | tuple) else value


def is_item(value: Any, index: str) -> bool:
    """Return whether a key is the index of an item of a list."""
    return isinstance(value, list) and index.isdecimal() and int(index) < len(value)


class FieldRepair(Repair):
    """Values of an input, in which fields of sections and entries of lists and mappings with errors are removed.

    ``wrong``: Paths of the errors in the input. Subclasses list fields without a default (``required``, with values
    that cause no problem), and mappings whose entries are independent (``entries``).
    """

    required: ClassVar[Mapping[str, Any]] = {}
    entries: ClassVar[tuple[str, ...]] = ()

    def __init__(self, plain: Mapping[str, Any]) -> None:
        super().__init__(plain)
        self.wrong: set[tuple[str, ...]] = set()
        self._indices = {name: list(range(len(each))) for name, each in plain.items() if isinstance(each, list | tuple)}

    def given(self, keys: Keys) -> tuple[str, ...]:
        """Return the path that a path of the values has in the input."""
        if len(keys) > 1 and is_item(self._indices.get(keys[0]), keys[1]):
            return (keys[0], str(self._indices[keys[0]][int(keys[1])]), *keys[2:])
        return tuple(keys)

    def indices(self, name: str) -> list[int]:
        """Return the indices in the input of the remaining items of a list."""
        return self._indices.get(name, [])

    def is_wrong(self, *keys: str) -> bool:
        """Return whether a path of the input, or any above or below it, has an error."""
        return any(each[: len(keys)] == keys or keys[: len(each)] == each for each in self.wrong if each)

    def apply(self, keys: Keys, error: str) -> None:
        """Remove or replace a field of the input with an error."""
        self.done.add((error, *keys))
        self.wrong.add(tuple(keys))
        match keys:
            case []:
                self.resolve()
            case [name, key, *_] if isinstance(self.plain.get(name), dict):
                self._remove(name, key, error)
            case [name, index, *_] if isinstance(self.plain.get(name), list) and index.isdecimal():
                if int(index) in self.indices(name):
                    place = self.indices(name).index(int(index))
                    self.indices(name).pop(place)
                    self.plain[name].pop(place)
            case [name, *_]:
                self._replace(name)

    def is_shown(self, keys: Keys, error: str) -> bool:
        """Return whether an error that follows a repair is one of the input."""
        path = tuple(keys)
        if error in ("missing", "too_short") and any(each[: len(path)] == path for each in self.wrong):
            return False
        return not any(path[: len(each)] == each for each in self.wrong if each)

    def resolve(self) -> None:
        """Remove fields that contradict each other, of which only the whole input has an error."""

    def _remove(self, section: str, name: str, error: str) -> None:
        path = f"{section}.{name}"
        if path in self.required:
            self.plain[section][name] = copied(self.required[path])
        elif name in self.plain[section]:
            del self.plain[section][name]
        elif error == "missing":
            self._replace(section)

    def _replace(self, name: str) -> None:
        self.plain.pop(name, None)
        self._indices.pop(name, None)
        if name in self.required:
            self.plain[name] = copied(self.required[name])


@dataclass(frozen=True, eq=False)
class Reading(Generic[M]):
    """An input with its problems; with problems of its fields, its valid remainder.

    ``valid_part``: The input, or its valid remainder; None if there is none.
    ``repair``: Paths of the fields with errors, and the indices of lists.
    """

    refused: ClassVar[type[RecipeError] | type[CaptureError]]

    valid_part: M | None
    problems: tuple[Problem, ...]
    repair: FieldRepair
    source: str | Path | None = None

    def required(self) -> M:
        """Return the input, or raise an error with all problems."""
        if self.valid_part is None or self.problems:
            raise self.refused(self.problems, source=self.source)
        return self.valid_part


def read_model(
    model: type[M],
    plain: Mapping[str, Any],
    repair: FieldRepair,
    *,
    context: Mapping[str, Any] | None = None,
    words: Words | None = None,
) -> tuple[M | None, list[Problem]]:
    """Return a model, and the problems of its values; with problems, the valid remainder (None if there is none)."""

    def validate(values: Mapping[str, Any]) -> M:
        return model.model_validate(dict(values), context=dict(context or {}))

    def keys_of(values: Mapping[str, Any], entry: ErrorDetails) -> list[str]:
        return keys_in(values, entry["loc"], entry["type"], model)

    try:
        return validate(plain), []
    except ValidationError as error:
        value, hidden = find_hidden_errors(repair, error, validate, keys_of)
        problems = list_problems(error, plain, model=model, words=words)
        for _, entries in hidden:
            for entry in entries:
                name, *rest = entry["loc"] or ("",)
                if rest and isinstance(rest[0], int):
                    entry["loc"] = (name, int(repair.given((str(name), str(rest[0])))[1]), *rest[1:])
            more = list_problems(entries, plain, model=model, words=words)
            problems += [each for each in more if each not in problems]
        return value, problems
