"""What the shell completes is what there is."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from scenetruth.cli.bundled_files import SCENES, file_completer, method_names
from scenetruth.estimators import list_methods


def test_methods_are_those_that_are_installed() -> None:
    assert method_names("") == sorted(entry.name for entry in list_methods())
    assert method_names("opencv_s") == ["opencv_scene_flow", "opencv_stereo"]
    assert method_names("nothing") == []


def test_shipped_names_and_files_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "inner").mkdir()
    for name in ("cutter.yaml", "cut.txt", "inner/cup.yml"):
        (tmp_path / name).touch()
    complete = file_completer(SCENES)
    assert complete("cu") == ["cube", "cube_spotlight", "cutter.yaml"]
    assert complete("inner/c") == ["inner/cup.yml"]
    assert complete("no/c") == []
    assert set(complete("")) == {*SCENES.files(), "cutter.yaml"}


def test_the_shell_is_told() -> None:
    # What the script of bash that `--show-completion` prints sets before it asks.
    asked = {"_SCENETRUTH_COMPLETE": "complete_bash", "COMP_WORDS": "scenetruth check seed", "COMP_CWORD": "2"}
    code = "import sys; sys.argv[0] = 'scenetruth'; from scenetruth.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **asked}, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == ["seedling"], done.stderr
