"""Packages that import what they export on first use."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import scenetruth

SOURCE = Path(scenetruth.__file__).parent
LAZY = sorted(
    ".".join(file.parent.relative_to(SOURCE.parent).parts)
    for file in SOURCE.rglob("__init__.py")
    if "export_lazily(" in file.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("name", LAZY)
def test_every_exported_name_is_found_and_listed(name: str) -> None:
    package = importlib.import_module(name)
    assert set(package.__all__) <= set(dir(package))
    for exported in package.__all__:
        assert getattr(package, exported) is vars(package)[exported]
    with pytest.raises(AttributeError, match=f"module '{name}' has no attribute 'nothing'"):
        _ = package.nothing


def test_modules_are_imported_on_first_use() -> None:
    code = (
        "import sys, scenetruth.testing as package\n"
        "name = 'scenetruth.testing.tolerances'\n"
        "assert name not in sys.modules\n"
        "package.LimitError\n"
        "assert name in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
