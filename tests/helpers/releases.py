"""Releases of the changelog."""

from __future__ import annotations

import re
from pathlib import Path

__all__ = ["ROOT", "releases", "unreleased"]


ROOT = Path(__file__).parents[2]


def releases() -> list[tuple[str, str]]:
    """Return the versions of the changelog and their dates, the latest first."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## (.*)$", text, re.MULTILINE)
    assert headings[0] == "[Unreleased]"
    found = [re.fullmatch(r"\[(\d+\.\d+\.\d+)\] - (\d{4}-\d\d-\d\d)", heading) for heading in headings[1:]]
    assert found
    assert None not in found, headings
    return [(one.group(1), one.group(2)) for one in found if one is not None]


def unreleased() -> str:
    """Return the changes since the latest release."""
    return (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## ")[1].partition("\n")[2].strip()
