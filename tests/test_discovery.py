from __future__ import annotations

import sys
from pathlib import Path

import pytest
from pydantic import TypeAdapter, ValidationError

from scenetruth.discovery import discriminated_union, kinds_in
from scenetruth.validated_model import FrozenModel

MODULE = """
from typing import Literal
from {room}.base import Shape

class {name}(Shape):
    kind: Literal["{kind}"]
    size_mm: float = 1.0
"""


def room(folder: Path, monkeypatch: pytest.MonkeyPatch, **kinds: str) -> str:
    name = f"room_{folder.name}"
    (folder / name).mkdir()
    (folder / name / "__init__.py").touch()
    base = "from scenetruth.validated_model import FrozenModel\nclass Shape(FrozenModel):\n    pass\n"
    (folder / name / "base.py").write_text(base)
    for module, kind in kinds.items():
        text = MODULE.format(room=name, name=module.capitalize(), kind=kind)
        (folder / name / f"{module}.py").write_text(text)
    monkeypatch.syspath_prepend(folder)
    return name


def base_of(name: str) -> type[FrozenModel]:
    base: type[FrozenModel] = sys.modules[f"{name}.base"].Shape if f"{name}.base" in sys.modules else _load(name)
    return base


def _load(name: str) -> type[FrozenModel]:
    from importlib import import_module

    base: type[FrozenModel] = import_module(f"{name}.base").Shape
    return base


def test_a_module_in_the_room_is_all_that_a_kind_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = room(tmp_path, monkeypatch, torus="torus", box="box")
    assert list(kinds_in(base_of(name), name)) == ["box", "torus"]
    shape = TypeAdapter(discriminated_union(base_of(name), name))
    assert type(shape.validate_python({"kind": "torus"})).__name__ == "Torus"
    assert [ref["$ref"] for ref in shape.json_schema()["oneOf"]] == ["#/$defs/Box", "#/$defs/Torus"]
    with pytest.raises(ValidationError, match="'box', 'torus'"):
        shape.validate_python({"kind": "ring"})


def test_kinds_may_be_written_in_any_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = room(tmp_path, monkeypatch, torus="torus", box="box")
    assert (
        type(TypeAdapter(discriminated_union(base_of(name), name)).validate_python({"kind": "Box"})).__name__ == "Box"
    )


def test_two_modules_cannot_have_one_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = room(tmp_path, monkeypatch, torus="ring", box="ring")
    with pytest.raises(TypeError, match=r"'ring' is used twice: by Box and Torus"):
        kinds_in(base_of(name), name)
