"""A finished run; by day with few pictures."""

from __future__ import annotations

from pathlib import Path

import pytest

from scenetruth.pipeline import run_scene
from tests.helpers.scenes import FIGURES, SMALL_CUBE, cube
from tests.helpers.shared_folders import make_once


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    def make(folder: Path) -> None:
        methods = ("structure_tensor", "opencv_flow")
        results = run_scene(cube(**SMALL_CUBE), output=folder / "one", methods=methods, figures=FIGURES)
        assert not results.failures
        assert set(results.scores) == {"structure_tensor", "opencv_flow"}

    return make_once(tmp_path_factory, "finished_run", make) / "one"
