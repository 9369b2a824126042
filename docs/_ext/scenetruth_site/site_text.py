"""Conversion of pages of the repository for the site, where the syntax of the code host does not work."""

from __future__ import annotations

import re
from pathlib import Path

from scenetruth_site.generated import fill_in
from scenetruth_site.toctrees import added_toctree, without_empty_globs

__all__ = ["site_text"]

_LINKED_HEADING = re.compile(r"^(#+) \[([^\]]+)\]\(([^)\s]+)\)$", re.MULTILINE)
_MARKDOWN_ABOVE = re.compile(r"\]\(((?:\.\./)+[^)#\s]+\.md)\)")


def site_text(docs: Path, page: str, text: str) -> str:
    """Return the source of a page for Sphinx.

    Parameters
    ----------
    docs
        The folder of all pages.
    page
        The name of the page: its path without the suffix.
    text
        The content of its file.

    Returns
    -------
    str
        The page with its generated parts. Links in headings are moved below them, because tables of contents hold plain
        text. Markdown files that are not pages of the site become downloads.
    """
    text = _LINKED_HEADING.sub(lambda found: f"{found[1]} {found[2]}\n\n[`{Path(found[3]).name}`]({found[3]})", text)
    folder = (docs / page).parent

    def no_page(found: re.Match[str]) -> str:
        target = (folder / found[1]).resolve()
        return found[0] if target.is_relative_to(docs.resolve()) else f"](path:{found[1]})"

    text = _MARKDOWN_ABOVE.sub(no_page, text)
    return fill_in(without_empty_globs(docs, page, text)) + added_toctree(page)
