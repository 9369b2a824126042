"""Problems of invalid input: paths as in the file, plain words and remedies, the nearest valid keys."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from scenetruth.errors import Problem

__all__ = [
    "keys_in", "kinds_of", "list_problems", "listed", "models_in", "nearest_words", "question", "suggest_word",
]  # fmt: skip

Words = Callable[[ErrorDetails, str], str | None]
"""Return the message of an entry at a path, where a format has words of its own; None for those of all formats."""

_MOST_PROBLEMS = 100  # suggestions take some milliseconds per problem
_LIKE = 0.6
"""Minimum similarity of a suggested word."""
_WITHOUT_UNIT = 0.9
_MOST_WORDS = 3
_OF_PATTERNS = {r"^[a-z][a-z0-9_]*$": "lower-case letters, digits and underscores, and begin with a letter"}
"""Words for the patterns of names."""
_KEY = "[key]"
"""Part of a location that pydantic uses for a key of a mapping."""


def list_problems(
    error: ValidationError | Sequence[ErrorDetails],
    plain: Any = None,
    *,
    model: type[BaseModel] | None = None,
    under: str = "",
    words: Words | None = None,
) -> list[Problem]:
    """Return the problems of a validation, one per value, misspelt keys before those that are missing for their sake.

    ``error``: The error of the validation, or entries of it.
    ``plain``: The input; without it, paths have the union members that pydantic inserts.
    ``model``: Model of the whole input, for suggestions of keys.
    ``under``: Path of the input in its file.
    """
    entries = error.errors(include_url=False) if isinstance(error, ValidationError) else error
    # Items with errors do not count as items.
    inside = {each["loc"][:size] for each in entries for size in range(len(each["loc"]))}
    entries = [each for each in entries if each["type"] != "too_short" or each["loc"] not in inside]
    found: dict[tuple[str, str], tuple[str, Problem]] = {}
    for entry in entries[:_MOST_PROBLEMS]:
        loc, value = entry["loc"], entry.get("input")
        keys = map(str, loc) if plain is None else keys_in(plain, loc, entry["type"], model)
        path = ".".join(filter(None, (under, *keys)))
        message = (words(entry, path) if words else None) or _message(entry, path, model)
        message = message.removeprefix(_PREFIX)
        hidden = entry["type"] == "missing" or not path or value in ((), []) or isinstance(value, BaseModel)
        problem = Problem(path, _lower(message), None if hidden else value)
        found.setdefault((path, problem.message), (entry["type"], problem))
    problems = _joined(list(found.values()))
    if any(entry["type"] == "missing" or entry.get("input") in ((), []) for entry in entries):
        problems.sort(key=lambda problem: not problem.message.startswith("unknown key; did you mean"))
    if len(entries) > _MOST_PROBLEMS:
        problems.append(Problem("", f"{len(entries) - _MOST_PROBLEMS:,} more problems are omitted; fix these first"))
    return problems


_PREFIX = "Value error, "
"""Begins the messages of validators of the models."""


def keys_in(plain: Any, loc: Sequence[str | int], kind: str = "", model: type[BaseModel] | None = None) -> list[str]:
    """Return a location as keys of the input, without the union members that pydantic inserts.

    ``kind``: Type of the error.
    """
    keys, here = list[str](), plain
    for index, key in enumerate(loc):
        last = index == len(loc) - 1
        # A field may have the name of the `kind` of its mapping (`file`); followed by more parts it is the `kind`.
        named = isinstance(here, Mapping) and str(here.get("kind", "")).lower() == key
        inside = isinstance(here, Mapping) and key in here
        if inside and named and not last:
            inside = isinstance(here.get(key), Mapping | list | tuple)
        listed_here = isinstance(here, list | tuple) and isinstance(key, int) and key < len(here)
        if inside or listed_here:
            here = here[key]
        elif not last or (kind != "missing" and _is_union_member(here, key, loc, model)):
            continue
        keys.append(str(key))
    return keys


def _is_union_member(here: Any, key: str | int, loc: Sequence[str | int], model: type[BaseModel] | None) -> bool:
    """Return whether the last part of a location is a union member rather than a field or an index."""
    if isinstance(key, int):
        return False
    if not isinstance(here, Mapping) or key == _KEY or str(here.get("kind", "")).lower() == key:
        return True
    return model is not None and key not in _keys_of(_models_at(model, loc[:-1]))


def _lower(message: str) -> str:
    return message[:1].lower() + message[1:] if message[1:2].islower() or message[1:2] == " " else message


def _message(entry: ErrorDetails, path: str, model: type[BaseModel] | None) -> str:
    """Return the message of an entry in the words of all formats."""
    message, value = entry["msg"].removeprefix(_PREFIX).removeprefix("Assertion failed, "), entry.get("input")
    match entry["type"]:
        case "missing":
            return "is missing"
        case "extra_forbidden":
            known = sorted(_keys_of(_models_at(model, entry["loc"][:-1]))) if model else []
            return "unknown key" + (suggest_word(str(entry["loc"][-1]), known) or _valid_keys(known))
        case kind if value is None and path and (kind.endswith("_type") or kind == "literal_error"):
            return "is empty; fill it in, or remove the key"
        case "int_parsing" if _has_decimal_comma(value):
            return "must be an integer, without a decimal comma"
        case "float_parsing" if _has_decimal_comma(value):
            return f"must be a number with a decimal point: {str(value).strip().replace(',', '.')}"
        case "float_parsing" | "int_parsing" if number := _number_with_unit(value):
            return f"must be a number without a unit: {number}"
        case "float_parsing" | "int_parsing" if value in ("true", "false"):
            return "must be a number, not a boolean; YAML reads yes, no, on and off as booleans, too"
        case "too_long" if isinstance(value, list | tuple) and all(isinstance(each, int | float) for each in value):
            return f"{_lower(message)}; a decimal comma separates items: write 0.5, not 0,5"
        case "tuple_type" | "list_type":
            return "must be a list; write [...] around a single item"
        case "model_type" | "model_attributes_type" | "dict_type" | "dataclass_type":
            return "must be a mapping of its fields"
        case "string_pattern_mismatch" if words := _OF_PATTERNS.get(entry["ctx"]["pattern"]):
            return f"must consist of {words}"
        case "string_type":
            return "must be text; put it in quotes" if isinstance(value, int | float) else "must be text"
        case "literal_error":
            return message + suggest_word(value, re.findall(r"'([^']*)'", message))
        case "union_tag_invalid":
            kinds, tag = entry["ctx"]["expected_tags"], entry["ctx"]["tag"]
            if isinstance(value, Mapping) and not isinstance(value.get("kind"), str):
                return f"`kind` must be one of {kinds}"
            return f"unknown `kind`: '{tag}' is not one of {kinds}" + suggest_word(tag, re.findall(r"'([^']*)'", kinds))
        case "union_tag_not_found":
            kinds = [kind for each in _models_at(model, entry["loc"]) for kind in kinds_of(each)] if model else []
            return "requires `kind`" + (f", one of {str(sorted(kinds))[1:-1]}" if kinds else "")
    return message


def _has_decimal_comma(value: Any) -> bool:
    return isinstance(value, str) and re.fullmatch(r"\s*[+-]?\d+,\d+\s*", value) is not None


def _number_with_unit(value: Any) -> str:
    """Return the number of a text such as ``5 mm``; an empty text for others."""
    number = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
    found = re.fullmatch(rf"\s*({number})\s*[^\W\d_°%][\w°%/^²³·*-]*\s*", value) if isinstance(value, str) else None
    return found[1] if found else ""


def _valid_keys(known: Sequence[str]) -> str:
    return f"; valid keys: {', '.join(known)}" if known else ""


def _joined(found: Sequence[tuple[str, Problem]]) -> list[Problem]:
    """Return one problem per value, because pydantic reports each alternative of a union separately."""
    problems: list[Problem] = []
    for kind, problem in found:
        others = [other for entry, other in found if entry != "literal_error" and other.path == problem.path]
        if kind == "literal_error":
            # Problems inside a mapping are more specific than its mismatch with a literal.
            if not others and not any(other.path.startswith(f"{problem.path}.") for _, other in found):
                problems.append(problem)
            continue
        allowed = [
            other.message.removeprefix("input should be ")
            for entry, other in found
            if entry == "literal_error" and other.path == problem.path
        ]
        first = problem.message.partition(", unable to parse")[0]
        problems.append(Problem(problem.path, " or ".join([first, *allowed]), problem.value) if allowed else problem)
    return problems


def suggest_word(given: object, known: Iterable[str]) -> str:
    """Return the nearest of the valid words as the end of a message, or an empty string.

    >>> suggest_word("widht", ["width", "height"])
    "; did you mean 'width'?"
    """
    near = nearest_words(given, known) if isinstance(given, str) else []
    return question([f"'{word}'" for word in near])


def nearest_words(word: str, known: Iterable[str], least: float = _LIKE) -> list[str]:
    """Return the most similar words, ignoring case; several only for equal similarity."""
    likeness = {name: _likeness(name.casefold(), word.casefold()) for name in known}
    best = max(likeness.values(), default=0.0)
    return sorted(name for name, ratio in likeness.items() if ratio == best)[:_MOST_WORDS] if best >= least else []


def _likeness(known: str, word: str) -> float:
    import difflib

    matcher = difflib.SequenceMatcher(None, known, word)
    ratio = matcher.ratio()
    if ratio < _LIKE <= matcher.quick_ratio():
        # The longest common part is taken first, from the start: repeated letters may hide a longer one from the end.
        ratio = max(ratio, difflib.SequenceMatcher(None, known[::-1], word[::-1]).ratio())
    # Names without their unit suffix count as similar.
    return max(ratio, _WITHOUT_UNIT) if known.startswith(f"{word}_") else ratio


def question(guesses: Sequence[str]) -> str:
    """Return suggestions as the end of a message, or an empty string."""
    return f"; did you mean {listed(guesses)}?" if guesses else ""


def listed(texts: Sequence[str]) -> str:
    """Return alternatives as text.

    >>> listed(["x", "y", "t"])
    'x, y or t'
    """
    return " or ".join(filter(None, (", ".join(texts[:-1]), texts[-1])))


def _models_at(model: type[BaseModel], loc: Sequence[str | int]) -> list[type[BaseModel]]:
    """Return the models that a location of the input may have."""
    models = [model]
    for key in loc:
        inner = [
            part
            for each in models
            for name, field in each.model_fields.items()
            if key in (name, field.alias)
            for _, part in models_in(field.annotation)
        ]
        models = inner or [each for each in models if key in kinds_of(each)] or models
    return models


def models_in(annotation: Any, in_list: bool = False) -> Iterator[tuple[bool, type[BaseModel]]]:
    """Yield the models of a type, each with whether it is in a list."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield in_list, annotation
        return
    origin = get_origin(annotation)
    if origin is not Literal:
        for part in get_args(annotation):
            yield from models_in(part, in_list or origin in (tuple, list))


def _keys_of(models: Iterable[type[BaseModel]]) -> set[str]:
    return {field.alias or name for model in models for name, field in model.model_fields.items()}


def kinds_of(model: type[BaseModel]) -> tuple[str, ...]:
    """Return the values of the field `kind` of a member of a union."""
    kind = model.model_fields.get("kind")
    return get_args(kind.annotation) if kind is not None and get_origin(kind.annotation) is Literal else ()
