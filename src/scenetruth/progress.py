"""Progress callbacks, and messages for the user."""

from __future__ import annotations

import logging
from collections.abc import Callable

__all__ = ["LOGGER", "Progress", "say"]

Progress = Callable[[str, int, int], None]
"""Called with (what, done, total)."""

LOGGER = logging.getLogger("scenetruth")
"""Logger of messages; the command line prints them."""


def say(text: str) -> None:
    """Log a message, such as the rendering backend; it is printed only with log level INFO."""
    LOGGER.info("%s", text)
