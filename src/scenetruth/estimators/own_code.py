"""Code of one's own: which files are, which of them a file imports, and where in them an exception came from."""

from __future__ import annotations

import ast
import sysconfig
from collections.abc import Iterator
from functools import cache
from pathlib import Path

__all__ = ["is_own_file", "place_of", "with_imported"]

_OURS = Path(__file__).resolve().parents[1]
_INSTALLED = {"site-packages", "dist-packages"}
_TYPED_IN = ("<stdin>", "<python-input", "<ipython")


def is_own_file(file: str | Path) -> bool:
    """Tell whether a file belongs neither to scenetruth, nor to Python, nor to a package that is installed."""
    try:
        path = Path(file).resolve()
        if not path.is_file() or _INSTALLED.intersection(path.parts):
            return False
    except (OSError, ValueError):  # a name that no file can have
        return False
    return not any(path.is_relative_to(folder) for folder in (_OURS, *_python()))


def place_of(error: BaseException) -> str:
    """Return where the last line of one's own code stands that an exception came through: ``mine.py:12 in helper``.

    Empty if it came through none.
    """
    told, step = "", error.__traceback__
    while step is not None:
        code = step.tb_frame.f_code
        if code.co_filename.startswith(_TYPED_IN) or is_own_file(code.co_filename):
            told = f"{_shown(code.co_filename)}:{step.tb_lineno} in {code.co_name}"
        step = step.tb_next
    return told


def with_imported(file: Path) -> list[Path]:
    """Return a file, and those of the modules beside it that it imports, they in turn, and so on, in order."""
    first = file.resolve()
    found, left = {first}, [first]
    # Modules of a package are named from where its outermost folder lies.
    root = next(folder for folder in first.parents if not (folder / "__init__.py").is_file())
    while left:
        here = left.pop()
        for one in _imported(here, root):
            if one not in found and is_own_file(one):
                found.add(one)
                left.append(one)
    return sorted(found)


def _imported(file: Path, root: Path) -> Iterator[Path]:
    if file.suffix != ".py":
        return
    try:
        tree = ast.parse(file.read_bytes())
    except (OSError, ValueError, SyntaxError):  # whoever runs it says what is wrong with it
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from _files_of(alias.name.split("."), {file.parent, root})
        elif isinstance(node, ast.ImportFrom):
            folders = {file.parents[node.level - 1]} if 0 < node.level <= len(file.parents) else {file.parent, root}
            parts = node.module.split(".") if node.module else []
            for alias in node.names:
                yield from _files_of([*parts, alias.name], folders)


def _files_of(parts: list[str], folders: set[Path]) -> Iterator[Path]:
    """Yield the files that make a dotted name, as far as they are there: of its packages, and of itself."""
    for folder in folders:
        for count in range(len(parts) + 1):
            base = folder.joinpath(*parts[:count])
            names = [base / "__init__.py", *([base.with_name(f"{base.name}.py")] if count else [])]
            yield from (one.resolve() for one in names if one.is_file())


def _shown(name: str) -> str:
    path = Path(name)
    if path.is_absolute() and path.is_relative_to(Path.cwd()):
        return str(path.relative_to(Path.cwd()))
    return path.name


@cache
def _python() -> tuple[Path, ...]:
    paths = sysconfig.get_paths()
    names = ("stdlib", "platstdlib", "purelib", "platlib")
    return tuple(dict.fromkeys(Path(paths[name]).resolve() for name in names if name in paths))
