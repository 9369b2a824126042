"""Find dead links in a built site: ``python -m scenetruth_site.dead_links FOLDER``."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

__all__ = ["BuiltPage", "dead_links", "external_links", "main", "read_site"]

_ATTRIBUTES = {"a": "href", "link": "href", "img": "src", "script": "src", "iframe": "src", "source": "src"}
_SCHEMES = ("http", "https", "mailto")


@dataclass
class BuiltPage:
    """Links and anchors of an HTML page.

    Parameters
    ----------
    anchors
        Its ``id`` and ``name`` attributes.
    links
        Targets of ``a`` elements.
    loaded
        Addresses of resources loaded by the page: images, scripts, style sheets, frames.
    """

    anchors: set[str] = field(default_factory=set)
    links: list[str] = field(default_factory=list)
    loaded: list[str] = field(default_factory=list)


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.page = BuiltPage()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.page.anchors |= {given[name] for name in ("id", "name") if name in given}
        target = given.get(_ATTRIBUTES.get(tag, ""))
        if target and not (tag == "link" and given.get("rel") == "canonical"):
            (self.page.links if tag == "a" else self.page.loaded).append(target)


def read_site(folder: Path) -> dict[Path, BuiltPage]:
    """Return all pages of a built site by their files."""
    found = {}
    for file in sorted(folder.rglob("*.html")):
        # Templates of the theme among its static files are not pages.
        if file.relative_to(folder).parts[0] == "_static":
            continue
        reader = _Reader()
        reader.feed(file.read_text(encoding="utf-8"))
        found[file.resolve()] = reader.page
    return found


def dead_links(folder: Path) -> list[str]:
    """Return the dead links of a site, one line each.

    Parameters
    ----------
    folder
        The site. Links that begin with ``/`` are relative to it.

    Returns
    -------
    list
        Links to files or anchors that do not exist, and resources that a page would load from other hosts.
    """
    pages = read_site(folder)
    return [f"{file.relative_to(folder.resolve())}: {wrong}" for file in pages for wrong in _wrong(file, pages, folder)]


def _wrong(file: Path, pages: dict[Path, BuiltPage], folder: Path) -> Iterator[str]:
    page = pages[file]
    yield from (f"loads {url}" for url in page.loaded if urlsplit(url).scheme in _SCHEMES or url.startswith("//"))
    for url in dict.fromkeys([*page.links, *page.loaded]):
        parts = urlsplit(url)
        if parts.scheme or parts.netloc:
            continue
        path = unquote(parts.path)
        target = folder.resolve() / path.lstrip("/") if path.startswith("/") else file.parent / path
        target = (file if not path else target).resolve()
        if target.is_dir():
            target /= "index.html"
        if not target.exists():
            yield f"{url} leads to no file"
        elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
            yield f"{url} leads to no anchor"


def external_links(folder: Path) -> list[str]:
    """Return the external addresses that the site links to."""
    links = {url for page in read_site(folder).values() for url in page.links if urlsplit(url).scheme in _SCHEMES}
    return sorted(links)


def main(words: list[str]) -> int:
    """Print the dead links of a site, and write its external links; return 1 if there are dead links."""
    folder = Path(words[0])
    found = dead_links(folder)
    print(*found, sep="\n", end="\n" if found else "")
    outside = external_links(folder)
    (folder / "external_links.txt").write_text("".join(f"{url}\n" for url in outside), encoding="utf-8")
    print(f"{len(read_site(folder))} pages, {len(found)} dead links, {len(outside)} addresses elsewhere")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
