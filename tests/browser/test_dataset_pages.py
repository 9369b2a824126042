"""Preview and card of a data set in a headless browser: a phone shows all of them, and so do readers of screens."""

from __future__ import annotations

import copy
import csv
import io
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

from scenetruth.dataset import preview_dataset, write_card
from scenetruth.dataset.generation import run_dataset
from scenetruth.dataset.recipe_loader import Recipe
from tests.browser.test_page_tools import saved
from tests.helpers.browser_pages import opened, reads_well
from tests.helpers.small_recipes import RECIPE


@pytest.fixture(scope="module")
def pages(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("dataset")
    plain = copy.deepcopy(RECIPE) | {
        "samples": 3,
        "paired_factors": {"sensor.noise_std": [0.05]},
        "splits": {"train": 1, "test": 1},
        "acceptance": [{"kind": "depth", "object": "tile", "max": 100}],
    }
    recipe = Recipe.from_dict(plain).sampler()
    run_dataset(recipe.recipe, output=folder / "tiles", workers=1)
    return {"preview": preview_dataset(recipe.recipe, output=folder / "preview"), "card": write_card(folder / "tiles")}


def test_histograms_of_a_card_are_saved_as_pictures_and_as_numbers(browser: Any, pages: dict[str, Path]) -> None:
    with opened(browser, pages["card"], "main") as page:
        tools = page.locator("figure", has=page.locator("template.copy")).first.locator(".tools")
        assert ET.fromstring(saved(page, tools, "svg")).tag.endswith("svg")
        assert saved(page, tools, "png").startswith(b"\x89PNG")
        head, *rows = csv.reader(io.StringIO(saved(page, tools, "csv").decode("utf-8")))
        assert len(rows) == 3
        assert any("pose position Z" in title for title in head)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width_px", [1280, 375])
@pytest.mark.parametrize("name", ["preview", "card"])
def test_it_reads_on_a_phone_and_by_those_who_do_not_see_it(
    browser: Any, pages: dict[str, Path], name: str, width_px: int, scheme: str
) -> None:
    with opened(browser, pages[name], "main") as page:
        reads_well(page, width_px, scheme)
