"""The three sorts of files that are described: scenes, recipes of data sets, design specifications."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from scenetruth_site.file_examples import FileExamples, examples_in
from scenetruth_site.file_models import FileModel, Schema, models_of
from scenetruth_site.file_pages import models_in_markdown, room_of

__all__ = ["DESCRIBED", "DescribedFile", "room_in_markdown", "rooms_of"]

_ROOT = Path(__file__).parents[3]


@dataclass(frozen=True)
class DescribedFile:
    """A sort of file.

    Parameters
    ----------
    schema
        Makes its JSON Schema.
    rooms
        Paths, each with the part of the file that is described there.
    examples
        Files that come with the project, as a pattern from the root of the repository.
    """

    schema: Callable[[], Schema]
    rooms: dict[str, str]
    examples: str


def _scene() -> Schema:
    from scenetruth.scene import Scene

    return Scene.model_json_schema()


def _recipe() -> Schema:
    from scenetruth.dataset.recipe_loader import Recipe

    return Recipe.model_json_schema()


def _design() -> Schema:
    from scenetruth.design.optimisation import DesignSpec

    return DesignSpec.model_json_schema()


DESCRIBED = {
    "scene": DescribedFile(
        _scene,
        {
            "": "scene",
            "camera": "camera",
            "optics": "camera",
            "shutter": "camera",
            "stage": "stage",
            "frames": "stage",
            "objects": "objects",
            "objects[].mesh": "meshes",
            "objects[].texture": "textures",
            "objects[].deformation": "deformations",
            "objects[].motion": "motions",
            "plants": "plants",
            "lighting": "light",
            "sensor": "sensor",
            "estimate": "estimate",
            "render": "results",
            "score": "results",
            "storage": "results",
        },
        "scenes/*.yaml",
    ),
    "recipe": DescribedFile(_recipe, {"": "recipe"}, "scenes/datasets/*.yaml"),
    "design": DescribedFile(_design, {"": "design"}, "scenes/designs/*.yaml"),
}
"""What each sort of file is called, and where it is from."""


@lru_cache
def rooms_of(file: str) -> dict[str, dict[str, FileModel]]:
    """Return the models of a sort of file by the part that they are described with, and by name.

    Parameters
    ----------
    file
        A key of ``DESCRIBED``.
    """
    described = DESCRIBED[file]
    found: dict[str, dict[str, FileModel]] = {room: {} for room in described.rooms.values()}
    for name, model in models_of(described.schema()).items():
        found[room_of(model, described.rooms)][name] = model
    return found


def room_in_markdown(file: str, room: str) -> str:
    """Return the sections of one part of a sort of file, as Markdown."""
    schema, examples = _read(file)
    return models_in_markdown(rooms_of(file)[room], file, schema, examples)


@lru_cache
def _read(file: str) -> tuple[Schema, FileExamples]:
    """Return the schema of a sort of file, and what the project's own files say."""
    described = DESCRIBED[file]
    schema = described.schema()
    files = [*sorted(_ROOT.glob(described.examples)), _ROOT / "docs" / "reference" / "examples" / f"{file}.yaml"]
    return schema, examples_in(files, schema)
