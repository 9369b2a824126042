"""Validation of plain data: JSON texts and values from files, and arguments of functions."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, get_args

from scenetruth.errors import Problem

__all__ = [
    "LARGEST_INTEGER",
    "MAX_DEPTH",
    "MAX_VALUES",
    "argument_problems",
    "parse_json",
    "plain_problems",
    "scalar_problem",
    "seed_problems",
]

MAX_DEPTH = 40
"""Maximum nesting of mappings and lists; scenes need about ten levels, recursive code supports some hundreds."""
MAX_VALUES = 100_000
"""Maximum number of values of a tree, including repeated references; validation takes 1 to 2 s."""
LARGEST_INTEGER = 2**63 - 1
"""Range of 64-bit integers, as in files and arrays."""


def scalar_problem(value: Any) -> str:
    r"""Return the problem of a scalar value, or an empty text.

    >>> scalar_problem(2**63), scalar_problem("a\0b"), scalar_problem(2**62)
    ('does not fit into 64 bits', 'holds the character NUL, which no name or text may have', '')
    """
    if isinstance(value, str):
        if "\0" in value:
            return "holds the character NUL, which no name or text may have"
        if not value.isascii() and any("\ud800" <= character <= "\udfff" for character in value):
            return "holds half a character (a surrogate), which cannot be written in UTF-8"
    elif isinstance(value, int) and abs(value) > LARGEST_INTEGER:
        return "does not fit into 64 bits"
    return ""


def plain_problems(tree: Any, *, any_keys: bool = False) -> list[Problem]:
    r"""Return the structural problems of a tree of plain values, regardless of its meaning.

    Invalid are keys that are not texts, texts that cannot be encoded, integers of more than 64 bits, trees that are too
    deep or contain themselves, and trees of more values than `MAX_VALUES`.

    >>> endless = {"a": 1}
    >>> endless["b"] = [endless]
    >>> print(*plain_problems(endless), *plain_problems({"a": {3: 4}}), sep="\n")
    b.0: contains itself (got {'a': 1, 'b': [{'a': 1, 'b': [{'a': 1, 'b': [{'a': 1, 'b': [{'a': 1, 'b'...)
    a: keys must be texts, not of type int (got 3)
    """
    problems: list[Problem] = []
    count = 0
    # Stack of iterators over the remaining items of mappings and lists, with their identities.
    path: list[str] = []
    around: list[int] = []
    open_: list[Iterator[tuple[Any, Any]]] = [iter([("", tree)])]
    while open_:
        try:
            key, value = next(open_[-1], (None, open_))
        except RuntimeError:  # changed by another thread during iteration
            return [*problems, Problem(".".join(path), "changes while it is read")]
        if value is open_:
            open_.pop()
            if path:
                path.pop()
                around.pop()
            continue
        here = ".".join([*path[1:], str(key)]) if path else ""
        count += 1
        if count > MAX_VALUES:
            return [*problems, Problem(here, f"makes more than {MAX_VALUES:,} values in total, which no scene needs")]
        message = "" if isinstance(value, Mapping | list | tuple) else scalar_problem(value)
        if message:
            problems.append(Problem(here, message, value))
        if not isinstance(value, Mapping | list | tuple):
            continue
        if id(value) in around:
            problems.append(Problem(here, "contains itself", value))
            continue
        if len(around) == MAX_DEPTH:
            return [*problems, Problem(here, f"is nested more than {MAX_DEPTH} deep")]
        if isinstance(value, Mapping):
            problems += [
                Problem(here, f"keys must be texts, not of type {type(name).__name__}", name)
                for name in value
                if not any_keys and not isinstance(name, str)
            ]
            problems += [
                Problem(here, f"a key {message}", name)
                for name in value
                if isinstance(name, str) and (message := scalar_problem(name))
            ]
        if len(problems) > _MAX_SHOWN:
            return problems
        path.append(str(key) if path else "")
        around.append(id(value))
        open_.append(iter(value.items()) if isinstance(value, Mapping) else enumerate(value))
    return problems


_MAX_SHOWN = 100


def parse_json(text: str | bytes) -> Any:
    """Return the value of a JSON text.

    >>> parse_json('{"a": [1, 2.5]}')
    {'a': [1, 2.5]}
    """
    try:
        return json.loads(text)
    except RecursionError as error:
        msg = "is nested too deeply"
        raise ValueError(msg) from error


def argument_problems(progress: Any = None, **choices: tuple[Any, Any]) -> list[Problem]:
    """Return the problems of arguments whose types are not checked elsewhere.

    >>> from typing import Literal
    >>> print(*argument_problems(truth_views=("al", Literal["reference", "all"])))
    truth_views: must be 'reference' or 'all' (got 'al')
    """
    problems = [] if progress is None or callable(progress) else [Problem("progress", "must be callable", progress)]
    for name, (value, literal) in choices.items():
        words = get_args(literal)
        if not any(value == word and type(value) is type(word) for word in words):
            message = f"must be {' or '.join(map(repr, words))}"
            problems.append(Problem(name, message, "None" if value is None else value))
    return problems


def seed_problems(seeds: int | Sequence[int], most: int) -> list[Problem]:
    r"""Return the problems of an argument ``seeds``: a number of seeds, at most ``most``, or the seeds themselves.

    >>> print(*seed_problems([3, 3], 10), *seed_problems(0, 10), sep="\n")
    seeds: must be unique: equal seeds give equal images (got [3, 3])
    seeds: must be a number of seeds from 1 to 10, or a list of seeds (got 0)
    """
    if isinstance(seeds, int) and not isinstance(seeds, bool):
        wrong = not 1 <= seeds <= most
    else:
        wrong = not isinstance(seeds, Sequence) or isinstance(seeds, str) or not 1 <= len(seeds) <= most
    if wrong:
        return [Problem("seeds", f"must be a number of seeds from 1 to {most:,}, or a list of seeds", seeds)]
    listed = [] if isinstance(seeds, int) else list(seeds)
    if not all(isinstance(seed, int) and 0 <= seed <= LARGEST_INTEGER for seed in listed):
        return [Problem("seeds", "must be integers from 0 to 2**63 - 1", listed)]
    if len(set(listed)) < len(listed):
        return [Problem("seeds", "must be unique: equal seeds give equal images", listed)]
    return []
