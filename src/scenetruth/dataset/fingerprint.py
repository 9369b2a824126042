"""The fingerprint of a data set: everything that determines its samples, and the test for equal recipes."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import yaml

from scenetruth.dataset.checksums import list_path, write_with_checksums
from scenetruth.dataset.distributions import LinkedDistribution
from scenetruth.dataset.layout import DatasetFolder
from scenetruth.dataset.recipe_loader import Recipe
from scenetruth.dataset.sampler import Sampler, VariedField, build_drawn_scene
from scenetruth.errors import MachineError, MismatchError, Problem, RecipeError, SceneError, StoreError
from scenetruth.input_files import collect_input_files
from scenetruth.jobs.worker_setup import collect_versions
from scenetruth.output import lock_output
from scenetruth.plain_data import parse_json
from scenetruth.provenance import content_hash, scene_hash
from scenetruth.scene import Scene
from scenetruth.scene.field_paths import PathError, assign
from scenetruth.scene.yaml_reader import MAX_YAML_BYTES, read_yaml
from scenetruth.schema import digest

__all__ = [
    "CHECKED_FORMAT",
    "DatasetFingerprint",
    "begin_dataset",
    "collect_dataset_files",
    "compute_fingerprint",
    "open_sampler",
    "read_fingerprint",
    "refuse_changed_files",
]

_WORDS = (
    *("name", "description", "licence", "citation", "creators", "published", "address"),
    *("format", "samples", "set", "folder"),
)
"""Fields without effect on samples: descriptions and counts; shared settings are part of the base scenes, and files are
hashed by content."""
_STORED = ("description", "estimate", "score", "storage")
"""Sections of a scene without effect on images that are stored in the files of every sample."""
FORMAT = 2
"""Format of new data sets; format 1 has neither checksums of records, catalogue and card, nor hashes of files."""
CHECKED_FORMAT = 2
"""First format with checksums of records, catalogue and card."""


@dataclass(frozen=True)
class DatasetFingerprint:
    """Properties shared by all samples of a data set; ``format`` is the version of the data-set format.

    ``recipe_hash``: Hash of everything that determines samples: the recipe without descriptions and sample count, base
    scenes, contents of files. ``samples``: Number of draws. ``count``: Number of samples, including paired series.
    ``files``: Hashes of all files that a draw can refer to, by path.
    """

    recipe_hash: str
    samples: int
    count: int
    backend: str
    platform: str
    versions: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    format: int = FORMAT

    def to_json(self) -> str:
        """Return the fingerprint as JSON."""
        return json.dumps(asdict(self), indent=2) + "\n"


def compute_fingerprint(sampler: Sampler, backend: tuple[str, str] | None = None) -> DatasetFingerprint:
    """Return the fingerprint of a recipe."""
    name, on = backend or select_backend(sampler)
    recipe = sampler.recipe
    files = {str(path): content_hash(path) for path in collect_dataset_files(sampler)}
    recipe_hash = compute_recipe_hash(sampler)
    return DatasetFingerprint(recipe_hash, recipe.samples, recipe.count, name, on, collect_versions(), files)


def compute_recipe_hash(sampler: Sampler) -> str:
    """Return the hash of everything that determines samples except their number, 16 hexadecimal digits."""
    recipe = sampler.recipe
    plain = {name: value for name, value in recipe.to_dict().items() if name not in _WORDS}
    plain["base"] = [[_base_hash(scene), entry.weight] for scene, entry in zip(sampler.bases, recipe.base, strict=True)]
    # The order of fields determines the dimensions of the Sobol sequence and the axes of grids.
    plain["order"] = [item.key for item in sampler.varied]
    plain["files"] = [content_hash(file) for file in _list_tables(sampler)]
    if drawn := _list_drawn_files(sampler):
        plain["drawn_files"] = {str(path): content_hash(path) for path in drawn}
    entries = (*plain["distributions"].values(), *plain["parameters"].values())
    for entry in entries:
        # Tables are hashed by content, not by path.
        entry.pop("file", None)
    if any(entry.get("sampling") == "latin_hypercube" for entry in entries):
        plain["samples"] = recipe.samples
    return digest(plain)


def collect_dataset_files(sampler: Sampler) -> list[Path]:
    """Return every file that a draw of a recipe can refer to: of base scenes, drawn values and tables."""
    bases = [path for scene in sampler.bases for _, path in collect_input_files(scene)]
    return sorted({*bases, *_list_tables(sampler), *_list_drawn_files(sampler)})


def _list_tables(sampler: Sampler) -> list[Path]:
    """Return the files named by distributions themselves, in the order of the recipe."""
    return [path for where, path in collect_input_files(sampler.recipe) if not where.startswith("base.")]


@lru_cache(maxsize=4)
def _list_drawn_files(sampler: Sampler) -> tuple[Path, ...]:
    """Return the files that values of distributions and paired factors name, in scenes with these values."""
    found: set[Path] = set()
    folder = sampler.recipe.folder
    tried = [(places, value) for _, places, value in sampler.ladders]
    tried += [(item.places, value) for item in sampler.varied for value in _trial_values(sampler, item)]
    # Tables repeat values.
    named = {(places, json.dumps(value, default=str)): value for places, value in tried if _has_text(value)}
    for number, base in enumerate(sampler.bases):
        middle, known = sampler.middle(number) if named else {}, {path for _, path in collect_input_files(base)}
        for (places, _), value in named.items():
            plain = copy.deepcopy(middle)
            try:
                for place in places:
                    assign(plain, place, copy.deepcopy(value))
                found.update(
                    path for _, path in collect_input_files(build_drawn_scene(plain, folder)) if path not in known
                )
            except (PathError, SceneError):
                # Values that give no scene with this base are reported by the validation of the recipe.
                continue
    return tuple(sorted(found))


def _trial_values(sampler: Sampler, item: VariedField) -> list[Any]:
    """Return the values that cover a distribution; those of a linked value are those of its source."""
    seen: set[str] = set()
    while isinstance(item.distribution, LinkedDistribution) and item.key not in seen:
        seen.add(item.key)
        of = item.distribution.of
        item = next((one for one in sampler.varied if of in (one.key, one.name)), item)
    return [value for _, value in item.distribution.trials()]


def _has_text(value: Any) -> bool:
    if isinstance(value, Mapping):
        return any(_has_text(one) for one in value.values())
    if isinstance(value, list | tuple):
        return any(_has_text(one) for one in value)
    return isinstance(value, str)


def refuse_changed_files(identity: DatasetFingerprint, scene: Scene) -> None:
    """Raise if a file of a scene differs from that at the start of the data set."""
    problems = []
    for where, path in collect_input_files(scene):
        former = identity.files.get(str(path))
        if former is not None and former != content_hash(path):
            problems.append(Problem(where, f"{Path(path).name} {_CHANGED_FILE}", str(path)))
    if problems:
        raise MachineError(problems)


_CHANGED_FILE = (
    "is missing, or has changed since the data set was begun, and samples of both contents would be mixed; "
    "restore the former file, or generate another data set in another directory"
)


def _base_hash(scene: Scene) -> str:
    plain = scene.to_dict()
    return digest([scene_hash(scene), {name: plain[name] for name in _STORED}])


def select_backend(sampler: Sampler) -> tuple[str, str]:
    """Return a backend and its platform that render every base scene on this machine."""
    from scenetruth.render import choose_renderer
    from scenetruth.scene.built_scene import build_scene

    found = []
    for number in range(len(sampler.bases)):
        scene = build_drawn_scene(sampler.middle(number), sampler.recipe.folder)
        choice = choose_renderer(scene, build_scene(scene, painted=False))
        with choice.renderer as renderer:
            found.append(renderer.name)
    if any(name == "raycast" for name in found):
        return "raycast", "auto"
    return "pyrender", found[0].partition("(")[2].rstrip(")") or "auto"


def read_fingerprint(folder: DatasetFolder) -> DatasetFingerprint:
    """Return the fingerprint of an existing data set."""
    try:
        found = parse_json(folder.identity.read_bytes())
        identity = DatasetFingerprint(**found)
    except FileNotFoundError as error:
        raise StoreError(folder.path, "is not a data set: it has no dataset.json") from error
    except (OSError, ValueError, TypeError) as error:
        raise StoreError(folder.identity, f"is damaged: {error}") from error
    if not (isinstance(identity.format, int) and identity.format >= 1):
        raise StoreError(folder.identity, f"is damaged: the format is {identity.format!r}")
    if identity.format > FORMAT:
        raise StoreError(folder.identity, f"has the format {identity.format}; this scenetruth reads {FORMAT}")
    return identity


def open_sampler(folder: DatasetFolder) -> Sampler:
    """Return the sampler of an existing data set."""
    try:
        text = folder.recipe.read_text(encoding="utf-8")
        plain, problems = read_yaml(text)
    except (OSError, ValueError) as error:
        raise StoreError(folder.recipe, f"cannot be read: {error}") from error
    if problems:
        raise StoreError(folder.recipe, f"is damaged: {problems[0]}")
    return Recipe.from_dict(plain, source=folder.recipe).sampler()


def begin_dataset(folder: DatasetFolder, sampler: Sampler, *, extend: bool = False) -> DatasetFingerprint:
    """Write recipe and fingerprint of a new data set, or check them against those of an existing data set."""
    place = folder.identity
    # Several partitions may start simultaneously.
    with lock_output(place):
        if not folder.identity.exists():
            if not _is_vacant(folder, sampler):
                raise StoreError(folder.path, "contains other files than a data set; specify another directory")
            return _write(folder, sampler, compute_fingerprint(sampler))
        found = read_fingerprint(folder)
        wanted = compute_fingerprint(sampler, (found.backend, found.platform))
        problems = _differences(folder, found, wanted, sampler, extend)
        if problems:
            raise _OtherRecipeError(problems)
        if wanted.count > found.count:
            # Existing samples keep their format.
            return _write(folder, sampler, replace(wanted, format=found.format))
        return found


def _is_vacant(folder: DatasetFolder, sampler: Sampler) -> bool:
    """Return whether a directory has no files, or only those that a killed run of this recipe left."""
    if not folder.path.is_dir():
        return True
    names = {entry.name for entry in folder.path.iterdir() if not entry.name.startswith(".")}
    if not names <= {folder.recipe.name, list_path(folder.identity).name}:
        return False
    return not folder.recipe.exists() or folder.recipe.read_bytes() == _dump_recipe(sampler).encode()


class _OtherRecipeError(MismatchError):
    """A directory that contains another data set."""

    _noun = "data set"

    def __str__(self) -> str:
        return super(MismatchError, self).__str__()


def _differences(
    folder: DatasetFolder, found: DatasetFingerprint, wanted: DatasetFingerprint, sampler: Sampler, extend: bool
) -> list[Problem]:
    problems = []
    files = [path for path, former in found.files.items() if wanted.files.get(path, former) != former]
    if files:
        problems += [Problem(path, _CHANGED_FILE) for path in files]
    elif found.recipe_hash != wanted.recipe_hash:
        changed = _changed(folder, sampler)
        line = f": {', '.join(changed)} changed" if changed else ""
        if not changed and found.format < CHECKED_FORMAT:
            line = ": a file of its draws may have changed; an earlier version began it, and kept no hashes of these"
        message = f"contains a data set of another recipe ({found.recipe_hash}, not {wanted.recipe_hash}){line}"
        if extend and changed == ["samples"]:
            message += "; a Latin hypercube has a fixed number of samples, and cannot be extended"
        problems.append(Problem(str(folder.path), f"{message}; specify another directory, or the former recipe"))
    elif wanted.samples < found.samples:
        message = f"has {found.samples:,} samples, and the recipe has fewer; specify another directory"
        problems.append(Problem(str(folder.path), message, wanted.samples))
    elif wanted.samples > found.samples and not extend:
        message = f"has {found.samples:,} samples, and the recipe has more; allow this with --extend"
        problems.append(Problem(str(folder.path), message, wanted.samples))
    recipe = sampler.recipe
    if (
        not problems
        and recipe.layout == "shards"
        and wanted.count > found.count
        and found.count % recipe.samples_per_shard
    ):
        message = f"has {found.count:,} samples, and its last tar file is not full: it cannot be extended"
        problems.append(Problem(str(folder.path), f"{message}; generate the other samples as a separate data set"))
    for name, one in found.versions.items():
        other = wanted.versions.get(name)
        if other != one:
            message = f"was started with {name} {one}, and this is {other}: samples would differ; install the former"
            problems.append(Problem(str(folder.path), message))
    return problems


def _changed(folder: DatasetFolder, sampler: Sampler) -> list[str]:
    try:
        former = open_sampler(folder)
    except (StoreError, RecipeError):
        return []
    one, other = former.recipe.to_dict(), sampler.recipe.to_dict()
    words = {*_WORDS, "base"} - {"samples"}
    changed = [name for name in one if name not in words and one[name] != other[name]]
    same = [_base_hash(scene) for scene in former.bases] == [_base_hash(scene) for scene in sampler.bases]
    return changed if same else ["base or set", *changed]


def _write_text(text: str, path: Path) -> None:
    path.write_bytes(text.encode())


def resolve_recipe(sampler: Sampler) -> dict[str, Any]:
    """Return the recipe with its base scenes as plain values, independent of other files."""
    plain = {name: value for name, value in sampler.recipe.to_dict().items() if value not in ({}, [], "")}
    plain["base"] = [
        {"scene": scene.to_dict(), "weight": entry.weight}
        for scene, entry in zip(sampler.bases, sampler.recipe.base, strict=True)
    ]
    # Shared settings are already part of the scenes.
    plain.pop("set", None)
    return plain


def _dump_recipe(sampler: Sampler) -> str:
    return yaml.safe_dump(resolve_recipe(sampler), sort_keys=False, allow_unicode=True)


def _write(folder: DatasetFolder, sampler: Sampler, identity: DatasetFingerprint) -> DatasetFingerprint:
    text = _dump_recipe(sampler)
    if len(text) > MAX_YAML_BYTES:
        message = f"has {len(text):,} characters with its base scenes, more than {MAX_YAML_BYTES:,}"
        raise RecipeError([Problem("", message)])
    texts = {folder.recipe: text, folder.identity: identity.to_json()}
    write_with_checksums({path: partial(_write_text, text) for path, text in texts.items()})
    return identity
