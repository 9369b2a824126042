"""Docstrings of fields, as they stand in the source."""

from __future__ import annotations

from scenetruth.validated_model import field_docstrings


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
