"""The scenes, recipes and goals that are shipped with the package, by their names."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["shipped_file", "shipped_files", "shipped_folder"]


def shipped_folder() -> Path | None:
    """Return the folder of all that is shipped: in an installed package inside it, in a checkout ``scenes/``."""
    from importlib.resources import files

    package = Path(str(files("scenetruth")))
    checkout = package.parents[1]
    if (package / "shipped").is_dir():
        return package / "shipped"
    return checkout / "scenes" if (checkout / "pyproject.toml").is_file() and (checkout / "scenes").is_dir() else None


def shipped_files(folder: str = ".") -> dict[str, Path]:
    """Return files that are shipped by their names, in order; none where nothing is shipped.

    Parameters
    ----------
    folder
        ``"."`` for scenes, ``"datasets"`` for recipes, ``"goals"`` for goals.

    Examples
    --------
    >>> shipped_files()["cube"].name
    'cube.yaml'
    """
    base = shipped_folder()
    return {} if base is None else {file.stem: file for file in sorted((base / folder).glob("*.yaml"))}


def shipped_file(given: object, folder: Path | None = None, *, within: str = ".") -> Path | None:
    """Return the file that is shipped under a plain name; None if there is none, or a file has that name.

    Parameters
    ----------
    given
        A name or a path.
    folder
        Where relative paths count from.
    within
        As of `shipped_files`; scenes if not given.

    Examples
    --------
    >>> shipped_file("cube").name, shipped_file("cube.yaml"), shipped_file("mine")
    ('cube.yaml', None, None)
    """
    name = str(given)
    # Of names that no file can have, os.path says no.
    if Path(name).name != name or Path(name).suffix or os.path.isfile((folder or Path()) / name):
        return None
    return shipped_files(within).get(name)
