"""The package that is built brings the scenes along, with every file that they refer to."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

from scenetruth.input_files import collect_input_files
from scenetruth.scene import load_scene
from tests.helpers.scenes import LIBRARY, SCENES

ROOT = SCENES.parent


@pytest.fixture
def build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """What copies files into a package, as it is called when a wheel is built."""
    setuptools = pytest.importorskip("setuptools")
    # Where there is no pyproject.toml, nothing else takes part in the build.
    monkeypatch.chdir(tmp_path)
    made = runpy.run_path(str(ROOT / "setup.py"))["BuildWithCopies"](setuptools.Distribution({"packages": []}))
    monkeypatch.chdir(ROOT)
    made.build_lib, made.editable_mode = str(tmp_path), False
    # The build has plotly, an installation has not.
    script = tmp_path / "script.js"
    script.write_text("plotly")
    monkeypatch.setattr(made, "_script", lambda: script)
    licence = tmp_path / "licence"
    licence.write_text("MIT")
    monkeypatch.setattr(made, "_licence", lambda: licence)
    made.finalize_options()
    return made


def test_scenes_are_copied_with_their_files(build: Any, tmp_path: Path) -> None:
    build.run()
    shipped = tmp_path / "scenetruth" / "shipped"
    for scene in LIBRARY:
        assert (shipped / scene.name).read_bytes() == scene.read_bytes()
    copy = load_scene(shipped / "finite_elements.yaml")
    files = [path for _, path in collect_input_files(copy)]
    assert len(files) == 2
    assert all(path.is_file() and path.is_relative_to(shipped) for path in files)
    assert {"cubes.yaml", "leaves.yaml"} <= {path.name for path in (shipped / "datasets").iterdir()}
    assert (shipped / "designs" / "cube_depth.yaml").is_file()
    assert (tmp_path / "scenetruth" / "templates" / "plotly.min.js").read_text() == "plotly"
    assert (tmp_path / "scenetruth" / "templates" / "plotly.LICENSE.txt").read_text() == "MIT"
    assert not list(shipped.rglob("__pycache__"))
    # Pages define their terms by the glossary.
    glossary = ROOT / "docs" / "reference" / "glossary.md"
    assert (shipped / "glossary.md").read_bytes() == glossary.read_bytes()
    assert "docs/reference/glossary.md" in build.get_source_files()
    assert str(shipped / "cube.yaml") in build.get_outputs()
    # These go into a source distribution, from which a wheel is made elsewhere.
    assert {path.relative_to(ROOT).as_posix() for path in LIBRARY} <= set(build.get_source_files())


def test_editable_installations_read_them_where_they_are(
    build: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build.editable_mode = True
    monkeypatch.chdir(tmp_path)
    build.run()
    assert not (tmp_path / "scenetruth").exists()
    # Templates of pages expect the script of plotly with them.
    assert (tmp_path / "src" / "scenetruth" / "templates" / "plotly.min.js").read_text() == "plotly"
