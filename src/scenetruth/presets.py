"""Values that can be called by one name, each with where it was read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

__all__ = ["Preset", "preset"]


@dataclass(frozen=True)
class Preset:
    """Fields of a model and their values.

    Parameters
    ----------
    title
        What it is: a product, a movement.
    values
        Fields and their values, in the model's units.
    sources
        Where each of them is from: the same keys.
    """

    title: str
    values: Mapping[str, Any]
    sources: Mapping[str, str]


def preset(title: str, **fields: tuple[Any, str]) -> Preset:
    """Return a preset of fields, each given as its value and its source."""
    values = {name: value for name, (value, _) in fields.items()}
    sources = {name: source for name, (_, source) in fields.items()}
    return Preset(title, MappingProxyType(values), MappingProxyType(sources))
