"""Names that methods of one's own may have."""

from __future__ import annotations

import re

from scenetruth.errors import Problem
from scenetruth.estimators.registry import method_entries

__all__ = ["name_problems"]

_NAME = re.compile(r"[a-z][a-z0-9_]*")


def name_problems(name: object) -> list[Problem]:
    """Return what is wrong with the name of a method: estimates and their files are called after it.

    Examples
    --------
    >>> print(*name_problems("My program"))
    name: must be lower-case letters, digits and underscores, beginning with a letter (got 'My program')
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        message = "must be lower-case letters, digits and underscores, beginning with a letter"
        return [Problem("name", message, name)]
    if name in {entry.name for entry in method_entries()}:
        return [Problem("name", "is that of a method that is installed; choose another", name)]
    return []
