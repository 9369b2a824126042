"""Loading of recipes from files and plain values, with every problem listed."""

from __future__ import annotations

import difflib
import errno
import os
import re
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, PrivateAttr, ValidationError
from pydantic_core import ErrorDetails

from scenetruth.dataset.recipe_model import PATH_PATTERN, RecipeModel
from scenetruth.dataset.sampler import Sampler
from scenetruth.errors import Problem, RecipeError, SceneError
from scenetruth.input_files import bundled_file, bundled_files, validation_context
from scenetruth.plain_data import plain_problems
from scenetruth.scene import Overrides, Scene, load_scene, read_input
from scenetruth.scene.field_paths import PathError, assign, expand, order_paths
from scenetruth.validation_problems import list_problems

__all__ = ["Recipe", "RecipeLike", "load_recipe"]

_NOT_THERE = f"cannot be read: {os.strerror(errno.ENOENT)}"
_MAPPING = "a mapping of name, base, samples, distributions, ..."


class Recipe(RecipeModel):
    """Recipe: the specification of a data set.

    See Also
    --------
    load_recipe : Load a recipe from a YAML file.
    run_dataset : Generate the data set.

    Examples
    --------
    >>> import scenetruth as st
    >>> recipe = st.load_recipe("leaves")
    >>> recipe.name, recipe.sampler().draw(0).scene().frames.count == recipe.sampler().bases[0].frames.count
    ('leaves', True)
    """

    # Replaces the docstring in the JSON schema.
    model_config = ConfigDict(json_schema_extra={"description": "Specification of a data set."})

    _bases: tuple[Scene, ...] | None = PrivateAttr(default=None)

    @classmethod
    def from_dict(
        cls, values: Mapping[str, Any], *, source: str | Path | None = None, folder: Path | None = None
    ) -> Recipe:
        """Validate a recipe given as plain values.

        Parameters
        ----------
        values
            The values, as in a file.
        source
            Origin of the values, for messages.
        folder
            Directory against which relative paths are resolved; None leaves them unchanged.

        Returns
        -------
        Recipe
            The recipe with its base scenes.

        Raises
        ------
        RecipeError
            If the recipe is invalid; lists every problem with its path.

        See Also
        --------
        load_recipe : Load a recipe from a YAML file.

        Examples
        --------
        >>> import scenetruth as st
        >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}}
        >>> wall |= {"pose": {"position_mm": [0, 0, 100]}, "texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
        >>> plain = {"camera": {"width": 30, "height": 25, "focal_length_px": 60}, "objects": [wall]}
        >>> plain |= {"stage": {"positions": 2, "baseline_mm": 5}, "frames": {"count": 1}}
        >>> far = {"objects.0.pose.position_mm.2": {"kind": "integers", "low": 90, "high": 110}}
        >>> recipe = st.Recipe.from_dict({"name": "walls", "base": plain, "samples": 100, "distributions": far})
        >>> sampler = recipe.sampler()
        >>> len(sampler), sampler.draw(41).values == sampler.draw(41).values, sampler.draw(41).scene()
        (100, True, Scene(30 x 25 px; 2 positions x 1 frames; objects: wall))
        """
        if not isinstance(values, Mapping):
            raise RecipeError([Problem("", f"must be {_MAPPING}", values)], source=source)
        problems = plain_problems(values)
        if problems:
            raise RecipeError(problems, source=source)
        named = values.get("folder")
        if folder is not None and (named is None or isinstance(named, str)):
            # Absolute, because the recipe of a data set is read elsewhere.
            values = {**values, "folder": str((folder / (named or "")).resolve())}
        try:
            recipe = cls.model_validate(dict(values), context=validation_context(folder))
        except ValidationError as error:
            found = list_problems(error, values, model=cls, words=_words)
            problems = [*found, *_missing_bases(values, folder)]
            raise RecipeError(problems, source=source) from error
        for where, entry in [(f"parameters.{key}", item) for key, item in recipe.parameters.items()] + [
            (f"distributions.{key}", item) for key, item in recipe.distributions.items()
        ]:
            problems += [Problem(f"{where}.{one.path}", one.message, one.value) for one in entry.problems()]
        bases = [_base(recipe, number, folder, problems) for number in range(len(recipe.base))]
        if problems:
            raise RecipeError(problems, source=source)
        recipe._bases = tuple(base for base in bases if base is not None)
        try:
            # Problems that depend on the base scenes are reported too.
            recipe.sampler()
        except RecipeError as error:
            raise RecipeError(error.problems, source=source) from error
        return recipe

    def sampler(self) -> Sampler:
        """Return the sampler of the recipe."""
        if self._bases is None:
            return Recipe.from_dict(self.to_dict()).sampler()
        return Sampler(self, self._bases)


RecipeLike = RecipeModel | Mapping[str, Any] | str | PathLike[str]
"""A recipe, its values, the path of its file, or the name of a bundled recipe."""


