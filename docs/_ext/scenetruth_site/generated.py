"""Parts of pages that are made when the site is built: ``<!-- generated: scene camera -->`` stands for them."""

from __future__ import annotations

import re

from scenetruth_site.api import api_in_markdown
from scenetruth_site.commands import commands_in_markdown
from scenetruth_site.files import DESCRIBED, room_in_markdown

__all__ = ["fill_in", "generated_parts"]

_MARK = re.compile(r"^<!-- generated: (?P<what>[a-z_ ]+) -->$", re.MULTILINE)


def generated_parts(page: str) -> list[str]:
    """Return what is made for a page: ``api scenes``, ``commands``, ``scene camera``."""
    return [found["what"] for found in _MARK.finditer(page)]


def fill_in(page: str) -> str:
    """Return a page with the parts that are made for it.

    Raises
    ------
    ValueError
        If it asks for a part that nobody makes.
    """
    return _MARK.sub(lambda found: _make(found["what"]), page)


def _make(what: str) -> str:
    match what.split():
        case ["commands"]:
            from scenetruth.cli.app import app

            return commands_in_markdown(app, "scenetruth")
        case ["api", page]:
            return api_in_markdown(page)
        case [file, room] if file in DESCRIBED:
            return room_in_markdown(file, room)
    msg = f"nothing makes the part '{what}'"
    raise ValueError(msg)
