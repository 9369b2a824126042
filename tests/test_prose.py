"""Prose uses the field's terms: expressions that the glossary replaces do not occur in it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.helpers.command_line import help_texts
from tests.helpers.source_facts import COMMENT_OR_STRINGS, STRING

ROOT = Path(__file__).parents[1]
FORBIDDEN = re.compile(
    r"\b(tells?|told|known|found|honest(?:ly)?|worth|slips?|strangers?|shel(?:f|ves)|helping|aside|sight|ways?|ledgers?"
    r"|facts?|lighter|ones|whoever|one's own|at once|beside|next to nothing|leads? astray|puts? away|made of"
    r"|says? nothing|goes on where|every day|houses?|rooms?|kinds?|look(?:s|ed)? at|glimpses?|foresee[ns]?)\b",
    re.IGNORECASE,
)
ALLOWED = re.compile(r"\bnot found\b|\bhalf-way\b|\bfar-sight|\bway[- ]?point|\bkind: ", re.IGNORECASE)
"""Ordinary uses of these words, and the key of YAML files."""

TEMPLATE = re.compile(r"\{[{%#].*?[}%#]\}", re.DOTALL)
"""Code in templates of pages."""

INSERTED = re.compile(r"(?<!\{)\{(?!\{)[^{}]*\}")
"""Code in f-strings, the texts of which are read, too."""
IN_CODE = re.compile(r"""'(.*?)'|"(.*?)\"""")
ESCAPES = {"n": "\n", "\n": ""}
"""What escapes stand for, if it is not part of a word."""

PAGES = sorted([*ROOT.glob("docs/**/*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md"])
NOT_PROSE = {"docs/reference/glossary.md"}
"""Pages that list the words."""


def offences(text: str) -> list[str]:
    """Return the forbidden expressions of a text, in order, without those in code."""
    text = re.sub(r"``.*?``|`[^`]*`|https?://\S+|\]\([^)]*\)", " ", text, flags=re.DOTALL)
    return FORBIDDEN.findall(ALLOWED.sub(" ", text))


def prose_of_module(text: str) -> Iterator[tuple[int, str]]:
    """Yield comments, docstrings and other texts of a module with their lines; no examples, no names of parameters."""
    for found in COMMENT_OR_STRINGS.finditer(text):
        if " " not in found[0].strip():
            continue
        words = found["comment"]
        if not words:
            words = "".join(value_of_string(*parts) for parts in STRING.findall(found["strings"]))
            words = TEMPLATE.sub(" ", words)
            words = re.sub(r"^ *>>>.*?(?:\n\s*\n|\Z)", "\n", words, flags=re.MULTILINE | re.DOTALL)
            words = re.sub(r"(?<=\n) *[\w*]+(?:, [\w*]+)*$", "", words, flags=re.MULTILINE)
        yield text.count("\n", 0, found.start()) + 1, words


def value_of_string(prefix: str, quoted: str) -> str:
    """Return what a string of a module says, with spaces where f-strings insert a value."""
    inner = quoted[3:-3] if quoted.startswith(('"""', "'''")) else quoted[1:-1]
    if "r" not in prefix.lower() and "\\" in inner:
        inner = re.sub(r"\\(\n|N\{.*?\}|.)", lambda escape: ESCAPES.get(escape[1], " "), inner, flags=re.DOTALL)
    if "f" in prefix.lower():
        while INSERTED.search(inner):  # from the innermost outwards
            inner = INSERTED.sub(lambda code: " ".join(["", *map("".join, IN_CODE.findall(code[0])), ""]), inner)
        inner = inner.replace("{{", "{").replace("}}", "}")
    return inner if inner[-1:].isspace() else f"{inner} "


PACKAGES = sorted(
    path.name
    for path in (ROOT / "src" / "scenetruth").iterdir()
    if path.suffix == ".py" or (path.is_dir() and path.name != "__pycache__")
)


@pytest.mark.parametrize("package", PACKAGES)
def test_source(package: str) -> None:
    path = ROOT / "src" / "scenetruth" / package
    files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
    wrong = {
        f"{file.relative_to(ROOT)}:{line}": words
        for file in files
        for line, text in prose_of_module(file.read_text(encoding="utf-8"))
        if (words := offences(text))
    }
    assert not wrong


TEMPLATES = sorted((ROOT / "src" / "scenetruth").rglob("*.j2"))


@pytest.mark.parametrize("template", TEMPLATES, ids=lambda path: path.name)
def test_template(template: Path) -> None:
    text = TEMPLATE.sub(" ", template.read_text(encoding="utf-8"))
    text = re.sub(r"<(script|style)\b.*?</\1>|<[^>]*>", " ", text, flags=re.DOTALL)
    assert offences(text) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_page(page: Path) -> None:
    if str(page.relative_to(ROOT)) in NOT_PROSE:
        pytest.skip("lists the words")
    text = re.sub(r"^```.*?^```|^    .*?$", " ", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    assert offences(text) == []


def test_changelog_of_this_version() -> None:
    newest = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## ")[1]
    assert offences(newest) == []


def test_help() -> None:
    wrong = {command: words for command, text in help_texts().items() if (words := offences(text))}
    assert not wrong


def test_what_the_scan_sees() -> None:
    assert offences("It is told at once; `told` and ``worth`` are code, not found is English.") == ["told", "at once"]
    module = (
        '"""What is known.\n\n    >>> told = 1\n    """\nx = f"a {found} told"  # beside\n'
        "y = (\n    'a \\'slip\\' at '\n    'once # \\nones'\n)\nz = f\"{'worth it' if told else ''}\"  # in 'sight\n"
    )
    found = [(line, word) for line, text in prose_of_module(module) for word in offences(text)]
    assert found == [
        (1, "known"),
        *((5, word) for word in ("told", "beside")),
        *((7, word) for word in ("slip", "at once", "ones")),
        *((10, word) for word in ("worth", "sight")),
    ]
