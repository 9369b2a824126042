"""Arguments of calls that take one of some words, or something to call: what is wrong with them."""

from __future__ import annotations

from typing import Any, get_args

from scenetruth.errors import Problem

__all__ = ["argument_problems"]


def argument_problems(progress: Any = None, **choices: tuple[Any, Any]) -> list[Problem]:
    """Return what is wrong with arguments whose types nobody checks at a call.

    Parameters
    ----------
    progress
        What is to be called as the work goes on, or None.
    **choices
        Values and the literal types of which they must be, by the names of the arguments.

    Examples
    --------
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
