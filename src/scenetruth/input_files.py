"""Model fields that name input files, and the files bundled with the package."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, get_args

from pydantic import AfterValidator, BaseModel, ValidationInfo

__all__ = [
    "InputFile",
    "SceneFile",
    "bundled_file",
    "bundled_files",
    "bundled_folder",
    "collect_input_files",
    "describe_missing",
    "regular_file_size",
    "validation_context",
]


def bundled_folder() -> Path | None:
    """Return the directory of the bundled files: inside an installed package, or ``scenes/`` of a checkout."""
    from importlib.resources import files

    package = Path(str(files("scenetruth")))
    checkout = package.parents[1]
    if (package / "shipped").is_dir():
        return package / "shipped"
    return checkout / "scenes" if (checkout / "pyproject.toml").is_file() and (checkout / "scenes").is_dir() else None


def bundled_files(folder: str = ".") -> dict[str, Path]:
    """Return the bundled files by name, in order; empty if there are none.

    >>> bundled_files()["cube"].name
    'cube.yaml'
    """
    base = bundled_folder()
    return {} if base is None else {file.stem: file for file in sorted((base / folder).glob("*.yaml"))}


def bundled_file(given: object, folder: Path | None = None, *, within: str = ".") -> Path | None:
    """Return the bundled file of a plain name; None if there is none, or a file of that name exists.

    >>> bundled_file("cube").name, bundled_file("cube.yaml"), bundled_file("mine")
    ('cube.yaml', None, None)
    """
    name = str(given)
    # os.path returns False for invalid file names.
    if Path(name).name != name or Path(name).suffix or os.path.isfile((folder or Path()) / name):
        return None
    return bundled_files(within).get(name)


_FOLDER = "folder"


class _NamesAFile:
    """Marker of the type of a path."""


_MARK = _NamesAFile()


def _absolute(value: str, info: ValidationInfo) -> str:
    # Names may contain other separators, such as a no-break space.
    if any(ord(letter) < ord(" ") for letter in value):
        msg = r"contains a tab, a line break or another control character; use / in paths, because \ begins a special "
        msg += "character in double quotes"
        raise ValueError(msg)
    folder = (info.context or {}).get(_FOLDER)
    return value if folder is None else str(folder / value)


def _of_scene(value: str, info: ValidationInfo) -> str:
    folder = (info.context or {}).get(_FOLDER)
    return value if folder is None else str(bundled_file(value, folder) or folder / value)


InputFile = Annotated[str, _MARK, AfterValidator(_absolute)]
"""Path of an input file; relative paths are resolved against the directory in the validation context."""
SceneFile = Annotated[str, _MARK, AfterValidator(_of_scene)]
"""Path of a scene file; a bundled scene is also accepted by name if no such file exists."""


def describe_missing(path: str | Path, message: str) -> str:
    """Return the message for a missing file, with a remedy for paths of another system."""
    if os.name != "nt" and re.search(r"(^|/)[A-Za-z]:[\\/]|\\", str(path)):
        return f"{message}; it is a path of Windows: use / and a path relative to the directory of the file"
    return message


def regular_file_size(path: Path) -> int:
    """Return the size of a regular file in bytes without opening it, because opening a pipe may block."""
    found = os.stat(path)
    if not stat.S_ISREG(found.st_mode):
        what = "a directory" if stat.S_ISDIR(found.st_mode) else "not a regular file (a pipe, a socket or a device)"
        msg = f"is {what}"
        raise ValueError(msg)
    return found.st_size


def validation_context(folder: Path | None) -> dict[str, Any]:
    """Return the validation context that resolves relative paths."""
    return {_FOLDER: folder}


def collect_input_files(model: BaseModel) -> list[tuple[str, Path]]:
    """Return every file named by a validated model."""
    return list(_files_of_model(model, ""))


def _files_of_model(model: BaseModel, where: str) -> Iterator[tuple[str, Path]]:
    for name, marked in _marked_fields(type(model)).items():
        yield from _files_in(getattr(model, name), f"{where}{name}", marked)


@cache
def _marked_fields(model: type[BaseModel]) -> dict[str, bool]:
    """Return the fields of a model, and whether the type of each is, or contains, that of a path."""
    fields = model.model_fields.items()
    return {name: _MARK in field.metadata or _is_marked(field.annotation) for name, field in fields}


def _files_in(value: Any, where: str, marked: bool) -> Iterator[tuple[str, Path]]:
    if isinstance(value, BaseModel):
        yield from _files_of_model(value, f"{where}.")
    elif isinstance(value, tuple | list):
        for index, item in enumerate(value):
            yield from _files_in(item, f"{where}.{index}", marked)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _files_in(item, f"{where}.{key}", marked)
    elif marked and isinstance(value, str):
        yield where, Path(value)


def _is_marked(annotation: Any) -> bool:
    """Return whether a type is, or contains, that of a path."""
    return annotation is _MARK or any(_is_marked(part) for part in get_args(annotation))
