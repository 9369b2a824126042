"""Pages as the site takes them: plain headings, files of the repository, generated parts."""

from __future__ import annotations

from pathlib import Path

import pytest

from scenetruth_site.generated import fill_in, generated_parts
from scenetruth_site.site_text import site_text

ROOT = Path(__file__).parents[2]


@pytest.fixture
def docs(tmp_path: Path) -> Path:
    (tmp_path / "docs" / "sub").mkdir(parents=True)
    (tmp_path / "docs" / "one.md").write_text("")
    return tmp_path / "docs"


def test_headings_hold_plain_words(docs: Path) -> None:
    text = "## [cube](../scenes/cube.yaml)\n\nA [link](one.md) in text.\n"
    assert (
        site_text(docs, "gallery", text)
        == "## cube\n\n[`cube.yaml`](../scenes/cube.yaml)\n\nA [link](one.md) in text.\n"
    )


def test_markdown_outside_is_offered_as_a_file(docs: Path) -> None:
    text = "[mine](../examples/own/README.md), [inside](../one.md), [away](../../README.md)"
    assert (
        site_text(docs, "sub/two", text)
        == "[mine](../examples/own/README.md), [inside](../one.md), [away](path:../../README.md)"
    )
    assert site_text(docs, "two", text).startswith("[mine](path:../examples/own/README.md)")


def test_generated_parts_are_filled_in() -> None:
    page = "# Errors\n\n<!-- generated: api errors -->\n"
    assert generated_parts(page) == ["api errors"]
    assert ".. autoexception:: SceneError" in fill_in(page)
    with pytest.raises(ValueError, match="unknown generated part 'scene dreams of'"):
        fill_in("<!-- generated: scene dreams of -->")


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "tutorials").glob("*.md")), ids=lambda path: path.stem)
def test_code_of_tutorials_fits_the_column_of_the_site(page: Path) -> None:
    # 88 columns of 0.8 rem are 45 of the 56 rem of the column.
    inside, wide = False, []
    for line in page.read_text(encoding="utf-8").splitlines():
        inside ^= line.startswith("```")
        if inside and len(line) > 88 and not line.lstrip().startswith("alt:"):
            wide.append(line)
    assert wide == []
