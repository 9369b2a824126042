"""Words by which the search of the site finds pages, in addition to those of their text."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

if TYPE_CHECKING:
    from docutils import nodes

__all__ = ["RANKING", "connect_search", "search_script", "search_words"]

RANKING = Path(__file__).with_name("search_ranking.js")
"""The scores of search results (``html_search_scorer``)."""


@lru_cache
def search_words() -> dict[str, list[str]]:
    """Return the phrases by which readers search for pages, by name of the page."""
    text = Path(__file__).with_name("search_words.yaml").read_text(encoding="utf-8")
    table: dict[str, list[str]] = yaml.safe_load(text)
    return table


def search_script() -> str:
    """Return the script that hands the phrases to the ranking."""
    return f"const SEARCH_WORDS = {json.dumps(search_words())};"


def connect_search(app: Any) -> None:
    """Connect the phrases to the search of a Sphinx application."""
    app.connect("doctree-read", _add_keywords)
    app.connect("html-page-context", _add_search_words)


def _add_keywords(app: Any, document: nodes.document) -> None:
    """Add the words of the phrases of a page to its keywords, which the search includes one by one."""
    from docutils import nodes

    words = dict.fromkeys(" ".join(search_words().get(app.env.docname, ())).split())
    if words:
        document.insert(0, nodes.meta("", name="keywords", content=", ".join(words)))


def _add_search_words(app: Any, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Write the phrases of all pages into the search page."""
    if page == "search":
        app.add_js_file(None, body=search_script())
