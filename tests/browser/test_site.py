"""The built site in a headless browser: accessible, no wider than the window, equations set, search at work."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SITE = Path(__file__).parents[2] / "outputs" / "site"
playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright: make browser")
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs axe: make browser")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="needs the system package chromium: make browser"),
    pytest.mark.skipif(not (SITE / "index.html").is_file(), reason="needs the site: make docs"),
]

PAGES = (
    "index.html",
    "how_to/index.html",
    "reference/api/simulation.html",
    "reference/scene_file/camera.html",
    "reference/method.html",
    "tutorials/03_growing_leaf.html",
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as started:
        # In a container there is no sandbox for root.
        browser = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


def opened(browser: Any, address: str, width: int, scheme: str) -> Any:
    """Open a page of the site; what it loads from elsewhere is noted in ``page.elsewhere``."""
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page.elsewhere = []
    page.on("request", lambda one: None if one.url.startswith(("file:", "data:")) else page.elsewhere.append(one.url))
    page.goto(f"{SITE.as_uri()}/{address}")
    page.wait_for_load_state("networkidle")
    return page


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 375])
@pytest.mark.parametrize("address", PAGES)
def test_pages_are_accessible_and_fit(browser: Any, address: str, width: int, scheme: str) -> None:
    page = opened(browser, address, width, scheme)
    found = axe.Axe().run(page).response["violations"]
    assert [(one["id"], [node["html"] for node in one["nodes"][:3]]) for one in found] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.elsewhere == []
    page.close()


def test_equations_are_set_without_a_network(browser: Any) -> None:
    page = opened(browser, "reference/method.html", 1280, "light")
    page.wait_for_selector("mjx-container svg")
    assert page.locator("div.math mjx-container").count() == page.locator("div.math").count() > 8
    assert page.locator("mjx-merror").count() == 0
    assert page.elsewhere == []
    page.close()


def test_search_finds_a_field_without_a_server(browser: Any) -> None:
    page = opened(browser, "search.html?q=baseline_mm", 1280, "light")
    page.wait_for_selector("#search-results li a")
    assert any("Stage" in text for text in page.locator("#search-results li a").all_text_contents())
    assert page.elsewhere == []
    page.close()
