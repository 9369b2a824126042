"""Valid remainders of invalid input: every planted mistake is reported, also behind others, and none is added."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import pytest
from hypothesis import given
from hypothesis import strategies as some
from pydantic import Field, model_validator

from scenetruth.errors import Problem, RecipeError
from scenetruth.valid_remainder import FieldRepair, Reading, copied, read_model
from scenetruth.validated_model import FrozenModel, Positive


class Size(FrozenModel):
    width: Positive
    height: Positive
    depth: Positive = 1.0

    @model_validator(mode="after")
    def _is_upright(self) -> Self:
        if self.height < self.width:
            msg = "`height` must be at least `width`"
            raise ValueError(msg)
        return self


class Part(FrozenModel):
    name: str
    mass: Positive = 1.0


class Box(FrozenModel):
    size: Size
    parts: tuple[Part, ...] = Field(min_length=1)
    labels: dict[str, Positive] = Field(default_factory=dict)
    colour: str = "grey"
    load: Positive = 1.0
    limit: Positive = 9.0

    @model_validator(mode="after")
    def _holds(self) -> Self:
        if self.load > self.limit:
            msg = "`load` must be at most `limit`"
            raise ValueError(msg)
        return self


class BoxRepair(FieldRepair):
    required: ClassVar[Mapping[str, Any]] = {
        "size": {"width": 1, "height": 1}, "size.width": 1e-3, "size.height": 1e3, "parts": [{"name": "lid"}],
    }  # fmt: skip

    def resolve(self) -> None:
        for name in ("load", "limit"):
            self.plain.pop(name, None)
            self.wrong.add((name,))


SOUND: dict[str, Any] = {
    "size": {"width": 2, "height": 3},
    "parts": [{"name": "lid"}, {"name": "wall", "mass": 2}, {"name": "base", "mass": 3}],
    "labels": {"front": 1, "back": 2},
    "colour": "red",
    "load": 2,
    "limit": 5,
}
# Path and value of each mistake; without a value, the field is missing.
MISTAKES: dict[tuple[str, ...], Any] = {
    ("size", "width"): "wide",
    ("size", "depth"): -1,
    ("size", "volume"): 3,
    ("parts", "0", "name"): None,
    ("parts", "1", "mass"): 0,
    ("parts", "2", "mass"): "heavy",
    ("labels", "front"): -4,
    ("labels", "back"): "far",
    ("colour",): 7,
    ("shape",): "round",
}
SETS = some.sets(some.sampled_from(sorted(MISTAKES)))


def with_mistakes(mistakes: set[tuple[str, ...]]) -> dict[str, Any]:
    plain: dict[str, Any] = copied(SOUND)
    for keys in mistakes:
        place: Any = plain
        for key in keys[:-1]:
            place = place[int(key)] if isinstance(place, list) else place[key]
        place[keys[-1]] = MISTAKES[keys]
        if MISTAKES[keys] is None:
            del place[keys[-1]]
    return plain


def read(plain: Mapping[str, Any]) -> tuple[Box | None, list[str], BoxRepair]:
    repair = BoxRepair(plain)
    box, problems = read_model(Box, plain, repair)
    return box, sorted(each.path for each in problems), repair


@given(SETS)
def test_every_mistake_is_reported_and_no_other(mistakes: set[tuple[str, ...]]) -> None:
    plain = with_mistakes(mistakes)
    before = copied(plain)
    box, paths, repair = read(plain)
    assert paths == sorted(".".join(keys) for keys in mistakes)
    assert plain == before
    assert box is not None
    # Of lists, items without mistakes remain; if there is none, the value that causes no problem.
    sound = [index for index in range(3) if not any(keys[:2] == ("parts", str(index)) for keys in mistakes)]
    names = [SOUND["parts"][index]["name"] for index in sound]
    assert [part.name for part in box.parts] == (names or ["lid"])
    assert all(repair.is_wrong(*keys) for keys in mistakes)
    assert repair.is_wrong("labels") == any(keys[0] == "labels" for keys in mistakes)


@given(SETS)
def test_contradictions_behind_other_mistakes_are_reported(mistakes: set[tuple[str, ...]]) -> None:
    """The check of the whole input runs only if its fields have no errors."""
    plain = with_mistakes(mistakes) | {"load": 8}
    _, paths, _ = read(plain)
    assert paths == sorted(["", *(".".join(keys) for keys in mistakes)])


@given(SETS)
def test_contradictions_within_a_section_are_reported(mistakes: set[tuple[str, ...]]) -> None:
    plain = with_mistakes(mistakes)
    plain["size"]["height"] = 1
    _, paths, _ = read(plain)
    hidden = any(keys[0] == "size" for keys in mistakes)
    others = [".".join(keys) for keys in mistakes]
    # A section with a wrong field has no height that contradicts it.
    assert set(paths) >= set(others)
    assert ("size" in paths) != (("size", "width") in mistakes) or hidden
    assert set(paths) <= {*others, "size"}


def test_items_keep_their_indices_in_later_rounds() -> None:
    """The second item contradicts itself, which shows only after the first is removed."""
    plain = copied(SOUND) | {"load": 8, "parts": [{"name": 3}, {"name": "wall"}, {"name": "base", "mass": -1}]}
    _, paths, repair = read(plain)
    assert paths == ["", "parts.0.name", "parts.2.mass"]
    assert repair.indices("parts") == [1]
    assert repair.given(["parts", "0", "mass"]) == ("parts", "1", "mass")


@pytest.mark.parametrize("kept", [{}, {"size": {"width": 2, "height": 3}}])
def test_missing_sections_have_values_that_cause_no_problem(kept: dict[str, Any]) -> None:
    box, paths, _ = read(kept)
    assert paths == sorted({"size", "parts"} - set(kept))
    assert box is not None


def test_a_reading_returns_its_input_or_raises_all_problems() -> None:
    class BoxReading(Reading[Box]):
        refused = RecipeError

    box, _, repair = read(SOUND)
    assert box is not None
    assert BoxReading(box, (), repair).required() is box
    problems = (Problem("load", "is large"), Problem("limit", "is small"))
    with pytest.raises(RecipeError) as caught:
        BoxReading(box, problems, repair, "box.yaml").required()
    assert caught.value.problems == problems
    assert "box.yaml" in str(caught.value)
