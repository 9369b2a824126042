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

    ``takes_folders``: Whether an existing directory is a valid path, and not merely the results of an earlier run with
    the name of a file.
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
RECIPES = BundledFiles("recipe", "RECIPE", "dataset run", "datasets", takes_folders=True)
"""Recipes of data sets; commands for recipes also accept the directory of a data set."""
DESIGNS = BundledFiles("design", "SPEC", "design optimise", "designs")


def resolve_file(category: BundledFiles, given: Path) -> Path:
    """Return the file of a command-line argument: an existing path, otherwise a bundled file."""
    exists = os.path.exists(given) if category.takes_folders else os.path.exists(given) and not os.path.isdir(given)
    if exists or not given.name:
        return given
    bundled = category.files()
    if given.suffix not in _SUFFIXES and str(given) == given.name:
        if given.name in bundled:
            return bundled[given.name]
        if not os.path.isdir(given):
            raise _refused(category, _unknown(category, given.name, list(bundled)), given)
    elif given.suffix in _SUFFIXES and given.stem in bundled:
        raise _refused(category, f"no such file; use the bundled {category.noun} by name: {given.stem}", given)
    elif given.suffix in _SUFFIXES and (other := _other_category(category, given.stem)) is not None:
        message = f"no such file; '{given.stem}' is a bundled {other.noun}: {other.call(given.stem)}"
        raise _refused(category, message, given)
    return given


def _unknown(category: BundledFiles, name: str, bundled: list[str]) -> str:
    from difflib import get_close_matches

    message = f"no such file, and no bundled {category.noun} of this name"
    if (other := _other_category(category, name)) is not None:
        message += f"; '{name}' is a bundled {other.noun}: `{other.call(name)}`"
    near = [f"'{match}'" for match in get_close_matches(name.lower(), bundled, n=3)]
    question = f"; did you mean the {category.noun} {' or '.join(near)}?" if near else ";"
    return f"{message}{question} `scenetruth list {category.noun}s` lists all"


def _other_category(category: BundledFiles, name: str) -> BundledFiles | None:
    return next(
        (other for other in (SCENES, RECIPES, DESIGNS) if other is not category and name in other.files()), None
    )


def _refused(category: BundledFiles, message: str, given: Path) -> Exception:
    from scenetruth.errors import Problem, RecipeError, SceneError

    kind: type[SceneError | RecipeError] = SceneError if category is SCENES else RecipeError
    if category is DESIGNS:
        from scenetruth.design.optimisation.design_records import DesignSpecError

        kind = DesignSpecError
    return kind([Problem(category.metavar, message, str(given))])


_METHODS = Path(__file__).resolve().parents[1] / "estimators" / "methods"

_ENTRY_POINTS = "scenetruth.estimators"


def method_names(incomplete: str) -> list[str]:
    """Return the installed methods that begin with a text, without loading them."""
    import pkgutil
    from importlib import metadata

    own = [module.name for module in pkgutil.iter_modules([str(_METHODS)])]
    offered = [point.name for point in metadata.entry_points(group=_ENTRY_POINTS)]
    return _beginning(incomplete, [*own, *offered])


def file_completer(category: BundledFiles) -> Callable[[str], list[str]]:
    """Return the completion of file arguments with names of bundled files; without a result, shells complete paths."""

    def complete(incomplete: str) -> list[str]:
        folder = Path(incomplete).parent if "/" in incomplete else Path()
        start = incomplete.rpartition("/")[0] + "/" if "/" in incomplete else ""
        try:
            here = [start + file.name for file in folder.iterdir() if file.suffix in (".yaml", ".yml")]
        except OSError:
            here = []
        return _beginning(incomplete, [*category.files(), *here])

    return complete


def _beginning(incomplete: str, names: Iterable[str]) -> list[str]:
    return sorted({name for name in names if name.startswith(incomplete)})
