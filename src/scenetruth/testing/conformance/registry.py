"""All checks: every module below `checks` is one."""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib import import_module

from scenetruth.testing.conformance.check import Check

__all__ = ["all_checks"]


@cache
def all_checks() -> tuple[Check, ...]:
    """Return every check, room by room, in order of their names.

    A check is a module: its docstring says what it demands, ``NEEDS`` when it applies, ``check(bench)`` tries.

    Examples
    --------
    >>> [check.says for check in all_checks() if check.name == "deterministic"]
    ['Two calls with the same recording give the same bytes.']
    """
    room = import_module("scenetruth.testing.conformance.checks")
    found = []
    for entry in pkgutil.walk_packages(room.__path__, f"{room.__name__}."):
        if not entry.ispkg:
            module = import_module(entry.name)
            says = (module.__doc__ or "").strip().splitlines()[0]
            found.append(Check(entry.name.rpartition(".")[2], says, module.NEEDS, module.check))
    return tuple(found)
