"""A finished run; by day with few pictures."""

from __future__ import annotations

from pathlib import Path

import pytest

from scenetruth.pipeline import run_scene
from tests.helpers.scenes import FIGURES, SMALL_CUBE, cube


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "one"
    methods = ("structure_tensor", "opencv_flow")
    results = run_scene(cube(**SMALL_CUBE), output=folder, methods=methods, figures=FIGURES)
    assert not results.failures
    assert set(results.scores) == {"structure_tensor", "opencv_flow"}
    return folder
