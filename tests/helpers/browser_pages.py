"""Pages in the headless browser: opened with an ear on what goes wrong, and judged as readers judge them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

__all__ = ["opened", "reads_well"]

OF_DRIVERS = ("GPU stall", "willReadFrequently")
"""What the browser's own software for graphics, and plotly, warn of."""
OWN = ("file:", "data:", "blob:")
"""Addresses that need no network."""


@contextmanager
def opened(
    browser: Any, file: Path, ready: str = "body", query: str = "", allowed: tuple[str, ...] = (), **options: Any
) -> Iterator[Any]:
    """Open a page, and demand at the end that it loaded nothing from elsewhere and complained of nothing.

    Parameters
    ----------
    browser
        The browser.
    file
        The page.
    ready
        What there is once the page is drawn, as a selector of CSS.
    query
        What stands behind the address, with its question mark.
    allowed
        Words of complaints that are no fault of the page.
    **options
        Of playwright's pages.
    """
    page = browser.new_page(**{"viewport": {"width": 1280, "height": 800}, **options})
    errors: list[str] = []

    def complain(text: str) -> None:
        if not any(words in text for words in (*OF_DRIVERS, *allowed)):
            errors.append(text)

    page.on("console", lambda line: complain(line.text) if line.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: complain(str(error)))
    page.on("request", lambda one: None if one.url.startswith(OWN) else errors.append(one.url))
    page.goto(file.as_uri() + query)
    page.wait_for_selector(ready)
    yield page
    assert errors == []
    # A button that uploads is no part of a page that needs no network.
    assert page.locator(".modebar-btn[data-title^=Share]").count() == 0
    page.close()


def reads_well(page: Any, width_px: int, scheme: str) -> None:
    """Demand that a page is no wider than the window, and that axe finds nothing that shuts readers out.

    Parameters
    ----------
    page
        The page.
    width_px
        Of the window; 375 is a phone.
    scheme
        ``"light"`` or ``"dark"``, as the reader's system has it.
    """
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs axe: make browser")
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": width_px, "height": 800})
    page.evaluate("document.querySelectorAll('main details').forEach((one) => { one.open = true; })")
    page.wait_for_timeout(300)
    assert page.evaluate("document.documentElement.scrollWidth") <= width_px
    # What it would load beforehand, style sheets, may not be read from files.
    found = axe.Axe().run(page, options={"preload": False}).response["violations"]
    assert [(one["id"], [node["html"] for node in one["nodes"][:3]]) for one in found] == []
