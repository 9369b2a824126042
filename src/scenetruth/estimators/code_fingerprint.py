"""Fingerprint of the code of user-defined methods, which detects results of an earlier version."""

from __future__ import annotations

import functools
import hashlib
import inspect
import secrets
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from scenetruth.estimators.external import CommandMethod, ResultsFolder
from scenetruth.estimators.registry import find_method
from scenetruth.estimators.user_code import FunctionMethod, is_user_file, with_imported

__all__ = ["compute_code_fingerprint", "find_code_files"]


def compute_code_fingerprint(method: Any) -> str:
    """Return a hash of the source code of a user-defined method; empty for installed methods.

    The hash covers the file that defines a function or class, or the files that a command names, with all modules of
    the user that they import; or the contents of a results folder. A function typed into an interactive session is
    represented by its source text. Other code that they call is followed by `scenetruth.estimators.code_dependencies`.
    >>> compute_code_fingerprint("structure_tensor")
    ''
    """
    found = find_method(method)
    files, texts = set[Path](), list[str]()
    code = _find_defining_code(found)
    for module in _list_modules(method, code):
        file = getattr(sys.modules.get(module), "__file__", None)
        if file and is_user_file(file):
            mine = with_imported(Path(file))
            files.update(mine)
            texts += [secrets.token_hex()] if _is_outdated(module, mine) else []
        elif module and not file and module not in sys.builtin_module_names:
            texts.append(_read_source_text(code))
    if isinstance(found, CommandMethod):
        for file in found.named_files():
            files.update(with_imported(file))
    if isinstance(found, ResultsFolder):
        texts.append(found.listing())
    if not files and not texts:
        return ""
    values = hashlib.sha256()
    for piece in sorted(_compute_file_hash(file) for file in files):
        values.update(piece)
    for text in texts:
        values.update(hashlib.sha256(text.encode("utf-8", "backslashreplace")).digest())
    return values.hexdigest()[:16]


def find_code_files(method: Any) -> list[Path]:
    """Return the files of the user that define a method or that its command names, without those that they call."""
    found = find_method(method)
    if isinstance(found, CommandMethod):
        return found.named_files()
    modules = _list_modules(method, _find_defining_code(found))
    files = [str(getattr(sys.modules.get(module), "__file__", None) or "") for module in modules]
    return [Path(file) for file in files if file and is_user_file(file)]


def _list_modules(method: Any, code: Any) -> list[str]:
    named = method.partition(":")[0] if isinstance(method, str) and ":" in method else ""
    return list(dict.fromkeys([named, getattr(code, "__module__", "")]))


_LOADED: dict[str, tuple[Any, dict[Path, bytes]]] = {}


def _is_outdated(module: str, files: list[Path]) -> bool:
    """Return whether files have changed since their module was loaded: its results must then not be reused."""
    pieces = {file: _compute_file_hash(file) for file in files}
    spec = getattr(sys.modules.get(module), "__spec__", None)
    seen, before = _LOADED.get(module, (None, {}))
    if spec is None or spec is not seen:
        _LOADED[module] = spec, pieces
        return False
    # Files that are imported later are new, not changed.
    _LOADED[module] = spec, pieces | before
    return any(before.get(file, piece) != piece for file, piece in pieces.items())


def _find_defining_code(found: Any) -> Any:
    """Return the function or class that defines a method."""
    code = found.function if isinstance(found, FunctionMethod) else found
    while isinstance(code, functools.partial):
        code = code.func
    if callable(code):
        code = inspect.unwrap(code)
    return code if hasattr(code, "__qualname__") else type(code)


def _read_source_text(code: Any) -> str:
    try:
        return inspect.getsource(code)
    except (OSError, TypeError):
        return "\n".join(_pieces(getattr(code, "__code__", None)))


def _pieces(code: Any) -> Iterator[str]:
    """Yield the components of compiled code, without its file location."""
    if code is None:
        return
    yield code.co_code.hex()
    yield repr(code.co_names)
    for one in code.co_consts:
        # The order of a set differs between processes.
        plain = (repr(sorted(map(repr, one)) if isinstance(one, frozenset) else one),)
        yield from _pieces(one) if inspect.iscode(one) else plain


def _compute_file_hash(file: Path) -> bytes:
    # File names are excluded: a folder may be moved.
    try:
        with file.open("rb") as opened:
            return hashlib.file_digest(opened, "sha256").digest()
    except OSError:  # reported when the file is run
        return b"unread"
