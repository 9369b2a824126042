"""Former addresses of pages lead to pages that exist, and hide none."""

from __future__ import annotations

from pathlib import Path

import pytest

from scenetruth_site import redirects as module
from scenetruth_site.dead_links import dead_links
from scenetruth_site.redirects import redirects, write_redirects
from scenetruth_site.toctrees import pages_of

DOCS = Path(__file__).parents[2] / "docs"


def test_redirects_lead_to_pages_and_hide_none() -> None:
    pages = pages_of(DOCS) | {file.relative_to(DOCS).with_suffix("").as_posix() for file in DOCS.rglob("*.html")}
    table = redirects()
    assert set(table.values()) <= pages
    assert not set(table) & pages
    assert table["command_line"] == "how_to/run_from_cli"


def test_a_redirect_is_a_page_with_a_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "redirects", lambda: {"old/one": "new/two"})
    (tmp_path / "new").mkdir()
    with pytest.raises(ValueError, match="'new/two', which does not exist"):
        write_redirects(tmp_path)
    (tmp_path / "new" / "two.html").write_text("<p>")
    (file,) = write_redirects(tmp_path)
    assert 'href="../new/two.html"' in file.read_text(encoding="utf-8")
    assert dead_links(tmp_path) == []
    assert write_redirects(tmp_path) == [file]


def test_a_redirect_never_replaces_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "redirects", lambda: {"one": "two"})
    for name in ("one", "two"):
        (tmp_path / f"{name}.html").write_text("<p>")
    with pytest.raises(ValueError, match="'one' is the address of a page"):
        write_redirects(tmp_path)
