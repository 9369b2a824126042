"""Unions of all kinds of one thing: every module of a room is looked through, so that a new kind is a new module."""

from __future__ import annotations

import pkgutil
from importlib import import_module
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, Field

__all__ = ["kind_in_lower_case", "kinds_in", "one_of"]


def one_of(base: type[BaseModel], *rooms: str) -> Any:
    """Return the type of a field that holds any kind of a thing, told apart by its ``kind``.

    Parameters
    ----------
    base
        What all kinds are derived from.
    rooms
        Packages whose modules are looked through: ``"scenetruth.scene.motion"``.

    Returns
    -------
    type
        A discriminated union, for annotations. To type checkers its values are those of ``base``.
    """
    models = tuple(kinds_in(base, *rooms).values())
    union: Any = Union[models]  # noqa: UP007
    return Annotated[union, Field(discriminator="kind"), BeforeValidator(kind_in_lower_case)]


def kinds_in(base: type[BaseModel], *rooms: str) -> dict[str, type[BaseModel]]:
    """Return the models derived from a base that modules of some rooms define, by their ``kind``, in order of it.

    Raises
    ------
    TypeError
        If two models have one kind.
    """
    found: dict[str, type[BaseModel]] = {}
    for room in rooms:
        for entry in pkgutil.iter_modules(import_module(room).__path__):
            # Files of kernels hold nothing else, and importing them loads the compiler.
            if entry.name.endswith("kernels"):
                continue
            module = import_module(f"{room}.{entry.name}")
            for model in vars(module).values():
                # What a module imports is another module's kind.
                if not (isinstance(model, type) and issubclass(model, base) and model.__module__ == module.__name__):
                    continue
                field = model.model_fields.get("kind")
                if field is None or get_origin(field.annotation) is not Literal:
                    continue
                (kind,) = get_args(field.annotation)
                if kind in found:
                    msg = f"kind '{kind}' is taken twice: by {found[kind].__qualname__} and {model.__qualname__}"
                    raise TypeError(msg)
                found[kind] = model
    return dict(sorted(found.items()))


def kind_in_lower_case(value: Any) -> Any:
    """Return a mapping with its ``kind`` in lower case, and anything else as it is: kinds may be in any case."""
    if isinstance(value, dict) and isinstance(value.get("kind"), str):
        return {**value, "kind": value["kind"].lower()}
    return value