def load_recipe(recipe: RecipeLike, *, overrides: Overrides = ()) -> Recipe:
    """Load the recipe of a data set.

    Parameters
    ----------
    recipe
        The YAML file, or the name of a bundled recipe, such as ``"leaves"``, if no such file exists. Relative
        paths are resolved against its directory. Also a mapping of values, or a recipe.
    overrides
        Changed fields, as for `load_scene`.

    Returns
    -------
    Recipe
        The recipe with its base scenes; its `Recipe.sampler` draws samples.

    Raises
    ------
    RecipeError
        If the file cannot be read, or the recipe or a base scene is invalid; lists every problem.

    See Also
    --------
    Recipe.from_dict : Validate a recipe given as plain values.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> text = '''
    ... name: walls
    ... base:
    ...   camera: {width: 40, height: 30, focal_length_px: 60}
    ...   stage: {positions: 3, baseline_mm: 5}
    ...   frames: {count: 2}
    ...   objects: [{name: wall, mesh: {kind: plane, size_mm: [90, 90]}, texture: {kind: uniform},
    ...              pose: {position_mm: [0, 0, 100]}}]
    ... samples: 10
    ... distributions:
    ...   objects.0.pose.position_mm.2: {kind: uniform, low: 90, high: 110}
    ... '''
    >>> with TemporaryDirectory() as folder:
    ...     _ = Path(folder, "walls.yaml").write_text(text)
    ...     load_recipe(f"{folder}/walls.yaml", overrides=["seed=4"]).samples
    10
    """
    if isinstance(recipe, Recipe) and not overrides:
        return recipe
    given = recipe.to_dict() if isinstance(recipe, RecipeModel) else recipe
    plain, source, folder = read_input(given, "a recipe", RecipeError, within="datasets", overrides=overrides)
    return Recipe.from_dict(plain, source=source, folder=folder)


def _base(recipe: RecipeModel, number: int, folder: Path | None, problems: list[Problem]) -> Scene | None:
    """Return a base scene with the shared changes applied, or add its problems."""
    given = recipe.base[number].scene
    where = f"base.{number}"
    try:
        scene = load_scene(given) if isinstance(given, str) else Scene.from_dict(given, folder=folder)
        return _changed(scene, recipe)
    except SceneError as error:
        for one in error.problems:
            path = one.path if one.path.startswith("set.") else ".".join(filter(None, (where, one.path)))
            if isinstance(given, str) and not one.path and one.message == _NOT_THERE:
                problems.append(Problem(path, _no_such_scene(given), given))
                continue
            text = f"{one.message} ({given})" if isinstance(given, str) else one.message
            problems.append(Problem(path, text, one.value))
        return None


def _missing_bases(plain: Mapping[str, Any], folder: Path | None) -> list[Problem]:
    given = plain.get("base")
    entries = given if isinstance(given, list | tuple) else [given]
    files = [entry.get("scene") if isinstance(entry, Mapping) else entry for entry in entries]
    return [
        Problem(f"base.{number}", _no_such_scene(file), file)
        for number, file in enumerate(files)
        if isinstance(file, str) and not (bundled_file(file, folder) or (folder or Path()) / file).exists()
    ]


def _no_such_scene(given: str) -> str:
    """Return the message for a missing base scene, with suggestions of bundled scenes."""
    path, shipped = Path(given), bundled_files()
    if path.suffix:
        known = path.suffix in (".yaml", ".yml") and path.stem in shipped
        remedy = f"; use the bundled scene by name: {path.stem}" if known else ""
        return f"{_NOT_THERE}{remedy}"
    near = [f"'{name}'" for name in difflib.get_close_matches(path.name.lower(), shipped, n=3)]
    question = f"; did you mean {' or '.join(near)}?" if near else ";"
    return f"no such file or bundled scene{question} `scenetruth list scenes` lists all"


def _changed(scene: Scene, recipe: RecipeModel) -> Scene:
    if not recipe.set:
        return scene
    plain = scene.to_dict()
    problems = []
    for path in order_paths(recipe.set):
        value = recipe.set[path]
        try:
            for place in expand(plain, path):
                assign(plain, place, value)
        except PathError as error:
            problems.append(Problem(f"set.{path}", str(error), value))
    if problems:
        raise SceneError(problems)
    return Scene.from_dict(plain, folder=None if recipe.folder is None else Path(recipe.folder))


def _words(entry: ErrorDetails, path: str) -> str | None:
    """Return the message of a problem that only recipes have."""
    match entry["type"]:
        case "union_tag_not_found":
            return "requires `kind`, such as {kind: uniform, low: 1, high: 2}"
        case "string_pattern_mismatch":
            return _letters_allowed(path, str(entry["input"]), is_key=entry["loc"][-1] == "[key]")
    return None


def _letters_allowed(path: str, given: str, *, is_key: bool) -> str:
    """Return a message with the permitted characters of a name or path, and a corrected spelling."""
    if path == "name":
        spelled = re.sub(r"[^A-Za-z0-9_.-]+", "-", given).strip("-._")
        allowed = "must consist of the letters A to Z and a to z, digits, points, dashes and underscores, and begin "
        return f"{allowed}with a letter or a digit" + (f", such as {spelled:.100}" if spelled else "")
    if is_key:
        spelled = re.sub(r"\[(\d+|\*)\]", r".\1", given)
        remedy = f"; write {spelled:.200}" if spelled != given and re.fullmatch(PATH_PATTERN, spelled) else ""
        return f"is not a field path: keys and indices separated by dots, such as objects.0.mesh.size_mm{remedy}"
    return "must consist of the letters A to Z and a to z, digits and underscores, and not begin with a digit"
