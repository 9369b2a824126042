"""Values by the number of the sample, and random ones against SciPy's distributions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial.transform import Rotation

from scenetruth.dataset.distributions import (
    ChoiceDistribution,
    ConeDistribution,
    GridDistribution,
    IntegersDistribution,
    LogUniformDistribution,
    NormalDistribution,
    RandomDistribution,
    RotationDistribution,
    UniformDistribution,
)
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


COUNT = 4000
# Of tests that hold, one of a thousand fails by chance; the numbers are always the same.
RARE = 1e-3


def drawn(distribution: RandomDistribution) -> list[Any]:
    numbers = np.random.default_rng(5).random((COUNT, distribution.uniforms))
    return [distribution.value(row) for row in numbers.tolist()]


@pytest.mark.parametrize(
    ("distribution", "expected"),
    [
        (UniformDistribution(low=-2, high=3), stats.uniform(-2, 5)),
        (LogUniformDistribution(low=0.01, high=5), stats.loguniform(0.01, 5)),
        (NormalDistribution(mean=3, std=2), stats.norm(3, 2)),
        (NormalDistribution(mean=3, std=2, low=2, high=8), stats.truncnorm(-0.5, 2.5, 3, 2)),
        (NormalDistribution(mean=0, std=1, low=4), stats.truncnorm(4, np.inf, 0, 1)),
    ],
    ids=lambda one: getattr(one, "kind", ""),
)
def test_numbers_are_distributed_as_scipy_says(distribution: RandomDistribution, expected: Any) -> None:
    assert stats.kstest(drawn(distribution), expected.cdf).pvalue > RARE


@given(st.floats(2.0**-60, 1 - 2.0**-53))
def test_no_number_is_outside_its_ends(u: float) -> None:
    for one in (
        UniformDistribution(low=-2, high=3),
        LogUniformDistribution(low=0.01, high=5),
        NormalDistribution(mean=0, std=1, low=-1, high=9),
    ):
        low, high = (end for _, end in one.trials())
        assert low <= one.value([u]) <= high
    assert IntegersDistribution(low=3, high=7).value([u]) in range(3, 8)


def test_whole_numbers_and_choices_are_as_likely_as_they_should_be() -> None:
    counts = np.bincount(drawn(IntegersDistribution(low=0, high=4)), minlength=5)
    assert stats.chisquare(counts).pvalue > RARE
    found = drawn(ChoiceDistribution(values=["a", "b", "never", "c"], weights=[1, 2, 0, 5]))
    counts = np.array([found.count(word) for word in "abc"])
    assert found.count("never") == 0
    assert stats.chisquare(counts, COUNT * np.array([1, 2, 5]) / 8).pvalue > RARE


def test_directions_fill_their_cap_evenly() -> None:
    axis = np.array([1.0, -2.0, 2.0]) / 3
    found = np.array(drawn(ConeDistribution(axis=(1, -2, 2), half_angle_deg=50)))
    assert np.linalg.norm(found, axis=1) == pytest.approx(1, abs=1e-12)
    # Archimedes: equal steps along the axis cut equal areas of the sphere.
    least = np.cos(np.deg2rad(50))
    assert stats.kstest(found @ axis, stats.uniform(least, 1 - least).cdf).pvalue > RARE
    across = found - np.outer(found @ axis, axis)
    assert np.abs(across.mean(axis=0)).max() < 4 * across.std() / np.sqrt(COUNT)


def matrices(found: list[Any]) -> NDArray[np.float64]:
    vectors = [np.deg2rad(turn["angle_deg"]) * np.array(turn["axis"]) for (turn,) in found]
    return np.asarray(Rotation.from_rotvec(vectors).as_matrix())


def test_rotations_are_equally_likely() -> None:
    turned = matrices(drawn(RotationDistribution()))
    # Whatever direction is turned, each of its components is uniform; the angle has density (1 - cos) / pi.
    for component in range(3):
        assert stats.kstest(turned[:, component, 0], stats.uniform(-1, 2).cdf).pvalue > RARE
    angle = np.arccos(np.clip((np.trace(turned, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert stats.kstest(angle, lambda a: (a - np.sin(a)) / np.pi).pvalue > RARE


@pytest.mark.parametrize(
    ("kind", "fields", "message"),
    [
        (UniformDistribution, {"low": 3, "high": 3}, "has no values"),
        (LogUniformDistribution, {"low": 0, "high": 3}, "greater than 0"),
        (NormalDistribution, {"mean": 0, "std": 1, "low": 9}, "hardly any values"),
        (NormalDistribution, {"mean": 0, "std": 1, "low": 2, "high": 1}, "has no values"),
        (IntegersDistribution, {"low": 3, "high": 2}, "has no values"),
        (ChoiceDistribution, {"values": []}, "at least 1"),
        (ChoiceDistribution, {"values": [1, 2], "weights": [1]}, "2 values and 1 weights"),
        (ChoiceDistribution, {"values": [1, 2], "weights": [0, 0]}, "all weights are zero"),
        (ConeDistribution, {"axis": [0, 0, 0], "half_angle_deg": 3}, "zero vector"),
    ],
)
def test_distributions_without_support_are_refused(
    kind: type[RandomDistribution], fields: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        kind.model_validate(fields)
