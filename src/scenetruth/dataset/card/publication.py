"""What a data set's folder does not know of its publication."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import date as day
from urllib.parse import urlsplit

from scenetruth.errors import Problem, RecipeError

__all__ = ["Publication"]


@dataclass(frozen=True)
class Publication:
    """How a data set is published.

    Parameters
    ----------
    version
        Its version: three numbers with points between them.
    date
        The day of its publication, as 2026-11-23; empty if it is not known yet.
    url
        Where it is to be found; empty if it is not known yet.

    Raises
    ------
    RecipeError
        If one of them does not have its form.
    """

    version: str = "1.0.0"
    date: str = ""
    url: str = ""

    def __post_init__(self) -> None:
        problems = []
        if not re.fullmatch(r"[0-9]+\.[0-9]+\.[0-9]+", self.version):
            problems.append(
                Problem("version", "must be three numbers with points between them, as 1.0.0", self.version)
            )
        if self.date and not _is_day(self.date):
            problems.append(Problem("published", "must be a day, as 2026-11-23", self.date))
        if self.url and not _is_address(self.url):
            problems.append(Problem("url", "must be an address that begins with https:// or http://", self.url))
        if problems:
            raise RecipeError(problems)


def _is_day(text: str) -> bool:
    try:
        return day.fromisoformat(text).isoformat() == text
    except ValueError:
        return False


def _is_address(text: str) -> bool:
    try:
        parts = urlsplit(text)
    except ValueError:
        return False
    return parts.scheme in ("http", "https") and bool(parts.netloc) and text.isprintable() and " " not in text
