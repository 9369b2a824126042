"""Layers of imports, sizes of modules and packages, and tests that follow them."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from tests.helpers.source_facts import facts_of

SOURCE = Path(__file__).parents[1] / "src" / "scenetruth"
TESTS = Path(__file__).parent

LEAVES = {
    "bands",
    "cache",
    "compilation",
    "discovery",
    "errors",
    "glossary",
    "html",
    "indexing",
    "input_files",
    "kernels",
    "lazy_exports",
    "memory",
    "number_format",
    "plain_data",
    "progress",
    "random_streams",
    "settings",
    "threads",
    "valid_remainder",
    "validated_model",
    "validation_problems",
}
MAY_IMPORT = {
    "bands": {"validated_model"},
    "cache": set(),
    "errors": set(),
    "compilation": {"errors"},
    "threads": {"compilation"},
    "plain_data": {"errors"},
    "validated_model": set(),
    "validation_problems": {"errors"},
    "valid_remainder": {"errors", "validation_problems"},
    "discovery": set(),
    "indexing": set(),
    "input_files": set(),
    "glossary": set(),
    "html": {"glossary"},
    "kernels": set(),
    "lazy_exports": set(),
    "memory": set(),
    "number_format": set(),
    "random_streams": set(),
    "progress": set(),
    "settings": {"validated_model"},
    "schema": {"errors", "indexing", "lazy_exports", "number_format", "progress", "plain_data"},
    "camera": LEAVES,
    "scene": {*LEAVES, "camera", "estimators"},
    "raycast": {*LEAVES, "camera"},
    "render": {*LEAVES, "scene", "camera", "raycast"},
    "resources": {*LEAVES, "scene", "camera", "render"},
    "truth": {*LEAVES, "scene", "camera", "raycast", "schema", "provenance", "resources"},
    "provenance": {*LEAVES, "scene", "camera", "schema"},
    "output": {"errors"},
    "results": {"errors", "output", "plain_data"},
    "jobs": {*LEAVES, "output", "resources", "schema", "provenance"},
    "storage": {"errors", "schema", "output", "compilation", "lazy_exports"},
    "exporters": {*LEAVES, "schema", "output", "storage", "strain"},
    "simulation": {
        *LEAVES,
        *("scene", "camera", "raycast", "render", "truth", "schema", "provenance", "resources", "output", "storage"),
    },
    "estimators": {*LEAVES, "schema"},
    "scoring": {*LEAVES, "results", "schema", "estimators"},
    "strain": {*LEAVES, "results", "schema", "scoring", "camera", "scene", "truth"},
    "pipeline": {
        *LEAVES,
        *("scene", "camera", "provenance", "resources", "schema", "estimators", "scoring", "output", "storage"),
        *("exporters", "simulation", "strain", "truth"),
    },
    "dataset": {
        *LEAVES,
        *("scene", "camera", "provenance", "render", "raycast", "resources", "schema", "output", "storage"),
        *("simulation", "truth", "pipeline", "estimators", "scoring", "exporters", "jobs"),
    },
    "bound": {*LEAVES, "schema"},
    "benchmark": {
        *LEAVES,
        "results",
        "resources",
        *("scene", "provenance", "schema", "output", "simulation", "estimators", "scoring", "bound", "jobs"),
    },
    "design": {
        *LEAVES,
        "results",
        *("scene", "camera", "raycast", "render", "truth", "resources", "provenance", "schema", "output"),
        *("simulation", "pipeline", "estimators", "scoring", "bound", "jobs", "dataset", "benchmark", "capture"),
    },
    "capture": {
        *LEAVES,
        *("scene", "camera", "render", "truth", "resources", "provenance", "schema", "estimators"),
        *("output", "storage", "jobs", "simulation", "pipeline", "scoring", "results"),
    },
    "testing": {
        *LEAVES,
        *(
            "schema",
            "scene",
            "provenance",
            "output",
            "storage",
            "simulation",
            "truth",
            "estimators",
            "scoring",
            "bound",
        ),
    },
    "validation_studies": {*LEAVES, "scene", "camera", "render", "schema", "estimators"},
}
SCENE_MAY_IMPORT = {
    "taylor_kernels": set(),
    "taylor": {"taylor_kernels"},
    "motion": {"taylor"},
    "deformation": {"taylor", "motion"},
    "picture_file": set(),
    "mesh": {"taylor", "motion", "picture_file"},
    "surface_tensor_kernels": {"taylor"},
    "reference_configuration": {"taylor", "motion", "mesh"},
    "vertex_animation": {"taylor", "motion", "deformation", "mesh", "reference_configuration"},
    "texture": {"mesh", "picture_file"},
    "leaf": {"mesh", "texture"},
    "band_textures": {"mesh", "texture"},
    "light_distribution": set(),
    "lighting": {"motion", "light_distribution"},
    "material": set(),
    "leaf_spectra": set(),
    "scene_object": {"motion", "deformation", "mesh", "vertex_animation", "texture", "material"},
    "plant": {"motion", "deformation", "leaf", "material", "scene_object", "band_textures"},
    "scene_models": {"texture", "lighting", "scene_object", "plant"},
    "field_paths": set(),
    "suggestions": {"scene_models"},
    "yaml_reader": set(),
    "scene_repair": {"texture", "material", "scene_models"},
    "scene_loader": {"yaml_reader", "field_paths", "scene_models", "scene_repair", "suggestions"},
    "built_scene": {
        *("taylor", "motion", "deformation", "mesh", "surface_tensor_kernels", "reference_configuration"),
        *("vertex_animation", "texture", "material", "scene_object", "scene_models", "band_textures"),
    },
    "scene_report": {"texture", "lighting", "scene_models", "built_scene"},
}
"""Modules and packages of `scene`, from the lowest to the highest."""

MAX_LINES = 700
"""A module with more lines holds several concepts."""
MIN_LINES = 100
"""A module with fewer lines, imported by a single module beside it, belongs into that module."""
MIN_MODULES = 4
"""A package with fewer modules is a module."""
MAX_DEPTH = 3
"""Folders below `scenetruth`, one within another."""


def imported_packages(file: Path) -> set[str]:
    packages = set()
    for node in facts_of(file).imports:
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            assert node.level == 0, f"{file}: relative import"
            assert node.module is not None
            names = [node.module]
            if node.module == "scenetruth":
                names = [f"scenetruth.{alias.name}" for alias in node.names]
        packages |= {name.split(".")[1] for name in names if name.startswith("scenetruth.")}
    return packages


def imported_modules(file: Path) -> set[str]:
    """Every module named by an import statement, also in functions and for type checkers only; names in it too."""
    found = set()
    for node in facts_of(file).imports:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif node.module is not None:
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
        for node in facts_of(file).imports:
            if isinstance(node, ast.Import):
                graph[name] |= {alias.name for alias in node.names} & files.keys()
            else:
                # ``from package import module`` needs the module, not what the package exports.
                inner = {f"{node.module}.{alias.name}" for alias in node.names}
                graph[name] |= inner & files.keys()
                if inner - files.keys() and node.module in files:
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


PACKAGES = sorted(path.parent for path in SOURCE.rglob("__init__.py"))
MODULES = sorted(path for path in SOURCE.rglob("*.py") if path.name not in ("__init__.py", "__main__.py"))


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
def test_package_has_at_least_four_modules_and_lies_at_most_three_deep(package: Path) -> None:
    entries = [path for path in MODULES if path.parent == package]
    entries += [path for path in PACKAGES if path.parent == package]
    assert len(entries) >= MIN_MODULES, f"{package} holds {len(entries)} modules: make it one module, or move them up"
    assert len(package.relative_to(SOURCE).parts) <= MAX_DEPTH, f"{package} lies too deep"


def test_no_module_is_longer_than_a_concept() -> None:
    lengths = {path.relative_to(SOURCE).as_posix(): len(path.read_text("utf-8").splitlines()) for path in MODULES}
    too_long = {name: lines for name, lines in lengths.items() if lines > MAX_LINES}
    assert not too_long, f"more than {MAX_LINES} lines: {too_long}"


def lone_importers(source: Path) -> dict[str, str]:
    """Modules that a single module of the same package imports and nothing else does, with that module."""
    graph = import_graph(source)
    users: dict[str, set[str]] = {}
    for name, targets in graph.items():
        for target in targets:
            users.setdefault(target, set()).add(name)
    return {
        name: user
        for name, names in users.items()
        if len(names) == 1 and (user := next(iter(names))).rpartition(".")[0] == name.rpartition(".")[0]
    }


def test_small_module_is_a_leaf_of_its_own() -> None:
    """What only one neighbour imports stands in that neighbour, unless it is large, or a module of kernels."""
    lone = lone_importers(SOURCE)
    small = {}
    for path in MODULES:
        name = ".".join(path.relative_to(SOURCE.parent).with_suffix("").parts)
        lines = len(path.read_text("utf-8").splitlines())
        if lines < MIN_LINES and name in lone and not name.endswith("kernels") and name not in SMALL:
            small[name] = f"{lines} lines, imported by {lone[name]}"
    assert not small, f"merge them: {small}"


SMALL = {
    "scenetruth.cli.dataset_report": "loads scipy, which the other commands of data sets do without",
    "scenetruth.cli.render_probe": "runs as a script, in a process of its own",
    "scenetruth.output.destinations": "the checks of a destination, which read it only",
    "scenetruth.render.opengl_probe": "runs as a script, in a process of its own",
    "scenetruth.storage.stored_array": "loads xarray, which the rest of the package does without until it is used",
}
"""Small modules with one importer that stay apart, and why."""


def public_classes(source: Path) -> dict[str, list[str]]:
    """Return where each public class of a package is defined, by its name."""
    places: dict[str, list[str]] = {}
    for file in sorted(source.rglob("*.py")):
        for name in facts_of(file).public_classes:
            places.setdefault(name, []).append(file.relative_to(source).as_posix())
    return places


def test_public_class_name_stands_for_one_class() -> None:
    twice = {name: files for name, files in public_classes(SOURCE).items() if len(files) > 1}
    assert not twice


def test_no_module_is_called_like_a_public_function() -> None:
    import scenetruth
    from scenetruth import design

    functions = {name for module in (scenetruth, design) for name in module.__all__ if callable(getattr(module, name))}
    functions = {name for name in functions if name.islower()}
    assert {"simulate", "score", "predict"} <= functions
    named = [path for path in (*MODULES, *PACKAGES) if path.stem in functions]
    assert not named


def test_the_rules_of_size_see_what_breaks_them(tmp_path: Path) -> None:
    package = tmp_path / "package"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "small.py").write_text("class Shape: ...\n")
    (package / "user.py").write_text("from package.small import Shape\nclass Box(Shape): ...\n")
    assert lone_importers(package) == {"package.small": "package.user"}
    (package / "other.py").write_text("from package.small import Shape\nclass Box(Shape): ...\n")
    assert lone_importers(package) == {}
    assert public_classes(package)["Box"] == ["other.py", "user.py"]


@pytest.mark.parametrize("name", SCENE_MAY_IMPORT)
def test_module_of_the_scene_imports_only_what_lies_below(name: str) -> None:
    folder = SOURCE / "scene"
    files = sorted((folder / name).rglob("*.py")) if (folder / name).is_dir() else [folder / f"{name}.py"]
    assert files
    order = list(SCENE_MAY_IMPORT)
    assert all(order.index(lower) < order.index(name) for lower in SCENE_MAY_IMPORT[name]), "not downwards"
    for file in files:
        found = {path.split(".")[2] for path in imported_modules(file) if path.startswith("scenetruth.scene.")}
        assert found - {name} <= SCENE_MAY_IMPORT[name], file


def test_every_module_of_the_scene_has_a_rule() -> None:
    folder = SOURCE / "scene"
    names = {path.stem for path in folder.iterdir() if path.name not in ("__init__.py", "__pycache__")}
    assert names == set(SCENE_MAY_IMPORT)


@pytest.mark.parametrize("name", sorted(MAY_IMPORT))
def test_package_imports_only_what_lies_below(name: str) -> None:
    files = sorted((SOURCE / name).rglob("*.py")) if (SOURCE / name).is_dir() else [SOURCE / f"{name}.py"]
    assert files
    for file in files:
        assert imported_packages(file) - {name} <= MAY_IMPORT[name], file


def test_every_package_has_a_rule() -> None:
    names = {path.stem for path in SOURCE.glob("*.py")} | {path.name for path in SOURCE.iterdir() if path.is_dir()}
    assert names - {"__init__", "__main__", "__pycache__", "cli", "templates"} == set(MAY_IMPORT)


def test_the_rule_sees_imports_inside_functions(tmp_path: Path) -> None:
    file = tmp_path / "module.py"
    file.write_text(
        "def f():\n    from scenetruth.truth import geometry_maps\n    import scenetruth.scene.scene_models\n"
    )
    assert imported_packages(file) == {"truth", "scene"}


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


WHOLE_PROJECT = {
    *(
        "accuracy",
        "import_rules",
        "nightly",
        "own_estimator",
        "prose",
        "public",
        "resident_memory",
        "style",
        "wheel",
        "wind_sway",
    ),
}
"""Tests at the top that belong to no module."""
APART = {"browser", "docs", "fuzz", "helpers", "plugins"}
"""Folders of tests that belong to no package."""
TEST_FILES = sorted(path for path in TESTS.rglob("*.py") if path.relative_to(TESTS).parts[0] != "plugins")


def module_under_test(file: Path, tests: Path, source: Path) -> str | None:
    """Return the module or package whose name a file of tests bears, alone or before the aspect that is tested."""
    folder, stem = source / file.parent.relative_to(tests), file.stem.removeprefix("test_")
    names = {path.stem for path in folder.iterdir()} if folder.is_dir() else set()
    return next((name for name in sorted(names, key=len, reverse=True) if f"{stem}_".startswith(f"{name}_")), None)


def test_tests_lie_where_their_modules_do() -> None:
    files = [file for file in TEST_FILES if file.name.startswith("test_")]
    astray = [
        file.relative_to(TESTS).as_posix()
        for file in files
        if file.relative_to(TESTS).parts[0] not in APART
        and not (file.parent == TESTS and file.stem.removeprefix("test_") in WHOLE_PROJECT)
        and module_under_test(file, TESTS, SOURCE) is None
    ]
    assert not astray, "no module of the package has these names"


def test_what_tests_share_lies_in_one_package() -> None:
    others = [
        file.relative_to(TESTS).as_posix()
        for file in TEST_FILES
        if not file.name.startswith("test_") and file.name not in ("__init__.py", "conftest.py")
    ]
    assert [name for name in others if not name.startswith("helpers/")] == []
    importing = [file for file in TEST_FILES if any(".conftest" in name for name in imported_modules(file))]
    assert not importing, "fixtures need no import; what else tests share is in tests/helpers"


def inner_modules(file: Path, source: Path) -> set[str]:
    """Modules of packages within packages that a file imports, or names in a string, as for ``monkeypatch``."""
    texts = facts_of(file).texts
    names = imported_modules(file) | {name for text in texts for name in re.findall(r"scenetruth(?:\.\w+)+", text)}
    found = set()
    for name in names:
        parts = name.split(".")
        for path in (source.parent.joinpath(*parts[:length]) for length in range(4, len(parts) + 1)):
            if parts[0] == "scenetruth" and (path.is_dir() or path.with_suffix(".py").is_file()):
                found.add(".".join(path.relative_to(source.parent).parts))
    return found


def is_of_kernels(file: Path, tests: Path) -> bool:
    """Return whether a file tests kernels, or helps those that do, by its name or that of a folder."""
    return any("kernel" in part for part in file.relative_to(tests).parts)


def test_tests_import_from_packages_but_for_kernels() -> None:
    """Names are imported from what exports them: ``scenetruth.scene.mesh``, and nothing below."""
    found = {
        file.relative_to(TESTS).as_posix(): inner
        for file in TEST_FILES
        if not is_of_kernels(file, TESTS) and (inner := inner_modules(file, SOURCE))
    }
    assert found == {}


def test_the_rules_of_tests_see_what_breaks_them(tmp_path: Path) -> None:
    source, tests = tmp_path / "scenetruth", tmp_path / "tests"
    for folder in (source / "scene" / "mesh", tests / "scene" / "mesh"):
        folder.mkdir(parents=True)
    (source / "scene" / "mesh" / "sheets.py").touch()
    file = tests / "scene" / "mesh" / "test_sheets.py"
    for name, module in (("sheets", "sheets"), ("sheets_area", "sheets"), ("sheet", None), ("solids", None)):
        assert module_under_test(file.with_stem(f"test_{name}"), tests, source) == module
    sheets = "scenetruth.scene.mesh" + ".sheets"
    for text, expected in (
        ("from scenetruth.scene.mesh import MeshModel\n", set()),
        (f"from {sheets} import make_plane\n", {sheets}),
        ("def test():\n    from scenetruth.scene.mesh import sheets\n", {sheets}),
        (f"import {sheets}\n", {sheets}),
        (f"monkeypatch.setattr('{sheets}._PIECE', 1)\n", {sheets}),
        (f"program = 'import sys, {sheets}'\n", {sheets}),
    ):
        file.write_text(text)
        assert inner_modules(file, source) == expected
    assert not is_of_kernels(file, tests)
    assert is_of_kernels(file.with_stem("test_sheet_kernels"), tests)
    assert is_of_kernels(tests / "estimators" / "refined" / "kernels" / "test_warp.py", tests)
    assert module_under_test(tests / "scene" / "test_mesh.py", tests, source) == "mesh"
