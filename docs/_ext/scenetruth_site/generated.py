"""Parts of pages that are generated when the site is built, marked by ``<!-- generated: scene camera -->``."""

from __future__ import annotations

import re

from scenetruth_site.api import api_in_markdown
from scenetruth_site.commands import commands_in_markdown
from scenetruth_site.files import DESCRIBED, page_in_markdown

__all__ = ["fill_in", "generated_parts"]

_MARK = re.compile(r"^<!-- generated: (?P<what>[a-z_ ]+) -->$", re.MULTILINE)


def generated_parts(page: str) -> list[str]:
    """Return the generated parts of a page: ``api scenes``, ``commands``, ``scene camera``."""
    return [found["what"] for found in _MARK.finditer(page)]


def fill_in(page: str) -> str:
    """Return a page with its generated parts.

    Raises
    ------
    ValueError
        If it has the mark of an unknown part.
    """
    return _MARK.sub(lambda found: _make(found["what"]), page)


def _make(what: str) -> str:
    match what.split():
        case ["commands"]:
            from scenetruth.cli.app import app

            return commands_in_markdown(app, "scenetruth")
        case ["api", page]:
            return api_in_markdown(page)
        case [file, page] if file in DESCRIBED:
            return page_in_markdown(file, page)
    msg = f"unknown generated part '{what}'"
    raise ValueError(msg)
