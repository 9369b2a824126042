"""The drawing of a rig in the README has the dimensions of its design page."""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"
TEXT = re.compile(r"<text[^>]*>([^<]*)</text>")


def test_the_rig_of_the_readme_is_that_of_its_page() -> None:
    drawn = " ".join(TEXT.findall((DOCS / "door_design.svg").read_text(encoding="utf-8")))
    page = " ".join(
        TEXT.findall((DOCS / "results" / "worked_examples" / "pages" / "leaf_growth.html").read_text(encoding="utf-8"))
    )
    figures = re.findall(r"[\d.]+ (?:mm|positions|px)", drawn)
    assert {"598 mm", "9 positions", "1.5 px"} <= set(figures)
    assert len(figures) >= 7
    assert all(figure in page for figure in figures)
