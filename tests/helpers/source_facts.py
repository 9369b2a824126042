"""What rules of the source look at: imports, classes, functions and names of modules, of each file read once."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
from typing import NamedTuple

__all__ = ["SourceFacts", "facts_of"]


class SourceFacts(NamedTuple):
    """What a module imports, defines and names."""

    imports: tuple[ast.Import | ast.ImportFrom, ...]
    """Import statements, also those in functions and for type checkers only."""
    public_classes: tuple[str, ...]
    """Those at the top."""
    parameters: tuple[tuple[int, str, int], ...]
    """Line and name of each function, and how many arguments may be given by position."""
    texts: tuple[str, ...]
    """Strings with the name of the package before a dot."""


def facts_of(file: Path) -> SourceFacts:
    """Return the facts of a file; the same text is parsed once."""
    return _facts_of_text(file.read_text(encoding="utf-8"))


@cache
def _facts_of_text(text: str) -> SourceFacts:
    tree = ast.parse(text)
    imports: list[ast.Import | ast.ImportFrom] = []
    parameters, texts = [], []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            imports.append(node)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            name = "lambda" if isinstance(node, ast.Lambda) else node.name
            parameters.append((node.lineno, name, len(node.args.posonlyargs) + len(node.args.args)))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "scenetruth." in node.value:
            texts.append(node.value)
    classes = (node.name for node in tree.body if isinstance(node, ast.ClassDef))
    public = tuple(name for name in classes if not name.startswith("_"))
    return SourceFacts(tuple(imports), public, tuple(parameters), tuple(texts))
