"""Data sets: many scenes from one recipe, drawn, simulated, catalogued and read."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenetruth.dataset.dataset_estimation import estimate_dataset
    from scenetruth.dataset.dataset_export import export, verify
    from scenetruth.dataset.generation import DatasetRunResult, RecipeReport, check_recipe, run_dataset
    from scenetruth.dataset.pages.card import write_card
    from scenetruth.dataset.pages.preview_page import preview_dataset
    from scenetruth.dataset.reading import SceneDataset, open_dataset
    from scenetruth.dataset.recipe_loader import Recipe, load_recipe
    from scenetruth.dataset.sampler import Sampler
    from scenetruth.dataset.samples import Partition

__all__ = [
    "DatasetRunResult",
    "Partition",
    "Recipe",
    "RecipeReport",
    "Sampler",
    "SceneDataset",
    "check_recipe",
    "estimate_dataset",
    "export",
    "load_recipe",
    "open_dataset",
    "preview_dataset",
    "run_dataset",
    "verify",
    "write_card",
]

_HOMES = {
    "DatasetRunResult": "generation",
    "Partition": "samples",
    "Recipe": "recipe_loader",
    "Sampler": "sampler",
    "SceneDataset": "reading",
    "RecipeReport": "generation",
    "check_recipe": "generation",
    "estimate_dataset": "dataset_estimation",
    "export": "dataset_export",
    "load_recipe": "recipe_loader",
    "open_dataset": "reading",
    "preview_dataset": "pages.preview_page",
    "run_dataset": "generation",
    "verify": "dataset_export",
    "write_card": "pages.card",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        msg = f"module 'scenetruth.dataset' has no attribute '{name}'"
        raise AttributeError(msg)
    value = getattr(import_module(f"scenetruth.dataset.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
