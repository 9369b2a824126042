"""The public names: complete, lazy, and not hidden by the rooms of the same name."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from types import ModuleType

import pytest

import scenetruth as st
from tests.helpers.docstring_sections import sections_of


@pytest.mark.parametrize("name", st.__all__)
def test_every_public_name_exists_and_is_documented(name: str) -> None:
    assert getattr(st, name).__doc__


FUNCTIONS = [name for name in st.__all__ if inspect.isfunction(getattr(st, name))]
EXAMPLES = [*FUNCTIONS, "Problem", "RunDirectory", "Scene", "Score"]


def described_in(section: str) -> list[str]:
    """The names that a section describes, without stars; several may share a line."""
    heads = re.findall(r"^(?! )(\S.*)$", section, flags=re.MULTILINE)
    return [name.strip().lstrip("*") for head in heads for name in head.split(",")]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_public_functions_describe_what_they_take_and_return(name: str) -> None:
    function = getattr(st, name)
    signature, sections = inspect.signature(function), sections_of(function)
    assert described_in(sections.get("Parameters", "")) == list(signature.parameters)
    assert ("Returns" in sections) == (signature.return_annotation not in ("None", None))
    # What each of them refuses is part of what it promises.
    assert all(name in st.__all__ or name == "ValueError" for name in described_in(sections["Raises"]))


@pytest.mark.parametrize("name", EXAMPLES)
def test_public_functions_and_classes_have_examples_that_run(name: str) -> None:
    example = sections_of(getattr(st, name)).get("Examples", "")
    assert ">>>" in example
    assert "+SKIP" not in example


def test_sections_of_a_docstring_are_told_apart() -> None:
    sections = sections_of(st.run_scene)
    assert list(sections) == ["Parameters", "Returns", "Raises", "See Also", "Examples"]
    assert {"truth_views", "save_radiance", "output"} <= set(described_in(sections["Parameters"]))


def test_rooms_are_modules_and_none_is_called_like_a_public_name() -> None:
    rooms = [room.name for room in pkgutil.iter_modules(st.__path__) if room.name != "__main__"]
    assert not set(rooms) & set(st.__all__)
    for room in rooms:
        assert isinstance(importlib.import_module(f"scenetruth.{room}"), ModuleType)
        assert isinstance(getattr(st, room), ModuleType)


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = st.nothing


def test_help_does_not_import_the_heavy_libraries() -> None:
    code = (
        "import sys\n"
        "from scenetruth.cli.app import app\n"
        "try:\n    app(['--help'])\nexcept SystemExit:\n    pass\n"
        "print([name for name in ('numpy', 'xarray', 'numba', 'scipy', 'pydantic', 'trimesh') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.rstrip().endswith("[]")
