"""What rules of the source read in modules: imports, classes, functions and names, of each file once.

Text and code are separated by a regular expression; parsing all files takes several times as long.
"""

from __future__ import annotations

import ast
import re
import textwrap
from functools import cache
from pathlib import Path
from typing import NamedTuple

__all__ = ["COMMENT_OR_STRINGS", "STRING", "SourceFacts", "crowded_in", "facts_of"]

_QUOTED = r'''"""(?:\\.|[^\\])*?"""|\'\'\'(?:\\.|[^\\])*?\'\'\'|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*\''''
STRING = re.compile(rf"([a-z]{{0,2}})({_QUOTED})", re.IGNORECASE | re.DOTALL)
COMMENT_OR_STRINGS = re.compile(
    rf"(?P<comment>#[^\n]*)|(?P<strings>(?:[a-z]{{0,2}}(?:{_QUOTED})\s*)+)", re.I | re.DOTALL
)
"""A comment, or strings that follow each other."""
_IMPORT = re.compile(r"^([ \t]*(?:from [\w.]+ import (?:\([^)]*\)|[^(\n;]+)|import [^\n;]+))", re.MULTILINE)
_CLASS = re.compile(r"^class ([a-zA-Z]\w*)", re.MULTILINE)
_HEADER = re.compile(r"\bdef \w+.*?:\s*$|\blambda\b.{0,400}", re.MULTILINE | re.DOTALL)


class SourceFacts(NamedTuple):
    """What a module imports, defines and names."""

    imports: tuple[ast.Import | ast.ImportFrom, ...]
    """Import statements, also those in functions and for type checkers only."""
    public_classes: tuple[str, ...]
    """Those at the top."""
    texts: tuple[str, ...]
    """Strings with the name of the package before a dot."""


def facts_of(file: Path) -> SourceFacts:
    """Return the facts of a file; the same text is read once."""
    return _facts_of_text(file.read_text(encoding="utf-8"))


@cache
def _facts_of_text(text: str) -> SourceFacts:
    found = [match["strings"] for match in COMMENT_OR_STRINGS.finditer(text) if match["strings"]]
    texts = ("".join(quoted.strip("\"'") for _, quoted in STRING.findall(strings)) for strings in found)
    code = _without_text(text)
    imports: list[ast.Import | ast.ImportFrom] = []
    for statement in _IMPORT.findall(code):
        (node,) = ast.parse(textwrap.dedent(statement)).body
        assert isinstance(node, ast.Import | ast.ImportFrom)
        imports.append(node)
    return SourceFacts(tuple(imports), tuple(_CLASS.findall(code)), tuple(t for t in texts if "scenetruth." in t))


@cache
def _without_text(text: str) -> str:
    """Return the code of a module, in the same lines, with empty strings and without comments."""

    def emptied(match: re.Match[str]) -> str:
        if match["comment"]:
            return ""
        end = match[0][len(match[0].rstrip()) :]
        return '""' + "\n" * (match[0].count("\n") - end.count("\n")) + end

    return COMMENT_OR_STRINGS.sub(emptied, text)


def crowded_in(file: Path, most: int) -> list[tuple[int, str, int]]:
    """Return line and name of the functions that take more arguments by position than ``most``, and how many."""
    text = file.read_text(encoding="utf-8")
    # Few modules have as many commas in any list of parameters.
    if all(header.count(",") < most for header in _HEADER.findall(_without_text(text))):
        return []
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            name = "lambda" if isinstance(node, ast.Lambda) else node.name
            count = len(node.args.posonlyargs) + len(node.args.args)
            found += [(node.lineno, name, count)] if count > most else []
    return found
