"""Data sets: many scenes from one recipe, drawn, simulated, catalogued and read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

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
    from scenetruth.dataset.training_data import FlowPairs, ImagePair, StereoPairs, read_arrays, write_webdataset

__all__ = [
    "DatasetRunResult", "FlowPairs", "ImagePair", "Partition", "Recipe", "RecipeReport", "Sampler", "SceneDataset",
    "StereoPairs", "check_recipe", "estimate_dataset", "export", "load_recipe", "open_dataset", "preview_dataset",
    "read_arrays", "run_dataset", "verify", "write_card", "write_webdataset",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "dataset_estimation": "estimate_dataset",
        "dataset_export": "export verify",
        "generation": "DatasetRunResult RecipeReport check_recipe run_dataset",
        "pages.card": "write_card",
        "pages.preview_page": "preview_dataset",
        "reading": "SceneDataset open_dataset",
        "recipe_loader": "Recipe load_recipe",
        "sampler": "Sampler",
        "samples": "Partition",
        "training_data": "FlowPairs ImagePair StereoPairs read_arrays write_webdataset",
    },
)
