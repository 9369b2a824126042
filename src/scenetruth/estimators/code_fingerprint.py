"""A fingerprint of the code of user methods, so that results computed by an earlier version are recognised."""

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

__all__ = ["compute_code_fingerprint"]


def compute_code_fingerprint(method: Any) -> str:
    """Return a hash of the code that a method of one's own is made of; empty for those that are installed.

    Of a function or class, the file of its module counts, and those of the modules beside it that it imports; of a
    command, the files that it names; of a folder of results, what lies in it. What is typed into a session has no file:
    there the text of the function itself counts.

    >>> compute_code_fingerprint("structure_tensor")
    ''
    """
    found = find_method(method)
    named = method.partition(":")[0] if isinstance(method, str) and ":" in method else ""
    files, texts = set[Path](), list[str]()
    code = _code_of(found)
    for module in dict.fromkeys([named, getattr(code, "__module__", "")]):
        file = getattr(sys.modules.get(module), "__file__", None)
        if file and is_user_file(file):
            mine = with_imported(Path(file))
            files.update(mine)
            texts += [secrets.token_hex()] if _is_outdated(module, mine) else []
        elif module and not file and module not in sys.builtin_module_names:
            texts.append(_text_of(code))
    if isinstance(found, CommandMethod):
        for file in found.named_files():
            files.update(with_imported(file))
    if isinstance(found, ResultsFolder):
        texts.append(found.listing())
    if not files and not texts:
        return ""
    told = hashlib.sha256()
    for piece in sorted(_hash_of(file) for file in files):
        told.update(piece)
    for text in texts:
        told.update(hashlib.sha256(text.encode("utf-8", "backslashreplace")).digest())
    return told.hexdigest()[:16]


_LOADED: dict[str, tuple[Any, list[bytes]]] = {}


def _is_outdated(module: str, files: list[Path]) -> bool:
    """Tell whether files have changed since their module was first seen here, and it was not loaded again.

    What such code gives is of neither the old files nor the new ones for sure: nobody may take it for theirs.
    """
    pieces = [_hash_of(file) for file in files]
    spec = getattr(sys.modules.get(module), "__spec__", None)
    seen, before = _LOADED.get(module, (None, []))
    if spec is None or spec is not seen:
        _LOADED[module] = spec, pieces
        return False
    return pieces != before


def _code_of(found: Any) -> Any:
    """Return the function or class whose code a method is."""
    code = found.function if isinstance(found, FunctionMethod) else found
    while isinstance(code, functools.partial):
        code = code.func
    if callable(code):
        code = inspect.unwrap(code)
    return code if hasattr(code, "__qualname__") else type(code)


def _text_of(code: Any) -> str:
    try:
        return inspect.getsource(code)
    except (OSError, TypeError):
        return "\n".join(_pieces(getattr(code, "__code__", None)))


def _pieces(code: Any) -> Iterator[str]:
    """Yield what compiled code consists of, without where it lies."""
    if code is None:
        return
    yield code.co_code.hex()
    yield repr(code.co_names)
    for one in code.co_consts:
        # Sets are in another order in every process.
        plain = (repr(sorted(map(repr, one)) if isinstance(one, frozenset) else one),)
        yield from _pieces(one) if inspect.iscode(one) else plain


def _hash_of(file: Path) -> bytes:
    # Names do not count: a folder may be moved.
    try:
        with file.open("rb") as opened:
            return hashlib.file_digest(opened, "sha256").digest()
    except OSError:  # whoever runs it says what is wrong with it
        return b"unread"
