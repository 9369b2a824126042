"""Files that the code of a user-defined method calls: compiled modules, libraries, programs and files that it names.

Followed are imports, also of compiled modules and from other folders; libraries that ctypes has loaded into a global
variable; and existing files that Python code or a script names in a text. Not followed are names that are composed at
run time, libraries that a compiled file loads by itself (see `process_files`), installed packages, and services.
"""

from __future__ import annotations

import ast
import ctypes
import functools
import os
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

from scenetruth.estimators.user_code import is_user_file, with_imported

__all__ = ["with_called_files"]

_LARGEST_SOURCE = 2_000_000
_MOST_FILES = 2_000
_LONGEST_NAME = 255
_WORD = re.compile(r"[^\s`;|&<>()=]+")
_QUOTED = re.compile(r"\"([^\"\n]*)\"|'([^'\n]*)'")
# The folder in front of a name, as in $HERE/program and $(dirname $0)/program, is often that of the script.
_FOLDER = re.compile(r"^(?:\$(?:\{[^}]*\}|\w+))?/+")


def with_called_files(files: Iterable[Path], base: Path) -> set[Path]:
    """Return files and all files that they call, directly or indirectly; ``base``: folder of relative names."""
    found = {file.resolve() for file in files}
    left = list(found)
    modules: dict[str, list[ModuleType]] = {}
    for module in list(sys.modules.values()):
        if _is_user_module(str(getattr(module, "__file__", None) or "")):
            modules.setdefault(_file_of(module), []).append(module)
    while left and len(found) < _MOST_FILES:
        here = left.pop()
        for one in _called(here, base, modules.get(str(here), [])):
            if one not in found:
                found.add(one)
                left.append(one)
    return found


def _called(file: Path, base: Path, modules: list[ModuleType]) -> Iterator[Path]:
    texts: Iterable[str]
    if file.suffix == ".py":
        yield from with_imported(file)
        for module in modules:
            yield from _reached(module, base)
        texts = _texts_of_python(file)
    else:
        texts = _words_of_script(file)
    for text in set(texts):
        yield from _existing(text, (file.parent, base))


@functools.cache
def _is_user_module(name: str) -> bool:
    return is_user_file(name)


@functools.cache
def _resolved(name: str) -> str:
    return str(Path(name).resolve())


def _file_of(module: Any) -> str:
    name = getattr(module, "__file__", None)
    return _resolved(name) if isinstance(name, str) else ""


def _reached(module: ModuleType, base: Path) -> Iterator[Path]:
    """Yield the files of the modules and libraries that the global names of a module refer to."""
    for value in list(vars(module).values()):
        if isinstance(value, ctypes.CDLL):
            yield from _existing(str(getattr(value, "_name", "") or ""), (base,))
            continue
        home = value if isinstance(value, ModuleType) else sys.modules.get(str(getattr(value, "__module__", "") or ""))
        if name := _file_of(home):
            yield from _existing(name, (base,))


def _texts_of_python(file: Path) -> Iterator[str]:
    try:
        tree = ast.parse(file.read_bytes())
    except (OSError, ValueError, SyntaxError):  # reported when the file is run
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            # A command line in one text names its program and its files by words.
            yield from (node.value, *node.value.split())


def _words_of_script(file: Path) -> list[str]:
    """Return the words of a text file that starts with ``#!`` or is named as a shell script; none of other files."""
    try:
        if file.stat().st_size > _LARGEST_SOURCE:
            return []
        content = file.read_bytes()
    except OSError:  # reported when the file is run
        return []
    if b"\0" in content or not (content.startswith(b"#!") or file.suffix in (".sh", ".bash", ".zsh", ".bat", ".cmd")):
        return []
    text = content.decode("utf-8", errors="replace")
    words = [*_WORD.findall(_QUOTED.sub(r"\1\2", text)), *(match[1] or match[2] for match in _QUOTED.finditer(text))]
    return [part for word in words if word for part in (word, _FOLDER.sub("", word))]


def _existing(text: str, folders: Iterable[Path]) -> Iterator[Path]:
    if not text or len(text) > _LONGEST_NAME or "\n" in text or "\0" in text:
        return
    for folder in folders:
        # Nearly all words name no file.
        if os.path.isfile(name := os.path.join(folder, text)) and is_user_file(name):
            yield Path(name).resolve()
