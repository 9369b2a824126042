"""The type of callbacks that report progress."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["Progress"]

Progress = Callable[[str, int, int], None]
"""Called with (what is done, how much of it is done, how much there is in all)."""
