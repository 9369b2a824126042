"""Redirects from former addresses of pages to their present addresses."""

from __future__ import annotations

import html
import posixpath
from functools import lru_cache
from pathlib import Path

import yaml

__all__ = ["redirects", "write_redirects"]

_STUB = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>This page has moved</title>
<meta http-equiv="refresh" content="0; url={target}"><meta name="robots" content="noindex">
<script>location.replace("{target}" + location.hash)</script></head>
<body><main><h1>This page has moved</h1><p><a href="{target}">{name}</a></p></main></body></html>
"""


@lru_cache
def redirects() -> dict[str, str]:
    """Return the former names of pages, each with the name of the page that replaces it."""
    text = Path(__file__).with_name("redirects.yaml").read_text(encoding="utf-8")
    table: dict[str, str] = yaml.safe_load(text)
    return table


def write_redirects(site: Path) -> list[Path]:
    """Write a page at every former address and return their files.

    Parameters
    ----------
    site
        The directory of the built site.

    Raises
    ------
    ValueError
        If the table names a page that does not exist, or replaces a page that does.
    """
    written = []
    for former, page in redirects().items():
        file, target = site / f"{former}.html", site / f"{page}.html"
        if not target.is_file():
            msg = f"redirects.yaml: '{former}' leads to '{page}', which does not exist"
            raise ValueError(msg)
        if file.is_file() and "This page has moved" not in file.read_text(encoding="utf-8"):
            msg = f"redirects.yaml: '{former}' is the address of a page"
            raise ValueError(msg)
        file.parent.mkdir(parents=True, exist_ok=True)
        uri = html.escape(posixpath.relpath(f"{page}.html", posixpath.dirname(former) or "."))
        file.write_text(_STUB.format(target=uri, name=html.escape(page)), encoding="utf-8")
        written.append(file)
    return written
