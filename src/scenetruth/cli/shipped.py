"""The files that are shipped, scenes, recipes of data sets and goals, each found by its name."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

__all__ = ["GOALS", "RECIPES", "SCENES", "Shelf", "find"]

_SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True)
class Shelf:
    """One sort of files that are shipped.

    Parameters
    ----------
    noun
        What each of them is.
    metavar
        What the command line calls one.
    command
        What is done with one most often.
    folder
        Where they are, inside the folder of all.
    takes_folders
        Whether a folder is a path of its own, and not merely the results of an earlier run that has a file's name.
    """

    noun: str
    metavar: str
    command: str
    folder: str = "."
    takes_folders: bool = False

    def files(self) -> dict[str, Path]:
        """Return the files by their names, in order; none where nothing is shipped."""
        from scenetruth.files.shipped import shipped_files

        return shipped_files(self.folder)

    def call(self, name: str) -> str:
        """Return the command for one of them."""
        return f"scenetruth {self.command} {name} -o FOLDER"


SCENES = Shelf("scene", "SCENE", "run")
"""Scenes."""
RECIPES = Shelf("recipe", "RECIPE", "dataset run", "datasets", takes_folders=True)
"""Recipes of data sets; a command that takes one takes the folder of a data set too."""
GOALS = Shelf("goal", "GOAL", "design optimise", "goals")
"""Goals of a search for a rig."""


def find(shelf: Shelf, given: Path) -> Path:
    """Return the file that is meant on the command line: a path if there is such a file, else what is shipped.

    Parameters
    ----------
    shelf
        What is looked for.
    given
        A path, or the name of a file that is shipped.

    Returns
    -------
    pathlib.Path
        The file. A path to nothing is returned as it is: whoever reads it says so.

    Raises
    ------
    SceneError, RecipeError, GoalError
        If a plain name is neither a file nor shipped; with the names that are near it.
    """
    there = os.path.exists(given) if shelf.takes_folders else os.path.exists(given) and not os.path.isdir(given)
    if there or not given.name:
        return given
    shipped = shelf.files()
    if given.suffix not in _SUFFIXES and str(given) == given.name:
        if given.name in shipped:
            return shipped[given.name]
        if not os.path.isdir(given):
            raise _refused(shelf, _unknown(shelf, given.name, list(shipped)), given)
    elif given.suffix in _SUFFIXES and given.stem in shipped:
        message = f"no such file; a {shelf.noun} of this name is shipped, and called without folder and suffix: "
        message += given.stem
        raise _refused(shelf, message, given)
    elif given.suffix in _SUFFIXES and (other := _other_shelf(shelf, given.stem)) is not None:
        message = f"no such file; a {other.noun} of this name is shipped: {other.call(given.stem)}"
        raise _refused(shelf, message, given)
    return given


def _unknown(shelf: Shelf, name: str, shipped: list[str]) -> str:
    from difflib import get_close_matches

    near = [f"'{one}'" for one in get_close_matches(name.lower(), shipped, n=3)]
    if (other := _other_shelf(shelf, name)) is not None:
        question = f"; or did you mean the {shelf.noun} {' or '.join(near)}?" if near else ";"
        told = f"'{name}' is a {other.noun}, called by `{other.call(name)}`"
        return f"no such file, and no {shelf.noun} of this name: {told}{question} `scenetruth scenes` lists all"
    question = f"; did you mean {' or '.join(near)}?" if near else ";"
    return f"no such file, and no {shelf.noun} of this name is shipped{question} `scenetruth scenes` lists all"


def _other_shelf(shelf: Shelf, name: str) -> Shelf | None:
    """Return where else a name is shipped, if not on a shelf itself."""
    return next((other for other in (SCENES, RECIPES, GOALS) if other is not shelf and name in other.files()), None)


def _refused(shelf: Shelf, message: str, given: Path) -> Exception:
    from scenetruth.errors import Problem, RecipeError, SceneError

    kind: type[SceneError | RecipeError] = SceneError if shelf is SCENES else RecipeError
    if shelf is GOALS:
        from scenetruth.design.optimise.problems import GoalError

        kind = GoalError
    return kind([Problem(shelf.metavar, message, str(given))])
