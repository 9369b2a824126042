"""The error of a sweep that cannot be made."""

from __future__ import annotations

from scenetruth.errors import RecipeError

__all__ = ["SweepError"]


class SweepError(RecipeError):
    """A sweep that cannot be made; lists every problem with its path."""

    _noun = "sweep"
