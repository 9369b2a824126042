"""Tables of contents of the site."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

__all__ = ["ADDED", "added_toctree", "pages_of", "parents_of", "twice_or_never", "without_empty_globs"]

ADDED = {"explanation/decisions/README": ("0*",)}
"""Pages that get a hidden table of contents when the site is built, to keep their files plain."""

_TOCTREE = re.compile(r"^(?P<fence>`{3,}|:{3,})\{toctree\}\n(?P<body>.*?)^(?P=fence)$", re.MULTILINE | re.DOTALL)


def pages_of(docs: Path) -> set[str]:
    """Return the names of all pages in a folder: paths without their suffix."""
    return {
        file.relative_to(docs).with_suffix("").as_posix()
        for file in docs.rglob("*.md")
        if not any(part.startswith(("_", ".")) for part in file.relative_to(docs).parts)
    }


def added_toctree(page: str) -> str:
    """Return the hidden table of contents that is added to a page, or an empty string."""
    entries = ADDED.get(page)
    return "\n\n```{toctree}\n:hidden:\n:glob:\n\n" + "\n".join(entries) + "\n```\n" if entries else ""


def without_empty_globs(docs: Path, page: str, text: str) -> str:
    """Return a page without the patterns in its tables of contents that match no page."""
    pages = pages_of(docs)

    def kept(table: re.Match[str]) -> str:
        lines = table[0].splitlines(keepends=True)
        return "".join(line for line in lines if "*" not in line or _named(page, line.strip(), pages))

    return _TOCTREE.sub(kept, text)


def parents_of(docs: Path) -> dict[str, list[str]]:
    """Return for every page the pages whose tables of contents list it, once per entry.

    Parameters
    ----------
    docs
        The folder of the pages.

    Raises
    ------
    ValueError
        If a table names a page that does not exist.
    """
    pages = pages_of(docs)
    found: dict[str, list[str]] = {page: [] for page in pages}
    for page in sorted(pages):
        text = (docs / f"{page}.md").read_text(encoding="utf-8") + added_toctree(page)
        for entry in _entries(text):
            for child in _named(page, entry, pages):
                found[child].append(page)
    return found


def _entries(text: str) -> list[str]:
    lines = [line.strip() for body in _TOCTREE.finditer(text) for line in body["body"].splitlines()]
    lines = [line for line in lines if line and not line.startswith((":", "#"))]
    return [found[1] if (found := re.search(r"<(.+)>$", line)) else line for line in lines]


def _named(page: str, entry: str, pages: set[str]) -> list[str]:
    path = _normal(PurePosixPath(page).parent / entry)
    if "*" in path:
        # A table of contents never lists its own page.
        others = pages - {page}
        return sorted(one for one in others if PurePosixPath(one).match(path) and one.count("/") == path.count("/"))
    if path not in pages:
        msg = f"{page}.md names the page '{entry}', which does not exist"
        raise ValueError(msg)
    return [path]


def _normal(path: PurePosixPath) -> str:
    parts: list[str] = []
    for part in path.parts:
        if part == "..":
            parts.pop()
        else:
            parts.append(part)
    return "/".join(parts)


def twice_or_never(docs: Path) -> dict[str, list[str]]:
    """Return the pages that are not listed in exactly one table of contents, except the home page."""
    found = parents_of(docs)
    return {page: parents for page, parents in found.items() if len(parents) != (page != "index")}
