"""Libraries that are imported where they are used, with a clear error where they are missing."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from scenetruth.errors import MachineError, Problem

__all__ = ["library", "require_libraries"]


def library(name: str) -> Any:
    """Return a module of a library that only designs need.

    Raises
    ------
    MachineError
        If it is not installed; says how to get it.
    """
    try:
        return import_module(name)
    except ImportError as error:
        message = f"is not installed: pip install 'scenetruth[design]' ({error})"
        raise MachineError([Problem(name.partition(".")[0], message)]) from error


def require_libraries() -> None:
    """Refuse to begin without the libraries.

    Raises
    ------
    MachineError
        If one is not installed.
    """
    library("optuna")
    library("SALib.sample.morris")
