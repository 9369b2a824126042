"""Machines that cannot make a data set's samples stop the run, and spoil nothing."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from scenetruth.dataset.fingerprint import begin_dataset
from scenetruth.dataset.generation import read_status, run_dataset
from scenetruth.dataset.layout import DatasetFolder
from scenetruth.dataset.sampler import Sampler
from scenetruth.errors import BackendUnavailableError, MachineError
from scenetruth.jobs.worker_setup import collect_versions, refuse_other_versions
from tests.helpers.no_gl import python_path_without_gl


def changed(folder: DatasetFolder, **changes: Any) -> None:
    found = json.loads(folder.identity.read_text(encoding="utf-8"))
    folder.identity.write_text(json.dumps({**found, **changes}), encoding="utf-8")


@pytest.mark.parametrize("workers", [1, 2])
def test_a_worker_without_gl_is_told_and_no_sample_is_set_aside(
    workers: int, tmp_path: Path, sampler_with: Callable[..., Sampler], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, sampler = DatasetFolder(tmp_path / "new"), sampler_with(samples=2)
    begin_dataset(folder, sampler)
    # As if it had been begun where there is GL.
    changed(folder, backend="pyrender", platform="osmesa")
    missing = BackendUnavailableError("pyrender (osmesa)", "no such library", "install libosmesa6")
    if workers > 1:
        monkeypatch.setenv("PYTHONPATH", python_path_without_gl(tmp_path))
    with (
        patch("scenetruth.render.backend_selection._pyrender", side_effect=missing),
        pytest.raises(MachineError, match=r"workers: .* cannot render this data set.*OSMesa|libosmesa6"),
    ):
        run_dataset(sampler.recipe, output=folder.path, workers=workers)
    assert (read_status(folder.path).done, read_status(folder.path).failed) == (0, {})
    changed(folder, backend="raycast", platform="auto")
    assert run_dataset(sampler.recipe, output=folder.path, workers=1).made == 2


def test_other_versions_make_other_samples(tmp_path: Path, sampler_with: Callable[..., Sampler]) -> None:
    refuse_other_versions(collect_versions())
    with pytest.raises(MachineError, match=r"has numpy .* was begun with 1\.0"):
        refuse_other_versions({**collect_versions(), "numpy": "1.0"})
