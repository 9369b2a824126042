"""The public names: complete, lazy, and not hidden by the rooms of the same name."""

from __future__ import annotations

import importlib
import pkgutil
import subprocess
import sys
from types import ModuleType

import pytest

import scenetruth as st


@pytest.mark.parametrize("name", st.__all__)
def test_every_public_name_exists_and_is_documented(name: str) -> None:
    assert getattr(st, name).__doc__


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
