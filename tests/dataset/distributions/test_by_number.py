from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from scenetruth.dataset.distributions import GridDistribution
from scenetruth.dataset.recipe_loader import Recipe
from scenetruth.dataset.sampler import Sampler
from scenetruth.errors import RecipeError

Make = Callable[..., Sampler]
DEPTH, ACROSS, CONTRAST = "objects.1.pose.position_mm.2", "objects.1.pose.position_mm.0", "objects.0.texture.mean"


def values_of(sampler: Sampler, key: str) -> list[object]:
    return [sampler.draw(number).values[key] for number in range(len(sampler))]


def test_grids_go_through_every_combination_once(sampler_with: Make) -> None:
    vary = {
        DEPTH: {"kind": "grid", "values": [90, 100, 110]},
        CONTRAST: {"kind": "uniform", "low": 0.4, "high": 0.5},
        ACROSS: {"kind": "grid", "low": -1, "high": 1, "count": 4},
    }
    sampler = sampler_with(samples=12, distributions=vary)
    pairs = list(zip(values_of(sampler, DEPTH), values_of(sampler, ACROSS), strict=True))
    assert len(set(pairs)) == 12
    assert [pair[0] for pair in pairs[:4]] == [90, 100, 110, 90]


def test_lists_begin_again(sampler_with: Make) -> None:
    sampler = sampler_with(samples=5, distributions={DEPTH: {"kind": "sequence", "values": [90, 110]}})
    assert values_of(sampler, DEPTH) == [90, 110, 90, 110, 90]


def test_columns_of_a_table_stay_together(sampler_with: Make, tmp_path: Path) -> None:
    file = tmp_path / "runs.csv"
    file.write_text("depth, across\n95, 1.5\n105, -2\n", encoding="utf-8")
    columns = {DEPTH: "depth", ACROSS: "across"}
    vary = {path: {"kind": "table", "file": str(file), "column": name} for path, name in columns.items()}
    sampler = sampler_with(samples=3, distributions=vary)
    assert values_of(sampler, DEPTH) == [95, 105, 95]
    assert values_of(sampler, ACROSS) == [1.5, -2, 1.5]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("depth\n1\n", "is not in the table; its columns are depth"),
        ("", "is empty"),
        ("a,b\n1\n", "line 2 has 1 values for 2 columns"),
        ("across\n", "has no rows"),
        (None, "No such file"),
    ],
)
def test_tables_that_cannot_be_used_are_told_before_any_draw(
    plain: dict[str, object], tmp_path: Path, text: str | None, message: str
) -> None:
    file = tmp_path / "runs.csv"
    if text is not None:
        file.write_text(text, encoding="utf-8")
    plain["distributions"] = {ACROSS: {"kind": "table", "file": "runs.csv", "column": "across"}}
    with pytest.raises(RecipeError, match=message) as caught:
        Recipe.from_dict(plain, folder=tmp_path).sampler()
    assert caught.value.problems[0].path.startswith(f"distributions.{ACROSS}.")


@pytest.mark.parametrize("fields", [{}, {"values": []}, {"low": 1, "high": 2}, {"values": [1], "low": 1}])
def test_a_grid_is_given_in_one_way(fields: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"needs either|has no values"):
        GridDistribution.model_validate(fields)
