"""What is wrong with a pattern or a rig, told all at once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from scenetruth.errors import Problem, RecipeError

__all__ = ["PatternError", "problems_of", "validated"]

Model = TypeVar("Model", bound=BaseModel)


class PatternError(RecipeError):
    """A pattern that cannot be made, printed or judged; lists every problem with its path."""

    _noun = "pattern"


def validated(model: type[Model], values: Mapping[str, Any], path: str = "") -> tuple[Model | None, list[Problem]]:
    """Return a model made of values, or what is wrong with them.

    Parameters
    ----------
    model
        The model.
    values
        Its fields.
    path
        What stands before the names of fields in problems.
    """
    try:
        return model.model_validate(dict(values)), []
    except ValidationError as error:
        known = ", ".join(sorted(set(model.model_fields) - {"kind"}))
        return None, problems_of(error, path, known)


def problems_of(error: ValidationError, path: str, known: str) -> list[Problem]:
    """Return the problems that a validation has found.

    Parameters
    ----------
    error
        What it raised.
    path
        What stands before the names of fields.
    known
        Names of the fields that there are.
    """
    found = []
    for entry in error.errors():
        where = ".".join([path, *map(str, entry["loc"])] if path else map(str, entry["loc"]))
        message = entry["msg"].removeprefix("Value error, ").replace("Input should", "should")
        if entry["type"] == "missing":
            found.append(Problem(where, "is missing"))
            continue
        if entry["type"] == "extra_forbidden":
            message = f"is no setting here; there are {known}"
        found.append(Problem(where, message, entry.get("input")))
    return found
