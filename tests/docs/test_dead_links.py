"""Links of a built site that lead nowhere are found, and only those."""

from __future__ import annotations

from pathlib import Path

import pytest

from scenetruth_site.dead_links import dead_links, external_links, main

GOOD = """<html><head><link rel="stylesheet" href="_static/style.css?digest=1"><link rel="canonical" href="https://one.org/">
</head><body><h1 id="top">A</h1><a name="old"></a>
<a href="#top">up</a> <a href="">here</a> <a href="sub/two.html#deep">two</a> <a href="sub/">folder</a>
<a href="/index.html">root</a>
<a href="https://example.org/page#x">away</a> <a href="mailto:a@b.org">post</a> <img src="data:image/png;base64,AA">
</body></html>"""


@pytest.fixture
def site(tmp_path: Path) -> Path:
    (tmp_path / "sub").mkdir()
    (tmp_path / "_static").mkdir()
    (tmp_path / "_static" / "style.css").write_text("")
    (tmp_path / "_static" / "template.html").write_text("<a href='{{ nothing }}'></a>")
    (tmp_path / "index.html").write_text(GOOD)
    (tmp_path / "sub" / "two.html").write_text("<p id='deep'><a href='../index.html#old'>back</a>")
    (tmp_path / "sub" / "index.html").write_text("<p>")
    return tmp_path


def test_a_good_site_has_none(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert dead_links(site) == []
    assert external_links(site) == ["https://example.org/page#x", "mailto:a@b.org"]
    assert main([str(site)]) == 0
    assert capsys.readouterr().out == "3 pages, 0 dead links, 2 addresses elsewhere\n"
    assert (site / "external_links.txt").read_text().startswith("https://example.org")


@pytest.mark.parametrize(
    ("html", "told"),
    [
        ("<a href='three.html'>x</a>", "three.html leads to no file"),
        ("<a href='two.html#shallow'>x</a>", "two.html#shallow leads to no anchor"),
        ("<a href='#nowhere'>x</a>", "#nowhere leads to no anchor"),
        ("<img src='../picture.png'>", "../picture.png leads to no file"),
        ("<script src='https://cdn.example.org/x.js'></script>", "loads https://cdn.example.org/x.js"),
        ("<link rel='stylesheet' href='//fonts.example.org/f.css'>", "loads //fonts.example.org/f.css"),
    ],
)
def test_what_leads_nowhere_or_needs_a_network_is_told(site: Path, html: str, told: str) -> None:
    (site / "sub" / "index.html").write_text(html)
    assert dead_links(site) == [f"sub/index.html: {told}"]
    assert main([str(site)]) == 1
