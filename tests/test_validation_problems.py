"""Problems of a validation: paths of the file, plain words and remedies, for every format alike."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as some
from pydantic import Field, ValidationError

from scenetruth.validated_model import FrozenModel, Positive
from scenetruth.validation_problems import list_problems, suggest_word


class Disc(FrozenModel):
    kind: Literal["disc"] = "disc"
    radius_mm: Positive
    label: str = ""


class Bar(FrozenModel):
    kind: Literal["bar"] = "bar"
    sides_mm: tuple[Positive, ...]


class Sheet(FrozenModel):
    shapes: tuple[Annotated[Disc | Bar, Field(discriminator="kind")], ...] = ()
    named: dict[str, Disc] = Field(default_factory=dict)
    cutoff_px: Positive | Literal["auto"] = "auto"
    side: Literal["upper", "lower"] = "upper"
    count: int = 1
    base: Disc | None = None


def problems_of(plain: dict[str, Any], under: str = "") -> list[str]:
    with pytest.raises(ValidationError) as caught:
        Sheet.model_validate(plain)
    return [str(problem) for problem in list_problems(caught.value, plain, model=Sheet, under=under)]


@pytest.mark.parametrize(
    ("plain", "expected"),
    [
        ({"shapes": [{"kind": "disc"}]}, "shapes.0.radius_mm: is missing"),
        (
            {"shapes": [{"kind": "disk", "radius_mm": 1}]},
            "shapes.0: unknown `kind`: 'disk' is not one of 'disc', 'bar'; did you mean 'disc'? "
            "(got {'kind': 'disk', 'radius_mm': 1})",
        ),
        ({"shapes": [{"radius_mm": 1}]}, "shapes.0: requires `kind`, one of 'bar', 'disc' (got {'radius_mm': 1})"),
        (
            {"shapes": [{"kind": "disc", "radius_mm": 1, "colour": 2}]},
            "shapes.0.colour: unknown key; valid keys: kind, label, radius_mm (got 2)",
        ),
        (
            {"named": {"a.b": {"radius_mm": "0,5"}}},
            "named.a.b.radius_mm: must be a number with a decimal point: 0.5 (got '0,5')",
        ),
        (
            {"cutoff_px": "atuo"},
            "cutoff_px: input should be a valid number or 'auto'; did you mean 'auto'? (got 'atuo')",
        ),
        ({"side": "uper"}, "side: input should be 'upper' or 'lower'; did you mean 'upper'? (got 'uper')"),
        (
            {"count": True},
            "count: must be a number, not a boolean; YAML reads yes, no, on and off as booleans, too (got 'true')",
        ),
        ({"count": "3,5"}, "count: must be an integer, without a decimal comma (got '3,5')"),
        (
            {"named": {"a": {"radius_mm": "0.5 mm"}}},
            "named.a.radius_mm: must be a number without a unit: 0.5 (got '0.5 mm')",
        ),
        ({"shapes": [{"kind": None}]}, "shapes.0: `kind` must be one of 'disc', 'bar' (got {'kind': None})"),
        ({"count": None}, "count: is empty; fill it in, or remove the key"),
        ({"shapes": {"kind": "bar"}}, "shapes: must be a list; write [...] around a single item (got {'kind': 'bar'})"),
        ({"named": {"x": 3}}, "named.x: must be a mapping of its fields (got 3)"),
        (
            {"base": {"radius_mm": 1, "label": 7}},
            "base.label: must be text; put it in quotes (got 7)",
        ),
    ],
    ids=str,
)
def test_each_problem_has_its_path_and_remedy(plain: dict[str, Any], expected: str) -> None:
    assert problems_of(plain) == [expected]


def test_paths_begin_where_the_input_is_in_its_file() -> None:
    assert problems_of({"count": 0.5}, under="patterns.2")[0].startswith("patterns.2.count: ")


def test_misspelt_keys_come_before_what_is_missing_for_their_sake() -> None:
    found = problems_of({"shapes": [{"kind": "disc", "radius": 1}]})
    assert found == [
        "shapes.0.radius: unknown key; did you mean 'radius_mm'? (got 1)",
        "shapes.0.radius_mm: is missing",
    ]


@given(some.integers(0, 300))
def test_every_problem_is_listed_up_to_a_limit_that_is_stated(count: int) -> None:
    if count == 0:
        return
    found = problems_of({"shapes": [{"kind": "disc", "radius_mm": -1}] * count})
    assert len(found) == min(count, 101)
    if count > 100:
        assert found[-1] == f"(top level): {count - 100} more problems are omitted; fix these first"


@given(some.text(alphabet="abcdefgh", min_size=3, max_size=12), some.data())
def test_a_word_with_one_letter_too_many_is_suggested(word: str, data: some.DataObject) -> None:
    place = data.draw(some.integers(0, len(word)))
    assert suggest_word(f"{word[:place]}z{word[place:]}", [word, "qqqqqqqqqqqq"]) == f"; did you mean '{word}'?"
