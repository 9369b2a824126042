"""Tutorials are notebooks in text that can run: their form, their names, their places. The site's build runs them."""

from __future__ import annotations

import ast
import builtins
import re
import textwrap
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest
import yaml

import scenetruth as st
from scenetruth_site.toctrees import parents_of

DOCS = Path(__file__).parents[2] / "docs"
TUTORIALS = sorted(path for path in (DOCS / "tutorials").glob("*.md") if path.name != "index.md")
HEADER = {
    "jupytext": {"text_representation": {"extension": ".md", "format_name": "myst"}},
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
}

_FENCE = re.compile(r"^(`{3,}|:{3,})(.*)$")
_LINK = re.compile(r"\]\(((?!\w+:|#)[^)#\s]+\.md)")


def cells_of(text: str) -> list[str]:
    """Return the code of a notebook's cells; complains of fences that are left open."""
    cells: list[str] = []
    opened: tuple[str, str, list[str]] | None = None
    for line in text.splitlines():
        found = _FENCE.match(line)
        if opened is None:
            if found:
                opened = (found[1], found[2].strip(), [])
        elif found and found[1] == opened[0] and not found[2]:
            if opened[1].startswith("{code-cell}"):
                cells.append("\n".join(_without_options(opened[2])))
            opened = None
        else:
            opened[2].append(line)
    assert opened is None, f"the block {opened[1] if opened else ''!r} is left open"
    return cells


def _without_options(lines: list[str]) -> list[str]:
    if lines and lines[0] == "---":
        return lines[lines.index("---", 1) + 1 :]
    while lines and re.match(r":[\w-]+:", lines[0]):
        lines = lines[1:]
    return lines


def wrong_names(cells: list[str]) -> Iterator[str]:
    """Name what cells take from scenetruth that is not public, and names that nothing makes."""
    tree = ast.parse("\n".join(cells))
    made, used, ours = set(dir(builtins)), set[str](), set[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            made |= {(alias.asname or alias.name).partition(".")[0] for alias in node.names}
        if isinstance(node, ast.Import):
            ours |= {alias.asname or alias.name for alias in node.names if alias.name == "scenetruth"}
            yield from (alias.name for alias in node.names if alias.name.startswith("scenetruth."))
        elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "scenetruth":
            yield from _not_in(node.module or "", [alias.name for alias in node.names])
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            made.add(node.name)
        elif isinstance(node, ast.arg):
            made.add(node.arg)
        elif isinstance(node, ast.ExceptHandler):
            made.add(node.name or "")
        elif isinstance(node, ast.Name):
            (used if isinstance(node.ctx, ast.Load) else made).add(node.id)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in ours:
            public = node.attr in st.__all__ or node.attr == "__version__"
            yield from [] if public else [f"{node.value.id}.{node.attr}"]
    yield from sorted(used - made)


def _not_in(module: str, names: list[str]) -> Iterator[str]:
    if any(part.startswith("_") for part in module.split(".")):
        yield module
        return
    public: list[str] = getattr(import_module(module), "__all__", [])
    for name in names:
        # A room, as in `from scenetruth import scoring`, is public too.
        if name not in public and not isinstance(getattr(import_module(module), name, None), ModuleType):
            yield f"{module}.{name}"


def absolute_paths(cells: list[str]) -> list[str]:
    """Return the texts in cells that only one machine knows."""
    texts = [node.value for node in ast.walk(ast.parse("\n".join(cells))) if isinstance(node, ast.Constant)]
    return [text for text in texts if isinstance(text, str) and re.match(r"/\w|~/|[A-Z]:\\", text)]


def test_there_are_tutorials() -> None:
    assert len(TUTORIALS) >= 4


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_is_a_notebook_in_text(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    _, header, page = text.split("---\n", 2)
    title = re.match(r"\n# \S.*\n", page)
    assert yaml.safe_load(header) == HEADER
    assert re.fullmatch(r"\d\d_[a-z0-9_]+", path.stem)
    assert title
    assert len(cells_of(text)) >= 5


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_cells_are_python_with_public_names_and_paths_of_any_machine(path: Path) -> None:
    cells = cells_of(path.read_text(encoding="utf-8"))
    for cell in cells:
        compile(cell, path.name, "exec")
    assert list(wrong_names(cells)) == []
    assert absolute_paths(cells) == []


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_is_in_the_index_and_leads_on(path: Path) -> None:
    assert parents_of(DOCS)[f"tutorials/{path.stem}"] == ["tutorials/index"]
    text = path.read_text(encoding="utf-8")
    assert "\n## Try\n" in text
    links = _LINK.findall(text)
    assert links
    assert [link for link in links if not (path.parent / link).is_file()] == []


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_figures_are_told_to_those_who_do_not_see_them(path: Path) -> None:
    blocks = re.findall(r"```\{code-cell\}[^\n]*\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL)
    drawn = [block for block in blocks if "plt.subplots(" in block or "plt.figure(" in block]
    assert drawn
    for block in drawn:
        options = yaml.safe_load(block.split("---\n")[1]) if block.startswith("---\n") else {}
        told = options.get("mystnb", {}).get("image", {}).get("alt", "")
        assert len(told.split()) >= 5, block


def test_numbers_of_tutorials_are_given_once() -> None:
    numbers = [path.stem[:2] for path in TUTORIALS]
    assert len(set(numbers)) == len(numbers)


def test_cells_are_found_without_their_options() -> None:
    text = textwrap.dedent(
        """\
        ```{code-cell} ipython3
        :tags: [hide-input]
        a = 1
        ```

        ```python
        not a cell
        ```

        ```{code-cell}
        ---
        tags: [hide-output]
        ---
        b = a
        ```
        """
    )
    assert cells_of(text) == ["a = 1", "b = a"]
    with pytest.raises(AssertionError, match="is left open"):
        cells_of("```{code-cell}\na = 1\n")


def test_names_that_are_not_public_or_that_nothing_makes_are_seen() -> None:
    cells = [
        "import scenetruth as st\nfrom scenetruth.scoring import score, secret\nfrom scenetruth.scene._x import y",
        "from scenetruth import scoring\nst.simulate(st.dream('a'))\nfor one in [score, lost]:\n    one()",
    ]
    assert list(wrong_names(cells)) == ["scenetruth.scoring.secret", "scenetruth.scene._x", "st.dream", "lost"]


def test_paths_of_one_machine_are_seen() -> None:
    assert absolute_paths(["a = '/home/me/part.obj'\nb = 'out/part.obj'\nc = 3 / 4\nd = '~/x'"]) == [
        "/home/me/part.obj",
        "~/x",
    ]
