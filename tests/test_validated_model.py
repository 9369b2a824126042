"""Models that refuse what they do not know, and the docstrings of their fields."""

from __future__ import annotations

from typing import Any, Literal

import pytest
from pydantic import ValidationError, model_validator

from scenetruth.validated_model import FrozenModel, field_docstrings


class Words(FrozenModel):
    side: Literal["upper", "lower"] = "upper"
    level: float | Literal["auto", "NONE"] = 1.0
    flag: bool | Literal["maybe"] = False
    text: str | Literal["auto"] = ""
    apart: Literal["x", "X"] = "x"


class Named(FrozenModel):
    preset: Literal["slow"] | None = None
    rate: float

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, given: Any) -> Any:
        return {"rate": 2.0, **given} if given.get("preset") == "slow" else given


@pytest.mark.parametrize(
    ("given", "name", "value"),
    [
        ({"side": "LOWER"}, "side", "lower"),
        ({"side": "lower"}, "side", "lower"),
        ({"level": "Auto"}, "level", "auto"),
        ({"level": "none"}, "level", "NONE"),
        ({"level": "1.5"}, "level", 1.5),
        ({"flag": "Maybe"}, "flag", "maybe"),
        ({"flag": True}, "flag", True),
        ({"text": "Auto"}, "text", "Auto"),
        ({"apart": "X"}, "apart", "X"),
    ],
)
def test_words_are_kept_as_declared(given: dict[str, Any], name: str, value: object) -> None:
    assert getattr(Words.model_validate(given), name) == value
    assert getattr(Words(**given), name) == value


def test_presets_are_looked_up_in_any_case() -> None:
    assert Named.model_validate({"preset": "SLOW"}) == Named(preset="slow", rate=2.0)


@pytest.mark.parametrize("side", ["sideways", "upper ", 1, True, None])
def test_other_words_are_refused(side: object) -> None:
    with pytest.raises(ValidationError, match="'upper' or 'lower'"):
        Words.model_validate({"side": side})


def test_what_is_given_is_left_as_it_is() -> None:
    given = {"side": "LOWER"}
    Words.model_validate(given)
    assert given == {"side": "LOWER"}


class Plain:
    first: int = 1
    """What comes
    first."""
    second: int = 2
    third = 3
    """Not a field: it has no type."""


class Derived(Plain):
    second: int = 4
    """Told by the derived class."""

    class Inner:
        first: int = 0
        """Of a class inside."""


def test_fields_and_what_they_inherit() -> None:
    class Local(Derived):
        first: int = 7
        """Of a class in a function."""

    assert field_docstrings(Plain) == {"first": "What comes\nfirst."}
    assert field_docstrings(Derived) == {"first": "What comes\nfirst.", "second": "Told by the derived class."}
    assert field_docstrings(Derived.Inner) == {"first": "Of a class inside."}
    assert field_docstrings(Local)["first"] == "Of a class in a function."


def test_classes_without_source() -> None:
    made = type("Made", (Plain,), {"__module__": "nowhere"})
    assert field_docstrings(made) == field_docstrings(Plain)
    assert field_docstrings(int) == {}
