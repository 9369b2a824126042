"""Registries: classes of a family are discovered in its modules, without further registration."""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator
from importlib import import_module
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, Field

__all__ = ["classes_in", "discriminated_union", "kind_in_lower_case", "kinds_in"]


def classes_in(base: type[Any], *names: str) -> Iterator[type[Any]]:
    """Yield the subclasses of a base that the given modules define, in the order of the files."""
    for name in names:
        module = import_module(name)
        inner = [f"{name}.{entry.name}" for entry in pkgutil.iter_modules(getattr(module, "__path__", ()))]
        # A list, because a module may register its own classes during import.
        for value in list(vars(module).values()):
            if isinstance(value, type) and issubclass(value, base) and value.__module__ == name and value is not base:
                yield value
        yield from classes_in(base, *(path for path in inner if not path.endswith("kernels")))


def discriminated_union(base: type[BaseModel], *names: str) -> Any:
    """Return the type of a field for any member of a family, selected by its ``kind``."""
    models = tuple(kinds_in(base, *names).values())
    union: Any = Union[models]  # noqa: UP007
    return Annotated[union, Field(discriminator="kind"), BeforeValidator(kind_in_lower_case)]


def kinds_in(base: type[BaseModel], *names: str) -> dict[str, type[BaseModel]]:
    """Return the subclasses of a base in the given modules by ``kind``, in alphabetical order."""
    models: dict[str, type[BaseModel]] = {}
    for model in classes_in(base, *names):
        field = model.model_fields.get("kind")
        if field is None or get_origin(field.annotation) is not Literal:
            continue
        (kind,) = get_args(field.annotation)
        if kind in models:
            msg = f"`kind` '{kind}' is used twice: by {models[kind].__qualname__} and {model.__qualname__}"
            raise TypeError(msg)
        models[kind] = model
    return dict(sorted(models.items()))


def kind_in_lower_case(value: Any) -> Any:
    """Return a mapping with its ``kind`` in lower case, and other values unchanged."""
    if isinstance(value, dict) and isinstance(value.get("kind"), str):
        return {**value, "kind": value["kind"].lower()}
    return value
