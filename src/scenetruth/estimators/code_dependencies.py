"""Code that a user-defined method calls: modules of other folders, and scripts and programs that it names.

Only code is followed: sources, scripts, libraries and programs. Data files, and files of caches and of the operating
system, are not: they appear and change as by-products of a run. The result depends on the contents of files alone, not
on what this process has loaded.
"""

from __future__ import annotations

import ast
import functools
import os
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from scenetruth.estimators.user_code import is_user_file, list_imported

__all__ = ["is_binary", "is_cached", "is_code", "is_system", "with_called_code"]

_LARGEST_SOURCE = 2_000_000
_MOST_FILES = 2_000
_LONGEST_NAME = 255
_WORD = re.compile(r"[^\s`;|&<>()=]+")
_QUOTED = re.compile(r"\"([^\"\n]*)\"|'([^'\n]*)'")
# The folder in front of a name, as in $HERE/program and $(dirname $0)/program, is often that of the script.
_FOLDER = re.compile(r"^(?:\$(?:\{[^}]*\}|\w+))?/+")
# Interpreters are installed with their packages, by links and scripts that lead to all versions.
_INTERPRETER = re.compile(r"(?:python|pypy|perl|ruby|node|java|Rscript|R|julia|octave|matlab|lua|sh|bash|zsh)[\d.]*")
_SHELL = (".sh", ".bash", ".zsh", ".bat", ".cmd", ".ps1")
_SOURCES = {*_SHELL, ".py", ".pl", ".rb", ".r", ".jl", ".m", ".lua", ".js", ".c", ".cc", ".cpp", ".cu", ".h", ".pyx"}
_LIBRARIES = {".so", ".pyd", ".dll", ".dylib", ".exe", ".jar"}
# ELF, Windows, and Mach-O in its byte orders.
_MAGIC = (b"\x7fELF", b"MZ", b"\xfe\xed\xfa", b"\xce\xfa\xed\xfe", b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe")
_BY_PRODUCTS = (".pyc", ".nbi", ".nbc")
_INSTALLED = ("/usr/lib", "/usr/bin", "/usr/sbin", "/usr/share", "/usr/libexec", "/lib", "/bin", "/sbin")
_SYSTEM = (*_INSTALLED, "/proc", "/sys", "/dev", "/etc", "/run", "/var")


def with_called_code(files: Iterable[Path], base: Path) -> set[Path]:
    """Return files and all code that they call, directly or indirectly; ``base``: folder of relative names."""
    found = {file.resolve() for file in files}
    left = list(found)
    while left and len(found) < _MOST_FILES:
        for one in _called(left.pop(), base):
            if one not in found:
                found.add(one)
                left.append(one)
    return found


def is_code(file: Path) -> bool:
    """Return whether a file is a source, a script, a library or a program, by its suffix or its first bytes."""
    return file.suffix.lower() in _SOURCES or is_binary(file) or _first_bytes(file).startswith(b"#!")


def is_binary(file: Path) -> bool:
    """Return whether a file is a library or a program in machine code or byte code."""
    suffixes = {suffix.lower() for suffix in file.suffixes}
    named = file.suffix.lower() in _LIBRARIES or ".so" in suffixes
    return named or _first_bytes(file).startswith(_MAGIC)


def is_cached(name: str) -> bool:
    """Return whether a file is one of a cache, which programs write and remove at any time."""
    return name.endswith(_BY_PRODUCTS) or any("cache" in part.lower() for part in name.split(os.sep)[:-1])


@functools.cache
def is_system(name: str) -> bool:
    """Return whether a file belongs to the operating system or to the installation of Python."""
    folders = [f"{folder}{end}/" for folder in _SYSTEM for end in ("", "64")]
    # The libraries of an environment, such as those of conda, are installed with it.
    prefixes = {os.path.realpath(prefix) for prefix in (sys.prefix, sys.base_prefix)} - {"/", "/usr", "/usr/local"}
    return name.startswith((*folders, *(f"{prefix}{os.sep}" for prefix in prefixes)))


def _first_bytes(file: Path) -> bytes:
    try:
        with file.open("rb") as opened:
            return opened.read(4)
    except OSError:  # reported when the file is run
        return b""


def _called(file: Path, base: Path) -> Iterator[Path]:
    yield from list_imported(file)
    try:
        state = file.stat()
    except OSError:  # reported when the file is run
        return
    if state.st_size <= _LARGEST_SOURCE:
        for text in _read_texts(file, state.st_mtime_ns, state.st_size, state.st_ino):
            # The existence of files is looked up every time.
            yield from _named(text, (file.parent, base))


@functools.lru_cache(maxsize=1024)
def _read_texts(file: Path, *state: int) -> frozenset[str]:
    """Return the words of a Python file or a script that may name other files."""
    try:
        content = file.read_bytes()
        return frozenset(
            _texts_of_python(ast.parse(content)) if file.suffix == ".py" else _words_of_script(file, content)
        )
    except (OSError, ValueError, SyntaxError):  # reported when the file is run
        return frozenset()


def _texts_of_python(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            # A command line in one text names its program and its files by words.
            yield from (node.value, *node.value.split())


def _words_of_script(file: Path, content: bytes) -> Iterator[str]:
    """Yield the words of a text file that starts with ``#!`` or is named as a shell script; none of other files."""
    if b"\0" in content or not (content.startswith(b"#!") or file.suffix.lower() in _SHELL):
        return
    text = content.decode("utf-8", errors="replace")
    words = [*_WORD.findall(_QUOTED.sub(r"\1\2", text)), *(match[1] or match[2] for match in _QUOTED.finditer(text))]
    yield from (part for word in words if word for part in (word, _FOLDER.sub("", word)))


def _named(text: str, folders: Iterable[Path]) -> Iterator[Path]:
    """Yield the code that a word names, relative to folders or among the programs of the user."""
    if not text or len(text) > _LONGEST_NAME or "\n" in text or "\0" in text:
        return
    for folder in folders:
        # Nearly all words name no file.
        if os.path.isfile(name := os.path.join(folder, text)):
            yield from _followed(name)
    if os.sep in text or _INTERPRETER.fullmatch(text):
        return
    if place := _programs(os.environ.get("PATH", "")).get(text):
        yield from _followed(place)


def _followed(name: str) -> Iterator[Path]:
    path = Path(os.path.realpath(name))
    if not is_system(str(path)) and not is_cached(str(path)) and is_user_file(path) and is_code(path):
        yield path


@functools.lru_cache(maxsize=8)
def _programs(folders: str) -> dict[str, str]:
    """Return the programs on the search path by name, except those of the operating system."""
    found: dict[str, str] = {}
    for folder in folders.split(os.pathsep):
        if folder and not is_system(f"{os.path.realpath(folder)}{os.sep}"):
            try:
                names = os.listdir(folder)
            except OSError:  # folders on the search path may be missing
                continue
            for name in names:
                if os.access(place := os.path.join(folder, name), os.X_OK):
                    found.setdefault(name, place)
    return found
