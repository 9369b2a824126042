"""Validated models: base class, field types, docstrings of fields, and presets."""

from __future__ import annotations

import ast
import inspect
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType, UnionType
from typing import Annotated, Any, Literal, Self, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    model_validator,
)
from pydantic_core import CoreSchema

__all__ = [
    "Direction",
    "Finite",
    "FrozenModel",
    "Name",
    "NonNegative",
    "Positive",
    "Preset",
    "Vector3",
    "field_docstrings",
    "preset",
]


def field_docstrings(cls: type) -> dict[str, str]:
    """Return the docstrings of the fields of a class and its base classes, from their source.

    >>> from scenetruth.estimators.method_settings import StructureTensorSettings
    >>> field_docstrings(StructureTensorSettings)["window_sigma_frames"]
    'Standard deviation of the Gaussian window B in t, in frames.'
    """
    found: dict[str, str] = {}
    for part in reversed(cls.__mro__):
        found |= _docstrings_of_module(part.__module__).get(part.__qualname__, {})
    return found


@lru_cache(maxsize=256)
def _docstrings_of_module(name: str) -> dict[str, dict[str, str]]:
    """Return the docstrings of fields by ``__qualname__`` of their class."""
    try:
        tree = ast.parse(inspect.getsource(sys.modules[name]))
    except (KeyError, OSError, TypeError, SyntaxError):
        return {}
    found: dict[str, dict[str, str]] = {}

    def visit(node: ast.AST, inside: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.ClassDef):
                found[inside + child.name] = _of_fields(child)
                visit(child, f"{inside}{child.name}.")
            elif isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                visit(child, f"{inside}{child.name}.<locals>.")

    visit(tree, "")
    return found


def _of_fields(node: ast.ClassDef) -> dict[str, str]:
    entries = {}
    for field, behind in zip(node.body, node.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(behind, ast.Expr):
            value = behind.value
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                entries[field.target.id] = inspect.cleandoc(value.value)
    return entries


LARGEST, SMALLEST = 1e12, 1e-12
"""Limits of the magnitude of every number, in any unit: products and quotients of several numbers stay far within the
range of float64, squares of three within that of float32."""


def _not_lost(value: float) -> float:
    if value < SMALLEST:
        msg = f"must be at least {SMALLEST:g}: smaller numbers are lost in rounding"
        raise ValueError(msg)
    return value


def _printable(value: str) -> str:
    if not value.isprintable():
        msg = "must contain printable characters only: no line breaks, tabs or control characters"
        raise ValueError(msg)
    return value


Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, le=LARGEST, allow_inf_nan=False), AfterValidator(_not_lost)]
NonNegative = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_printable)]
"""Name in messages, tables and file formats: printable characters only."""
Vector3 = tuple[Finite, Finite, Finite]


