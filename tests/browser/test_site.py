"""The built site in a headless browser: accessible, no wider than the window, equations set, search at work."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.helpers.browser_pages import opened, reads_well

SITE = Path(__file__).parents[2] / "outputs" / "site"
pytestmark = pytest.mark.skipif(not (SITE / "index.html").is_file(), reason="needs the site: make docs")

# The page of what is not found has addresses that only a server knows; what lies in _static is no page.
PAGES = sorted(
    str(file.relative_to(SITE))
    for file in SITE.rglob("*.html")
    if file.name != "404.html" and "_static" not in file.relative_to(SITE).parts
)


@pytest.mark.parametrize(("width_px", "scheme"), [(1280, "light"), (375, "dark")])
@pytest.mark.parametrize("address", PAGES)
def test_pages_are_accessible_and_fit(browser: Any, address: str, width_px: int, scheme: str) -> None:
    with opened(browser, SITE / address) as page:
        page.wait_for_load_state("networkidle")
        reads_well(page, width_px, scheme)


def test_equations_are_set_without_a_network(browser: Any) -> None:
    with opened(browser, SITE / "explanation/structure_tensor.html", "mjx-container svg") as page:
        assert page.locator("div.math mjx-container").count() == page.locator("div.math").count() > 8
        assert page.locator("mjx-merror").count() == 0


def test_search_finds_a_field_without_a_server(browser: Any) -> None:
    # Excerpts would come from a server.
    allowed = ("Access to fetch at 'file:", "Failed to fetch", "net::ERR_FAILED")
    with opened(browser, SITE / "search.html", "#search-results li a", "?q=baseline_mm", allowed) as page:
        page.locator("#search-results li a", has_text="Stage").first.wait_for()
