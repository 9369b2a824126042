"""Points of a comparison as pieces of work: when their figures are there, and of which scene they are."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenetruth.benchmark.benchmark_tasks import BenchmarkTask, compute_point_key
from scenetruth.benchmark.cases import GalleryCase
from scenetruth.benchmark.design_point import DesignPoint
from scenetruth.scene import load_scene
from tests.helpers.scenes import SCENES


def test_figures_are_of_what_the_files_of_a_scene_hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(SCENES / "finite_elements.yaml", tmp_path)
    shutil.copytree(SCENES / "finite_elements", tmp_path / "finite_elements")

    def scene(case: GalleryCase, value: float) -> Mapping[str, Any]:
        return load_scene(tmp_path / ("finite_elements.yaml" if value == 0 else "gone.yaml")).to_dict()

    monkeypatch.setattr(GalleryCase, "scene", scene)
    job = BenchmarkTask(str(tmp_path), (DesignPoint("gallery", (0.0,), (0,)),), (), ())
    keys = [compute_point_key(job, 0), compute_point_key(job, 0)]
    mesh, array = (tmp_path / "finite_elements" / name for name in ("plate.obj", "displacements.npy"))
    mesh.write_text(mesh.read_text() + "# changed\n")
    keys.append(compute_point_key(job, 0))
    np.save(array, 1.01 * np.load(array))
    keys.append(compute_point_key(job, 0))
    array.unlink()
    keys.append(compute_point_key(job, 0))
    assert keys[0] == keys[1]
    assert len(set(keys)) == 4