def _nonzero(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if value == (0, 0, 0):
        msg = "must not be the zero vector"
        raise ValueError(msg)
    if max(map(abs, value)) < SMALLEST:
        msg = f"must have a component of at least {SMALLEST:g}: its length is arbitrary, but shorter vectors underflow"
        raise ValueError(msg)
    return value


Direction = Annotated[Vector3, AfterValidator(_nonzero)]
"""A nonzero vector of any length."""


class FrozenModel(BaseModel):
    """An immutable pydantic model that rejects unknown keys.

    Literal values are accepted in any case; the field holds the declared spelling.

    >>> class Filter(FrozenModel):
    ...     sides: Literal["upper", "lower"]
    ...     cutoff_px: Positive | Literal["auto"] = "auto"
    >>> Filter.model_validate({"sides": "Upper", "cutoff_px": "AUTO"})
    Filter(sides='upper', cutoff_px='auto')
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    # Wraps the model, so that its own validators, which look up presets, receive the declared spelling.
    @model_validator(mode="wrap")
    @classmethod
    def _words_in_any_case(cls, given: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        return handler({**given, **_as_declared(cls, given)} if isinstance(given, dict) else given)

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Return the JSON Schema with docstrings as descriptions; pydantic's own option needs 1 s at import."""
        schema = handler(core_schema)
        entries = field_docstrings(cls)
        # The schema uses the field names of files.
        entries |= {
            field.alias: entries[name] for name, field in cls.model_fields.items() if field.alias and name in entries
        }
        whole = handler.resolve_ref_schema(schema)
        if "description" in whole:
            # The description without See Also and Examples.
            whole["description"] = _FURTHER.split(whole["description"])[0]
        for name, field in whole.get("properties", {}).items():
            if name in entries:
                field.setdefault("description", entries[name])
        return schema


def _has_boolean(given: Any) -> bool:
    parts = given.values() if isinstance(given, dict) else given if isinstance(given, list | tuple) else ()
    return isinstance(given, bool) or any(map(_has_boolean, parts))


def _booleans_as_text(given: Any) -> Any:
    if isinstance(given, bool):
        return "true" if given else "false"
    if isinstance(given, dict):
        return {key: _booleans_as_text(each) for key, each in given.items()}
    return [_booleans_as_text(each) for each in given] if isinstance(given, list | tuple) else given


@lru_cache(maxsize=1024)
def _number_fields(model: type[BaseModel]) -> frozenset[str]:
    """Return the fields that accept numbers, also in lists, and neither booleans nor arbitrary values."""
    found = set()
    for name, field in model.model_fields.items():
        types = set(_plain_types(field.annotation))
        if types & {int, float} and not types & {bool, Any, object}:
            found.add(name)
    return frozenset(found)


def _plain_types(annotation: Any) -> Iterator[Any]:
    """Yield the types of which an annotation consists."""
    parts = get_args(annotation)
    if get_origin(annotation) is Literal or not parts:
        yield bool if any(isinstance(part, bool) for part in parts) else annotation
        return
    for part in parts:
        yield from _plain_types(part)


_FURTHER = re.compile(r"\n\n(?:See Also|Examples)\n---")


def _as_declared(model: type[BaseModel], given: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the declared spelling of literal values given in another case, and booleans given for numbers as text."""
    # Otherwise, ``width: yes`` would be 1.
    changed: dict[str, Any] = {
        name: _booleans_as_text(given[name])
        for name in _number_fields(model)
        if name in given and _has_boolean(given[name])
    }
    for name, words in _words_of_fields(model).items():
        value = given.get(name)
        if isinstance(value, str) and value not in words.values() and value.casefold() in words:
            changed[name] = words[value.casefold()]
    return changed


@lru_cache(maxsize=1024)
def _words_of_fields(model: type[BaseModel]) -> dict[str, dict[str, str]]:
    """Return the literal values of each field by their case-folded spelling."""
    found = {}
    for name, field in model.model_fields.items():
        words = list(_words_in(field.annotation))
        by_folded = {word.casefold(): word for word in words if isinstance(word, str)}
        # Case matters for fields of any text, and for values that differ only in case.
        if by_folded and str not in words and len(by_folded) == len(set(words)):
            found[name] = by_folded
    return found


def _words_in(annotation: Any) -> Iterator[str | type[str]]:
    """Yield the literal values of a type, and ``str`` if it accepts any text."""
    if annotation is str:
        yield annotation
    elif get_origin(annotation) is Literal:
        yield from (value for value in get_args(annotation) if isinstance(value, str))
    elif get_origin(annotation) is Annotated:
        yield from _words_in(get_args(annotation)[0])
    elif get_origin(annotation) in (Union, UnionType):
        for part in get_args(annotation):
            yield from _words_in(part)


@dataclass(frozen=True)
class Preset:
    """Values of fields of a model, in its units, such as those of a product, with the source of each."""

    title: str
    values: Mapping[str, Any]
    sources: Mapping[str, str]


def preset(title: str, **fields: tuple[Any, str]) -> Preset:
    """Return a preset of fields, each given as value and source."""
    values = {name: value for name, (value, _) in fields.items()}
    sources = {name: source for name, (_, source) in fields.items()}
    return Preset(title, MappingProxyType(values), MappingProxyType(sources))
