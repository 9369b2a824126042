"""Every recipe that comes with scenetruth can be followed."""

from __future__ import annotations

from pathlib import Path

import pytest

from scenetruth.dataset.recipe_loader import load_recipe
from scenetruth.dataset.recipe_validation import refuse_recipe

RECIPES = sorted((Path(__file__).parents[2] / "scenes" / "datasets").glob("*.yaml"))


def test_there_are_some() -> None:
    assert {path.stem for path in RECIPES} >= {"cubes", "leaves"}


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.stem)
def test_recipe_can_be_followed(path: Path) -> None:
    sampler = load_recipe(path).sampler()
    refuse_recipe(sampler, tried=2)
    recipe = sampler.recipe
    assert recipe.name == path.stem
    assert recipe.licence
    assert recipe.citation
    assert recipe.creators
    assert recipe.count == 200
