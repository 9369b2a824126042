"""The documented file types: scenes, recipes of data sets, design specifications, captures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from scenetruth_site.file_examples import FileExamples, examples_in
from scenetruth_site.file_models import FileModel, Schema, models_of
from scenetruth_site.file_pages import models_in_markdown, page_of

__all__ = ["DESCRIBED", "DescribedFile", "page_in_markdown", "pages_of_file"]

_ROOT = Path(__file__).parents[3]


@dataclass(frozen=True)
class DescribedFile:
    """A file type.

    Parameters
    ----------
    schema
        Function that returns its JSON Schema.
    pages
        Paths, each with its page.
    examples
        Bundled files, as a pattern relative to the root of the repository.
    """

    schema: Callable[[], Schema]
    pages: dict[str, str]
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


def _capture() -> Schema:
    from scenetruth.capture import Capture

    return Capture.model_json_schema()


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
    # No capture is bundled: the examples are those of the reference.
    "capture": DescribedFile(_capture, {"": "capture"}, "scenes/captures/*.yaml"),
}
"""File types by name."""


@lru_cache
def pages_of_file(file: str) -> dict[str, dict[str, FileModel]]:
    """Return the models of a file type by page and by name.

    Parameters
    ----------
    file
        A key of ``DESCRIBED``.
    """
    described = DESCRIBED[file]
    found: dict[str, dict[str, FileModel]] = {page: {} for page in described.pages.values()}
    for name, model in models_of(described.schema()).items():
        found[page_of(model, described.pages)][name] = model
    return found


def page_in_markdown(file: str, page: str) -> str:
    """Return one page of a file type, as Markdown."""
    schema, examples = _read(file)
    return models_in_markdown(pages_of_file(file)[page], file, schema, examples)


@lru_cache
def _read(file: str) -> tuple[Schema, FileExamples]:
    """Return the schema of a file type, and the examples from the bundled files."""
    described = DESCRIBED[file]
    schema = described.schema()
    files = [*sorted(_ROOT.glob(described.examples)), _ROOT / "docs" / "reference" / "examples" / f"{file}.yaml"]
    return schema, examples_in(files, schema)
