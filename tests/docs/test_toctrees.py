"""Every page of the documentation stands in exactly one table of contents."""

from __future__ import annotations

from pathlib import Path

import pytest

from scenetruth_site.toctrees import ADDED, added_toctree, pages_of, parents_of, twice_or_never, without_empty_globs

DOCS = Path(__file__).parents[2] / "docs"


def test_every_page_stands_in_exactly_one_table() -> None:
    assert twice_or_never(DOCS) == {}


def test_pages_that_get_a_table_exist() -> None:
    assert set(ADDED) <= pages_of(DOCS)
    assert parents_of(DOCS)["explanation/decisions/0001-pyrender-maintained-for-opengl"] == [
        "explanation/decisions/README"
    ]


def test_the_rule_sees_pages_that_are_left_out_or_stand_twice(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "index.md").write_text("```{toctree}\n:hidden:\n\none\nA title <two>\nsub/index\n```\n")
    (tmp_path / "sub" / "index.md").write_text("```{toctree}\n:glob:\n\n../t*\n*\n```\n")
    for name in ("one", "two", "three", "sub/four"):
        (tmp_path / f"{name}.md").write_text(f"# {name}\n")
    assert twice_or_never(tmp_path) == {"two": ["index", "sub/index"]}
    (tmp_path / "sub" / "index.md").write_text("# Nothing\n")
    assert set(twice_or_never(tmp_path)) == {"three", "sub/four"}


def test_a_table_that_names_no_page_is_refused(tmp_path: Path) -> None:
    (tmp_path / "index.md").write_text("```{toctree}\nnowhere\n```\n")
    with pytest.raises(ValueError, match=r"index\.md names the page 'nowhere'"):
        parents_of(tmp_path)


def test_patterns_that_match_nothing_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "index.md").write_text("")
    (tmp_path / "one.md").write_text("")
    text = "**bold**\n\n```{toctree}\n:glob:\n\nn*\no*\n```\n"
    assert without_empty_globs(tmp_path, "index", text) == "**bold**\n\n```{toctree}\n:glob:\n\no*\n```\n"


def test_only_some_pages_get_a_table() -> None:
    assert added_toctree("index") == ""
    assert ":glob:" in added_toctree("explanation/decisions/README")
