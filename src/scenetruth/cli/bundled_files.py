"""Bundled files by name, and shell completion of names."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

__all__ = [
    "DESIGNS",
    "RECIPES",
    "SCENES",
    "BundledFiles",
    "file_completer",
    "method_names",
    "resolve_file",
]


_SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True)
class BundledFiles:
    """One category of bundled files.

    ``noun``: Name of a file of the category. ``metavar``: Its name on the command line. ``command``: Its main command.
    ``folder``: Its directory within that of all bundled files. ``takes_folders``: Whether an existing directory is a
    valid path, and not merely the results of an earlier run with the name of a file.
    """

    noun: str
    metavar: str
    command: str
    folder: str = "."
    takes_folders: bool = False

    def files(self) -> dict[str, Path]:
        """Return the files by name, in order; empty if none are bundled."""
        from scenetruth.input_files import bundled_files

        return bundled_files(self.folder)

    def call(self, name: str) -> str:
        """Return the command for a file."""
        return f"scenetruth {self.command} {name} -o DIR"


SCENES = BundledFiles("scene", "SCENE", "run")
"""Scenes."""

RECIPES = BundledFiles("recipe", "RECIPE", "dataset run", "datasets", takes_folders=True)
"""Recipes of data sets; commands for recipes also accept the directory of a data set."""

DESIGNS = BundledFiles("design", "SPEC", "design optimise", "designs")
"""Design specifications."""


def resolve_file(shelf: BundledFiles, given: Path) -> Path:
    """Return the file of a command-line argument: an existing path, otherwise a bundled file."""
    exists = os.path.exists(given) if shelf.takes_folders else os.path.exists(given) and not os.path.isdir(given)
    if exists or not given.name:
        return given
    bundled = shelf.files()
    if given.suffix not in _SUFFIXES and str(given) == given.name:
        if given.name in bundled:
            return bundled[given.name]
        if not os.path.isdir(given):
            raise _refused(shelf, _unknown(shelf, given.name, list(bundled)), given)
    elif given.suffix in _SUFFIXES and given.stem in bundled:
        raise _refused(shelf, f"no such file; use the bundled {shelf.noun} by name: {given.stem}", given)
    elif given.suffix in _SUFFIXES and (other := _other_category(shelf, given.stem)) is not None:
        message = f"no such file; '{given.stem}' is a bundled {other.noun}: {other.call(given.stem)}"
        raise _refused(shelf, message, given)
    return given


def _unknown(shelf: BundledFiles, name: str, bundled: list[str]) -> str:
    from difflib import get_close_matches

    message = f"no such file, and no bundled {shelf.noun} of this name"
    if (other := _other_category(shelf, name)) is not None:
        message += f"; '{name}' is a bundled {other.noun}: `{other.call(name)}`"
    near = [f"'{match}'" for match in get_close_matches(name.lower(), bundled, n=3)]
    question = f"; did you mean the {shelf.noun} {' or '.join(near)}?" if near else ";"
    return f"{message}{question} `scenetruth list {shelf.noun}s` lists all"


def _other_category(shelf: BundledFiles, name: str) -> BundledFiles | None:
    return next((other for other in (SCENES, RECIPES, DESIGNS) if other is not shelf and name in other.files()), None)


def _refused(shelf: BundledFiles, message: str, given: Path) -> Exception:
    from scenetruth.errors import Problem, RecipeError, SceneError

    kind: type[SceneError | RecipeError] = SceneError if shelf is SCENES else RecipeError
    if shelf is DESIGNS:
        from scenetruth.design.optimisation.design_records import DesignSpecError

        kind = DesignSpecError
    return kind([Problem(shelf.metavar, message, str(given))])


_METHODS = Path(__file__).resolve().parents[1] / "estimators" / "methods"

_ENTRY_POINTS = "scenetruth.estimators"


def method_names(incomplete: str) -> list[str]:
    """Return the installed methods that begin with a text, without loading them."""
    import pkgutil
    from importlib import metadata

    own = [module.name for module in pkgutil.iter_modules([str(_METHODS)])]
    offered = [point.name for point in metadata.entry_points(group=_ENTRY_POINTS)]
    return _beginning(incomplete, [*own, *offered])


def file_completer(shelf: BundledFiles) -> Callable[[str], list[str]]:
    """Return the completion of an argument that is a file or the name of a bundled file.

    Without a result, shells complete paths.
    """

    def complete(incomplete: str) -> list[str]:
        folder = Path(incomplete).parent if "/" in incomplete else Path()
        start = incomplete.rpartition("/")[0] + "/" if "/" in incomplete else ""
        try:
            here = [start + file.name for file in folder.iterdir() if file.suffix in (".yaml", ".yml")]
        except OSError:
            here = []
        return _beginning(incomplete, [*shelf.files(), *here])

    return complete


def _beginning(incomplete: str, names: Iterable[str]) -> list[str]:
    return sorted({name for name in names if name.startswith(incomplete)})
