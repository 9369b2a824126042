"""A small recipe, and samplers of others like it."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import pytest

from scenetruth.dataset.recipe_loader import Recipe
from scenetruth.dataset.sampler import Sampler
from tests.helpers.small_recipes import RECIPE


@pytest.fixture
def plain() -> dict[str, Any]:
    return copy.deepcopy(RECIPE)


@pytest.fixture
def sampler_with() -> Callable[..., Sampler]:
    def make(**changes: Any) -> Sampler:
        return Recipe.from_dict({**copy.deepcopy(RECIPE), **changes}).sampler()

    return make
