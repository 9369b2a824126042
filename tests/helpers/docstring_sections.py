"""Sections of numpydoc docstrings."""

from __future__ import annotations

import inspect
import re

__all__ = ["sections_of"]


def sections_of(thing: object) -> dict[str, str]:
    """The sections of a docstring in the form of numpydoc, by their headings."""
    parts = re.split(r"^([A-Z][A-Za-z ]+)\n-{3,}\n", inspect.getdoc(thing) or "", flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))
