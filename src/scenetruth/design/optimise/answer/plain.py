"""Plain values from dataclasses, and back: numbers that are not finite are null (not a number), "inf" and "-inf"."""

from __future__ import annotations

import math
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

__all__ = ["made_of", "plain_of"]


def plain_of(value: Any) -> Any:
    """Return plain values, as JSON has them.

    Parameters
    ----------
    value
        Dataclasses, mappings, lists, tuples, and what is in them.

    Examples
    --------
    >>> plain_of({"low": math.nan, "high": math.inf, "seeds": (1, 2)})
    {'low': None, 'high': 'inf', 'seeds': [1, 2]}
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {one.name: plain_of(getattr(value, one.name)) for one in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain_of(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain_of(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf" if value > 0 else "-inf"
    return value


def made_of(kind: Any, plain: Any) -> Any:
    """Return what plain values stand for.

    Parameters
    ----------
    kind
        Its type: a dataclass, a mapping or tuple of a type, a number, or anything else as it is.
    plain
        As `plain_of` gives them.

    Raises
    ------
    TypeError, ValueError, KeyError
        If they are not of this type.
    """
    if kind is float:
        return math.nan if plain is None else float(plain)
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        given = {one.name: plain[one.name] for one in fields(kind)}
        return kind(**{name: made_of(hints[name], one) for name, one in given.items()})  # type: ignore[operator]
    origin, inner = get_origin(kind), get_args(kind)
    if origin is tuple:
        kinds = inner[:1] * len(plain) if inner[1:] == (...,) else inner
        return tuple(made_of(each, one) for each, one in zip(kinds, plain, strict=True))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {key: made_of(inner[1], one) for key, one in plain.items()}
    if origin in (Union, types.UnionType):
        return None if plain is None else made_of(next(each for each in inner if each is not types.NoneType), plain)
    if kind in (int, str, bool) and not isinstance(plain, kind):
        message = f"{plain!r} is no {kind.__name__}"
        raise TypeError(message)
    if origin is Literal and plain not in inner:
        message = f"{plain!r} is none of {inner}"
        raise ValueError(message)
    return plain
