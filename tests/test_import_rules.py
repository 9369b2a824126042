"""The rooms of the house may import only what lies below them."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "scenetruth"

LEAVES = {"errors", "model", "settings", "indexing", "presets", "kinds", "randomness", "progress"}
MAY_IMPORT = {
    "errors": set(),
    "model": set(),
    "indexing": set(),
    "kinds": set(),
    "randomness": set(),
    "progress": set(),
    "presets": set(),
    "settings": {"model"},
    "schema": {"errors", "indexing", "progress"},
    "camera": LEAVES,
    "scene": {*LEAVES, "camera", "estimators"},
    "raycast": {*LEAVES, "camera"},
    "render": {*LEAVES, "scene", "camera", "raycast"},
    "truth": {*LEAVES, "scene", "camera", "raycast", "schema", "provenance"},
    "provenance": {*LEAVES, "scene", "camera", "schema"},
    "storage": {"errors", "schema"},
    "simulation": {*LEAVES, "scene", "camera", "raycast", "render", "truth", "schema", "provenance"},
    "estimators": {*LEAVES, "schema"},
    "scoring": {*LEAVES, "schema"},
    "run_folder": {"errors", "estimators"},
    "pipeline": {
        *LEAVES,
        "scene",
        "provenance",
        "schema",
        "estimators",
        "scoring",
        "storage",
        "simulation",
        "truth",
        "run_folder",
    },
    "experiment": {*LEAVES, "scene", "camera", "render", "schema", "estimators"},
}


def imported_rooms(file: Path) -> set[str]:
    rooms = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            assert node.module is not None
            names = [node.module]
            if node.module == "scenetruth":
                names = [f"scenetruth.{alias.name}" for alias in node.names]
        else:
            continue
        rooms |= {name.split(".")[1] for name in names if name.startswith("scenetruth.")}
    return rooms


@pytest.mark.parametrize("room", sorted(MAY_IMPORT))
def test_room_imports_only_what_lies_below(room: str) -> None:
    files = sorted((SOURCE / room).rglob("*.py")) if (SOURCE / room).is_dir() else [SOURCE / f"{room}.py"]
    assert files
    for file in files:
        assert imported_rooms(file) - {room} <= MAY_IMPORT[room], file


def test_every_room_has_a_rule() -> None:
    rooms = {path.stem for path in SOURCE.glob("*.py")} | {path.name for path in SOURCE.iterdir() if path.is_dir()}
    assert rooms - {"__init__", "__main__", "__pycache__", "cli"} == set(MAY_IMPORT)


def test_the_rule_sees_imports_inside_functions(tmp_path: Path) -> None:
    file = tmp_path / "module.py"
    file.write_text("def f():\n    from scenetruth.truth import maps\n    import scenetruth.scene.spec\n")
    assert imported_rooms(file) == {"truth", "scene"}
