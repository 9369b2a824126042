"""Numbers of workers, results and job folders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from scenetruth.errors import ArgumentError, OutputExistsError, ScenetruthError, StoreError
from scenetruth.jobs.executors import ProcessExecutor, SerialExecutor, create_executor, resolve_workers
from scenetruth.jobs.job_folder import JobFolder
from scenetruth.jobs.results import ResultStore, perform_task


@pytest.mark.parametrize("workers", [0, -2, 1.5, True, None])
def test_other_numbers_of_workers_are_rejected(workers: Any) -> None:
    with pytest.raises(ArgumentError, match="must be 1 or more, or -1"):
        create_executor(workers)
    assert issubclass(ArgumentError, ScenetruthError)


def test_one_worker_starts_no_process() -> None:
    assert isinstance(create_executor(), SerialExecutor)
    assert isinstance(create_executor(2), ProcessExecutor)
    assert resolve_workers(-1) >= 1


def test_errors_of_a_task_are_returned() -> None:
    def fail() -> dict[str, Any]:
        raise ValueError("bad")

    assert perform_task(3, fail, label="point").failure["message"] == "point: ValueError: bad"
    with pytest.raises(ValueError, match="bad"):
        perform_task(3, fail, raised=(ValueError,))


def test_results_of_another_key_or_with_open_failures_are_not_done(tmp_path: Path) -> None:
    store = ResultStore(tmp_path, "run it again")
    store.write("a", "k", {"failures": {"m": "x"}, "settled": []})
    assert not store.is_done("a", "k")
    store.write("a", "k", {"failures": {"m": "x"}, "settled": ["m"]})
    assert store.is_done("a", "k")
    assert not store.is_done("a", "other")
    assert not store.is_done("a", "k", arrays=True)
    store.path("a").write_text("{")
    assert store.find("a", "k") is None
    with pytest.raises(StoreError, match="remove it, and run it again"), store.reading("a"):
        pass


def test_a_folder_is_reused_by_the_same_job_only(tmp_path: Path) -> None:
    folder = JobFolder("job.json", "a job", "points")
    for _ in range(2):
        with folder.open(tmp_path / "new", {"seed": 1}):
            pass
    with (
        pytest.raises(OutputExistsError, match="another seed"),
        folder.open(tmp_path / "new", {"seed": 2}, other="another seed"),
    ):
        pass
    with pytest.raises(ArgumentError, match="output"), folder.open(None, {}, scheduler="tcp://host:1"):
        pass
