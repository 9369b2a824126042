"""What is called as long work goes on, and messages for whoever runs it."""

from __future__ import annotations

import logging
from collections.abc import Callable

__all__ = ["LOGGER", "Progress", "say"]

Progress = Callable[[str, int, int], None]
"""Called with (what is done, how much of it is done, how much there is in all)."""

LOGGER = logging.getLogger("scenetruth")
"""Where messages go; the command line prints them."""


def say(text: str) -> None:
    """Log a message, as the backend that renders; nothing is printed unless logging is asked for level INFO."""
    LOGGER.info("%s", text)
