"""The headless browser that all tests of pages share; without it they are skipped."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import Any

import pytest


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium of the system, by playwright."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright: make browser")
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        pytest.skip("needs the system package chromium: make browser")
    with playwright.sync_playwright() as started:
        # In a container there is no sandbox for root.
        opened = started.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield opened
        opened.close()
