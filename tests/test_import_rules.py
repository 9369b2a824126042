"""The rooms of the house may import only what lies below them."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "scenetruth"

LEAVES = {
    "cache",
    "errors",
    "model",
    "settings",
    "indexing",
    "presets",
    "kinds",
    "files",
    "pages",
    "randomness",
    "progress",
    "docstrings",
    "compilation",
    "threads",
    "plain",
}
MAY_IMPORT = {
    "cache": set(),
    "errors": set(),
    "docstrings": set(),
    "compilation": {"errors"},
    "threads": {"compilation"},
    "plain": {"errors"},
    "model": {"docstrings"},
    "indexing": set(),
    "kinds": set(),
    "files": set(),
    "pages": set(),
    "randomness": set(),
    "progress": set(),
    "presets": set(),
    "settings": {"model"},
    "schema": {"errors", "indexing", "progress", "plain"},
    "camera": LEAVES,
    "scene": {*LEAVES, "camera", "estimators"},
    "raycast": {*LEAVES, "camera"},
    "render": {*LEAVES, "scene", "camera", "raycast"},
    "resources": {*LEAVES, "scene", "camera", "render"},
    "truth": {*LEAVES, "scene", "camera", "raycast", "schema", "provenance", "resources"},
    "provenance": {*LEAVES, "scene", "camera", "schema"},
    "placing": {"errors"},
    "storage": {"errors", "schema", "placing", "compilation"},
    "export": {*LEAVES, "schema", "placing", "storage"},
    "simulation": {
        *LEAVES,
        "scene",
        "camera",
        "raycast",
        "render",
        "truth",
        "schema",
        "provenance",
        "resources",
        "placing",
        "storage",
    },
    "estimators": {*LEAVES, "schema"},
    "scoring": {*LEAVES, "schema"},
    "pipeline": {
        *LEAVES,
        "scene",
        "camera",
        "provenance",
        "resources",
        "schema",
        "estimators",
        "scoring",
        "placing",
        "storage",
        "export",
        "simulation",
        "truth",
    },
    "dataset": {
        *LEAVES,
        "scene",
        "camera",
        "provenance",
        "render",
        "raycast",
        "resources",
        "schema",
        "placing",
        "storage",
        "simulation",
        "truth",
        "pipeline",
        "estimators",
        "scoring",
        "export",
    },
    "bound": {*LEAVES, "schema"},
    "comparison": {
        *LEAVES,
        "scene",
        "provenance",
        "schema",
        "placing",
        "simulation",
        "estimators",
        "scoring",
        "bound",
        "dataset",
    },
    "design": {
        *LEAVES,
        "scene",
        "camera",
        "raycast",
        "render",
        "truth",
        "resources",
        "provenance",
        "schema",
        "placing",
        "simulation",
        "estimators",
        "scoring",
        "bound",
        "dataset",
        "comparison",
    },
    "testing": {
        *LEAVES,
        "schema",
        "scene",
        "provenance",
        "placing",
        "storage",
        "simulation",
        "estimators",
        "scoring",
        "bound",
    },
    "experiment": {*LEAVES, "scene", "camera", "render", "schema", "estimators"},
}
SCENE_MAY_IMPORT = {
    "jets": set(),
    "motion": {"jets"},
    "motions": {"motion"},
    "deformation": {"jets", "motion"},
    "deformations": {"deformation"},
    "mesh": {"jets", "motion"},
    "surface": {"jets", "motion", "mesh"},
    "nodal": {"jets", "motion", "deformation", "mesh", "surface"},
    "texture": {"mesh"},
    "leaf": {"mesh", "texture"},
    "light": {"motion", "motions"},
    "lighting": {"light"},
    "pose": set(),
    "item": {"motions", "deformation", "mesh", "nodal", "texture", "pose"},
    "plant": {"motion", "motions", "deformation", "deformations", "leaf", "pose", "item"},
    "summary": {"lighting", "item", "plant"},
    "spec": {"texture", "lighting", "item", "plant", "summary"},
    "suggestions": {"spec"},
    "reading": set(),
    "load": {"reading", "spec", "suggestions"},
    "times": {"spec"},
    "movement_check": {"motion", "deformation", "surface", "item", "spec"},
    "world": {
        *("jets", "motion", "deformation", "mesh", "surface", "nodal", "texture"),
        *("item", "spec", "times", "movement_check"),
    },
    "lighting_check": {"light", "spec", "world"},
    "check": {"texture", "spec", "times", "world", "lighting_check"},
}
"""Rooms of `scene`, from the lowest to the highest."""

MOST_MODULES = 16
"""A folder with more modules is two rooms."""


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


def imported_modules(file: Path) -> set[str]:
    """Every module named by an import statement, also in functions and for type checkers only; names in it too."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def import_graph(source: Path) -> dict[str, set[str]]:
    """The modules of a package, and which of them each imports; a package itself is its ``__init__.py``."""
    files = {}
    for file in source.rglob("*.py"):
        parts = file.relative_to(source.parent).with_suffix("").parts
        files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    graph: dict[str, set[str]] = {name: set() for name in files}
    for name, file in files.items():
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                graph[name] |= {alias.name for alias in node.names} & set(files)
            elif isinstance(node, ast.ImportFrom):
                # ``from package import module`` needs the module, not what the package exports.
                inner = {f"{node.module}.{alias.name}" for alias in node.names}
                graph[name] |= inner & set(files)
                if inner - set(files) and node.module in files:
                    graph[name].add(node.module)
    return graph


