"""The error of a goal that cannot be followed, or cannot be met."""

from __future__ import annotations

from scenetruth.errors import RecipeError

__all__ = ["GoalError"]


class GoalError(RecipeError):
    """A goal that cannot be followed or met; lists every problem with its path."""

    _noun = "goal"
