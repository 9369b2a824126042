"""The scenes, recipes and goals that are shipped with the package, by their names."""

from __future__ import annotations

from pathlib import Path

__all__ = ["shipped_files", "shipped_folder"]


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