def circle_in(graph: dict[str, set[str]]) -> list[str]:
    """Modules each of which imports the next, the last one the first; empty if there are none."""
    done: set[str] = set()

    def walk(name: str, path: list[str]) -> list[str]:
        if name in path:
            return path[path.index(name) :]
        if name in done:
            return []
        for other in sorted(graph[name]):
            if circle := walk(other, [*path, name]):
                return circle
        done.add(name)
        return []

    return next((circle for name in sorted(graph) if (circle := walk(name, []))), [])


def test_no_modules_import_each_other_in_a_circle() -> None:
    circle = circle_in(import_graph(SOURCE))
    assert not circle, "these import each other in a circle: " + " -> ".join([*circle, *circle[:1]])


@pytest.mark.parametrize(
    "folder", sorted(path.parent for path in SOURCE.rglob("__init__.py")), ids=lambda path: path.name
)
def test_no_folder_holds_too_many_modules(folder: Path) -> None:
    modules = [path for path in folder.glob("*.py") if path.name != "__init__.py"]
    assert len(modules) <= MOST_MODULES, f"{folder} holds {len(modules)} modules: make it two rooms"


@pytest.mark.parametrize("room", SCENE_MAY_IMPORT)
def test_room_of_the_scene_imports_only_what_lies_below(room: str) -> None:
    folder = SOURCE / "scene"
    files = sorted((folder / room).rglob("*.py")) if (folder / room).is_dir() else [folder / f"{room}.py"]
    assert files
    rooms = list(SCENE_MAY_IMPORT)
    assert all(rooms.index(lower) < rooms.index(room) for lower in SCENE_MAY_IMPORT[room]), "not downwards"
    for file in files:
        names = {name.split(".")[2] for name in imported_modules(file) if name.startswith("scenetruth.scene.")}
        assert names - {room} <= SCENE_MAY_IMPORT[room], file


def test_every_room_of_the_scene_has_a_rule() -> None:
    folder = SOURCE / "scene"
    rooms = {path.stem for path in folder.iterdir() if path.name not in ("__init__.py", "__pycache__")}
    assert rooms == set(SCENE_MAY_IMPORT)


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


def test_a_circle_is_seen_wherever_the_import_stands(tmp_path: Path) -> None:
    package = tmp_path / "package"
    (package / "room").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "room" / "__init__.py").write_text("from package.room.low import thing\n")
    (package / "room" / "low.py").write_text("def f():\n    from package.high import thing\n")
    (package / "high.py").write_text("from package.room import low\n")
    assert circle_in(import_graph(package)) == ["package.high", "package.room.low"]
    (package / "room" / "low.py").write_text("")
    assert circle_in(import_graph(package)) == []
    (package / "room" / "low.py").write_text("if TYPE_CHECKING:\n    from package.room import thing\n")
    assert circle_in(import_graph(package)) == ["package.room.low", "package.room"]
