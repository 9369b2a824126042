"""Loading of recipes from files and plain values, with every problem listed."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar

from pydantic import ConfigDict, PrivateAttr
from pydantic_core import ErrorDetails

from scenetruth.dataset.recipe_model import PATH_PATTERN, RecipeModel
from scenetruth.dataset.recipe_validation import range_problems
from scenetruth.dataset.sampler import Sampler, Unexamined
from scenetruth.errors import Problem, RecipeError, SceneError
from scenetruth.input_files import bundled_file, bundled_files, validation_context
from scenetruth.plain_data import plain_problems
from scenetruth.scene import Overrides, Scene, join_override_problems, override, read_input, read_scene
from scenetruth.scene.scene_loader import SceneReading, change_scene, validate_scene
from scenetruth.scene.yaml_reader import NO_FILE
from scenetruth.valid_remainder import FieldRepair, read_model

__all__ = ["Recipe", "RecipeLike", "load_recipe"]

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
        recipe, problems = cls._read(values, folder)
        if problems or recipe is None:
            raise RecipeError(problems, source=source)
        return recipe

    @classmethod
    def _read(cls, values: Any, folder: Path | None) -> tuple[Recipe | None, list[Problem]]:
        """Return a recipe with its base scenes, or its problems."""
        if not isinstance(values, Mapping):
            return None, [Problem("", f"must be {_MAPPING}", values)]
        problems = plain_problems(values)
        if problems:
            return None, problems
        named = values.get("folder")
        if folder is not None and (named is None or isinstance(named, str)):
            # Absolute, because the recipe of a data set is read elsewhere.
            values = {**values, "folder": str((folder / (named or "")).resolve())}
        if "base" in values and not isinstance(values["base"], list | tuple):
            values = {**values, "base": [values["base"]]}
        repair = _RecipeRepair(values)
        recipe, problems = read_model(cls, values, repair, context=validation_context(folder), words=_words)
        if recipe is None:
            return None, [*problems, *_missing_bases(values, folder)]
        hidden = repair.hidden_values()
        for where, entry in [(f"parameters.{key}", item) for key, item in recipe.parameters.items()] + [
            (f"distributions.{key}", item) for key, item in recipe.distributions.items()
        ]:
            found = [Problem(f"{where}.{one.path}", one.message, one.value) for one in entry.problems()]
            hidden |= {where.partition(".")[2], entry.name or ""} if found else set()
            problems += found
        numbers = repair.indices("base")
        bases = [_base(recipe, place, number, folder, problems) for place, number in enumerate(numbers)]
        kept = [(number, *each) for number, each in zip(numbers, bases, strict=True) if each is not None]
        changed = {each[1] for each in repair.wrong if each[:1] == ("set",) and len(each) > 1}
        parts = tuple(frozenset({*wrong, *changed}) for _, _, wrong in kept)
        recipe._bases = tuple(scene for _, scene, _ in kept)
        unexamined = Unexamined(frozenset(hidden), parts, tuple(number for number, _, _ in kept))
        sampler = Sampler(recipe, recipe._bases, unexamined)
        # Problems that depend on the base scenes are reported too.
        problems += sampler.problems
        if problems:
            problems += range_problems(sampler)
        # Several base scenes may have the same.
        return recipe, [each for number, each in enumerate(problems) if each not in problems[:number]]

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
    plain, source, folder = read_input(given, "a recipe", RecipeError, within="datasets")
    plain, wrong = override(plain, overrides)
    found, problems = Recipe._read(plain, folder)
    problems = join_override_problems(wrong, problems)
    if problems or found is None:
        raise RecipeError(problems, source=source)
    return found


class _RecipeRepair(FieldRepair):
    """Values of a recipe, in which fields with errors are removed or replaced."""

    required: ClassVar[Mapping[str, Any]] = {"name": "recipe", "base": [{"scene": {}}], "samples": 1}

    def __init__(self, plain: Mapping[str, Any]) -> None:
        super().__init__(plain)
        self._values = plain

    def resolve(self) -> None:
        """Remove values with names that are not unique, and changes of varied fields."""
        varied = self._names()
        twice = {name for name, count in Counter(name for _, _, names in varied for name in names).items() if count > 1}
        for group, key, names in varied:
            if twice & {*names}:
                self.plain[group].pop(key, None)
                self.wrong.add((group, key))
        for key in {*self.plain.get("set", {})} & {*self.plain.get("distributions", {})}:
            del self.plain["set"][key]
            self.wrong.add(("set", key))

    def _names(self) -> list[tuple[str, str, list[str]]]:
        """Return group and key of all values with the names that must be unique."""
        found = []
        for group in ("parameters", "distributions"):
            for key, entry in self.plain.get(group, {}).items():
                name = entry.get("name") if isinstance(entry, Mapping) else None
                found.append((group, key, [key, *([name] if name else [])]))
        return found

    def hidden_values(self) -> set[str]:
        """Return paths and names of all values with errors, as far as the errors leave them."""
        found = {""}
        for group, key, *_ in (each for each in self.wrong if len(each) > 1):
            if group in ("parameters", "distributions"):
                entry = self._values[group].get(key)
                name = entry.get("name") if isinstance(entry, Mapping) else None
                found |= {key, name} if isinstance(name, str) else {key}
        for group in ("parameters", "distributions"):
            if (group,) in self.wrong:
                found |= set(map(str, self._values.get(group) or ()))
        return found


def _base(
    recipe: RecipeModel, place: int, number: int, folder: Path | None, problems: list[Problem]
) -> tuple[Scene, frozenset[str]] | None:
    """Return a base scene with the shared changes applied, and its parts with problems; None if there is no scene.

    ``place``: Its index among the base scenes without errors. ``number``: Its index in the recipe.
    """
    given = recipe.base[place].scene
    where, source = f"base.{number}", f" ({given})" if isinstance(given, str) else ""
    try:
        reading = read_scene(given) if isinstance(given, str) else validate_scene(given, folder=folder)
    except SceneError as error:
        reading = SceneReading(None, error.problems)
    changed = change_scene(reading, recipe.set, None if recipe.folder is None else Path(recipe.folder))
    for one in changed.problems:
        if isinstance(given, str) and not one.path and one.message.startswith(NO_FILE):
            problems.append(Problem(where, _no_such_scene(given), given))
        else:
            path = ".".join(filter(None, (where, one.path)))
            problems.append(Problem(path, f"{one.message}{source}", one.value))
    problems += [Problem(f"set.{one.path}", one.message, one.value) for one in changed.misplaced]
    return None if changed.scene is None else (changed.scene, changed.wrong)


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
        remedy = f"use the bundled scene by name: {path.stem}" if known else "specify the path of a scene file"
        return f"{NO_FILE}; {remedy}"
    near = [f"'{name}'" for name in difflib.get_close_matches(path.name.lower(), shipped, n=3)]
    question = f"; did you mean {' or '.join(near)}?" if near else ";"
    return f"no such file or bundled scene{question} `scenetruth list scenes` lists all"


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
