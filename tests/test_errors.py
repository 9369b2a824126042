"""Errors say where, what and how to mend it, and survive a process boundary."""

from __future__ import annotations

import pickle

import pytest

from scenetruth.errors import (
    ArgumentError,
    BackendUnavailableError,
    EstimateError,
    OutputExistsError,
    Problem,
    RecipeError,
    RecordingError,
    SceneError,
    ScenetruthError,
    StoreError,
)

EXAMPLES = [
    SceneError([Problem("a.b", "is missing"), Problem("c", "must be positive", -1)], source="scene.yaml"),
    StoreError("x.zarr", "no such store"),
    OutputExistsError("out"),
    BackendUnavailableError("pyrender", "no library", "install it"),
]


@pytest.mark.parametrize("error", EXAMPLES, ids=lambda error: type(error).__name__)
def test_pickle_round_trip(error: ScenetruthError) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)


def test_all_problems_are_listed_with_path_and_value() -> None:
    assert str(EXAMPLES[0]).splitlines() == [
        "2 problems with the scene in scene.yaml:",
        "  - a.b: is missing",
        "  - c: must be positive (got -1)",
    ]


@pytest.mark.parametrize("kind", [SceneError, RecipeError, EstimateError, ArgumentError, RecordingError])
def test_an_error_has_at_least_one_problem(kind: type[SceneError]) -> None:
    with pytest.raises(ValueError, match=f"^{kind.__name__} requires at least one problem$"):
        kind([])


def test_long_values_are_shortened() -> None:
    assert len(str(Problem("p", "m", "x" * 1000))) < 120
