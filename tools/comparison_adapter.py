"""The interface of scenetruth by purpose: names that differ between checkouts are listed here.

Each entry of NAMES has candidates; the first one that exists is used. To follow a rename, add a candidate.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import yaml
from comparison_renames import TABLE, Renames

__all__ = [
    "Scenes",
    "api",
    "call",
    "find_attribute",
    "first_of",
    "first_parameter",
    "member",
    "read_form",
    "schema_names",
    "to_plain",
    "to_table",
    "words_of",
]

NAMES: dict[str, tuple[str, ...]] = {
    "app": ("cli:app",),
    # scenes and images
    "load_scene": ("load_scene",),
    "Scene": ("Scene",),
    "scene_from_dict": ("Scene.from_dict", "scene_from_dict", "scene_from_plain"),
    "simulate": ("simulate",),
    "make_truth": ("make_truth",),
    "track_points": ("track_points",),
    "bundled_files": ("bundled_files", "shipped_files"),
    # estimates and scores
    "estimate": ("estimate",),
    "find_method": ("estimators:find_method",),
    "list_methods": ("estimators:list_methods", "estimators:method_entries"),
    "score": ("score",),
    "growth_rate": ("compute_growth_rate", "surface_growth"),
    "make_estimate": ("make_estimate",),
    "make_recording": ("make_recording",),
    "mismatches": ("scoring:detect_convention_mismatches", "scoring:find_slips"),
    "quantities": ("scoring:QUANTITIES",),
    "figures": ("scoring:FIGURES",),
    "write_recording": ("estimators:write_recording",),
    "read_results": ("estimators:read_results",),
    # theory
    "cramer_rao": ("cramer_rao_bound", "bound:cramer_rao"),
    "closed_form": ("closed_form_bound", "bound:envelope_of"),
    "predict": ("predict",),
    "recommend": ("design:recommend", "design:advise"),
    # design
    "budget": ("design:budget",),
    "sweep": ("sweep",),
    "optimise": ("design:optimise",),
    "Goal": ("design:DesignSpec", "design:Goal"),
    "goal_from_dict": ("design:DesignSpec.from_dict", "design:design_spec_from_dict", "design:goal_from_plain"),
    "pattern": ("design:generate_pattern", "design:make_pattern"),
    "assess_pattern": ("design:assess_pattern", "design:pattern_worth"),
    "write_pattern": ("design:export_pattern", "design:write_pattern"),
    "pattern_rig": ("design:PatternRig.from_scene", "design:pattern_rig_from_scene", "design:rig_of"),
    # benchmark and data sets
    "compare": ("compare",),
    "cases": ("benchmark:all_cases", "comparison:all_cases", "benchmark:load_cases"),
    "Recipe": ("dataset:Recipe",),
    "load_recipe": ("load_recipe",),
    "run_dataset": ("run_dataset",),
    "estimate_dataset": ("dataset:estimate_dataset",),
    "write_card": ("dataset:write_card",),
    "open_dataset": ("open_dataset",),
    # files
    "export": ("export_data", "export"),
    "export_formats": ("export_formats",),
    "format_models": ("export:known_formats", "exporters:load_formats", "exporters:list_formats", "export_formats"),
    "run_scene": ("run_scene",),
    "verify": ("verify", "verify_run", "verify_folder"),
    "estimator_checks": ("testing:estimator_checks",),
    "emva": ("run_emva",),
}
"""Candidates: a public name of scenetruth, or "PACKAGE:NAME" for what a module below a package defines, public or not.
A name that is not public is searched in the sources, so that a module may move."""

ALIASES: dict[str, tuple[str, ...]] = {
    "folder": ("output",),
    "ideal": ("save_radiance",),
    "level": ("model",),
    "draws": ("seeds",),
    "confirm": ("simulated_share",),
    "values": ("levels",),
    "goal": ("specification", "design", "spec"),
    "like": ("recording",),
    "kind": ("status", "type"),
    "images": ("save_images", "form"),
    "sampler": ("recipe",),
    "margin_px": ("interior_margin_px",),
    "every_px": ("step_px",),
    "sobol": ("sobol_points",),
    "part": ("partition",),
}
"""Other names of arguments."""
WORDS = {("model", "envelope"): "analytic", ("model", "bound"): "maps"}
"""Other words for values of arguments that were renamed."""
_DROPPED = ("workers", "stages")
"""Arguments that a function may lack."""


def first_of(*candidates: str) -> Any:
    """Return the first candidate, "NAME" or "PACKAGE:NAME", that exists."""
    import scenetruth

    for candidate in candidates:
        package, _, path = candidate.rpartition(":")
        name, *members = path.split(".")
        if not package and name in scenetruth.__all__:
            found: Any = getattr(scenetruth, name)
        elif (module := _module_of(package, name)) is not None:
            found = getattr(import_module(module), name)
        else:
            continue
        if members and not hasattr(found, members[0]):
            continue
        return getattr(found, members[0]) if members else found
    message = f"none of {', '.join(candidates)} exists; add a candidate to NAMES in tools/comparison_adapter.py"
    raise LookupError(message)


def _module_of(package: str, name: str) -> str | None:
    """Return the module below a package (any if empty) that defines a name."""
    pattern = re.compile(rf"^(?:(?:async )?def|class) {name}\b|^{name}\b *[:=]", re.MULTILINE)
    for module, text in _sources().items():
        parts = module.split(".")
        if ("cli" in parts) == (package == "cli") and (not package or package in parts) and pattern.search(text):
            return module
    return None


@cache
def _sources() -> dict[str, str]:
    """Return the sources of all modules, those with the shortest names first."""
    import scenetruth

    top = Path(str(scenetruth.__file__)).parent
    found = {}
    for file in top.rglob("*.py"):
        parts = ("scenetruth", *file.relative_to(top).with_suffix("").parts)
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = file.read_text(encoding="utf-8")
    return {name: found[name] for name in sorted(found, key=lambda one: (one.count("."), one))}


def api(name: str) -> Any:
    """Return what is listed in NAMES."""
    return first_of(*NAMES[name])


def call(function: Callable[..., Any], *args: Any, **options: Any) -> Any:
    """Call a function with arguments by the names that it has for them; ``workers`` is set to this process alone."""
    parameters = inspect.signature(function).parameters
    open_ended = any(one.kind is one.VAR_KEYWORD for one in parameters.values())
    given: dict[str, Any] = {}
    for name, value in options.items():
        known = next((one for one in (name, *ALIASES.get(name, ())) if one in parameters), None)
        if known is None and (open_ended or name not in _DROPPED):
            known = name
        if known is not None:
            given[known] = WORDS.get((known, value), value) if isinstance(value, str) else value
    if "workers" not in parameters:
        return function(*args, **given)
    try:
        return function(*args, **{**given, "workers": 0})
    except Exception as error:  # of any class
        if "workers" not in str(error):
            raise
        return function(*args, **{**given, "workers": 1})


def member(thing: Any, *names: str) -> Any:
    """Return the first member of a thing that exists, by one of its names or by what the table renames them to."""
    renames = _table()
    for name in (new for old in names for new in (old, *renames.names("public names", old))):
        if hasattr(thing, name):
            return getattr(thing, name)
    message = f"{type(thing).__name__} has none of {', '.join(names)}; add the new name to {TABLE.name}"
    raise LookupError(message)


@cache
def _table() -> Renames:
    return Renames.read()


def find_attribute(thing: Any, *names: str) -> Any:
    """Return what a member of a thing is, or returns if it is a method."""
    found = member(thing, *names)
    return found() if inspect.ismethod(found) else found


def first_parameter(function: Callable[..., Any]) -> str:
    """Return the name of the first parameter of a function."""
    return next(iter(inspect.signature(function).parameters), "")


def to_plain(thing: Any) -> Any:
    """Return a result or a model as plain values."""
    return find_attribute(thing, "to_dict", "to_plain")


def to_table(thing: Any) -> Any:
    """Return a result as a table."""
    return find_attribute(thing, "to_dataframe", "to_frame")


@cache
def schema_names(model: str) -> frozenset[str]:
    """Return all names of fields and all words in the JSON Schema of a model that is listed in NAMES."""
    return words_of(api(model))


def words_of(model: Any) -> frozenset[str]:
    """Return all names of fields and all words in the JSON Schema of a model."""
    found: set[str] = set()

    def walk(part: Any) -> None:
        if isinstance(part, Mapping):
            properties = part.get("properties")
            found.update(properties if isinstance(properties, Mapping) else ())
            found.update(str(word) for word in part.get("enum", ()) if isinstance(part.get("enum"), list))
            found.update([str(part["const"])] if isinstance(part.get("const"), str) else ())
            for one in part.values():
                walk(one)
        elif isinstance(part, list):
            for one in part:
                walk(one)

    walk(model.model_json_schema())
    return frozenset(found)


def read_form(read: Callable[[Any], Any], plain: Any, model: str, renames: Renames) -> Any:
    """Read an input in the first form of its names that the checkout accepts."""
    problem: Exception | None = None
    for form in renames.inputs(plain, schema_names(model)):
        try:
            return read(form)
        except Exception as error:  # of any class: the next form may be accepted
            problem = error
    assert problem is not None
    raise problem


class Scenes:
    """Scenes of a checkout in a small size.

    Parameters
    ----------
    checkout
        The checkout.
    renames
        The table of renamed names.
    width
        Width of the images, px; the focal length shrinks with it.
    overrides
        Further changes of every scene, "PATH=VALUE".
    """

    def __init__(self, checkout: Path, renames: Renames, width: int, overrides: Iterable[str]) -> None:
        self.folder = checkout / "scenes"
        self._renames, self._width, self._overrides = renames, width, list(overrides)

    def names(self) -> list[str]:
        """Return the names of the bundled scenes."""
        return sorted(file.stem for file in self.folder.glob("*.yaml"))

    def file(self, *names: str) -> Path:
        """Return the first file below the folder of scenes that exists."""
        return next((self.folder / name for name in names if (self.folder / name).exists()), self.folder / names[0])

    def changes(self, name: str, width: int = 0, *, crop: bool = False) -> dict[str, Any]:
        """Return the changes that make a bundled scene small.

        Parameters
        ----------
        name
            Name of the scene.
        width
            Width of the images, px.
        crop
            Whether the view becomes narrower too, so that textures keep more pixels per wavelength; else all of the
            scene stays in view.
        """
        camera = yaml.safe_load(self.file(f"{name}.yaml").read_text(encoding="utf-8"))["camera"]
        share = min(1.0, (width or self._width) / camera["width"])
        return {
            "camera.width": round(camera["width"] * share),
            "camera.height": round(camera["height"] * share),
            "camera.focal_length_px": camera["focal_length_px"] * share ** (0.5 if crop else 1.0),
            "frames.count": 3,
            "render.backend": "raycast",
            "score.interior_margin_px": 4,
        }

    def load(self, name: str, changes: Mapping[str, Any] | None = None, width: int = 0, *, crop: bool = False) -> Any:
        """Load a bundled scene in a small size, with further changes."""
        load = api("load_scene")

        def read(form: Mapping[str, Any]) -> Any:
            given = [f"{path}={json.dumps(value)}" for path, value in form.items()]
            return call(load, self.file(f"{name}.yaml"), overrides=[*given, *self._overrides])

        given = {**self.changes(name, width, crop=crop), **(changes or {})}
        return read_form(read, given, "Scene", self._renames)

    def read(self, plain: Mapping[str, Any]) -> Any:
        """Return a scene from plain values."""
        return read_form(lambda form: api("scene_from_dict")(form), plain, "Scene", self._renames)

    def form(self, plain: Any, model: str) -> Any:
        """Return an input in the names of the checkout."""
        readers = {"Goal": "goal_from_dict", "Scene": "scene_from_dict"}
        reader = api(readers[model]) if model in readers else api(model).model_validate
        return read_form(lambda form: (reader(form), form)[1], plain, model, self._renames)
