"""The docstrings that stand behind the fields of a class, which Python does not keep."""

from __future__ import annotations

import ast
import inspect
import sys
from functools import lru_cache

__all__ = ["field_docstrings"]


def field_docstrings(cls: type) -> dict[str, str]:
    """Return what the source of a class, and of those it is derived from, says of their fields.

    Parameters
    ----------
    cls
        The class.

    Returns
    -------
    dict
        Docstrings by the names of the fields; without those of classes whose source cannot be read.

    Examples
    --------
    >>> from scenetruth.estimators.structure_tensor.settings import StructureTensorSettings
    >>> field_docstrings(StructureTensorSettings)["window_sigma_frames"]
    'Standard deviation of the Gaussian window B in t, in frames.'
    """
    found: dict[str, str] = {}
    for part in reversed(cls.__mro__):
        found |= _docstrings_of_module(part.__module__).get(part.__qualname__, {})
    return found


@lru_cache(maxsize=256)
def _docstrings_of_module(name: str) -> dict[str, dict[str, str]]:
    """Return the docstrings of fields by class, as its ``__qualname__``."""
    try:
        tree = ast.parse(inspect.getsource(sys.modules[name]))
    except (KeyError, OSError, TypeError, SyntaxError):
        return {}
    found: dict[str, dict[str, str]] = {}

    def visit(node: ast.AST, inside: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.ClassDef):
                found[inside + child.name] = _of_fields(child)
                visit(child, f"{inside}{child.name}.")
            elif isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                visit(child, f"{inside}{child.name}.<locals>.")

    visit(tree, "")
    return found


def _of_fields(node: ast.ClassDef) -> dict[str, str]:
    told = {}
    for field, behind in zip(node.body, node.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(behind, ast.Expr):
            value = behind.value
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                told[field.target.id] = inspect.cleandoc(value.value)
    return told
