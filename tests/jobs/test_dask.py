"""A Dask cluster makes the same bytes, and a worker that is killed costs nothing."""

from __future__ import annotations

import copy
import hashlib
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from scenetruth.dataset.generation import read_status, run_dataset
from scenetruth.dataset.layout import DatasetFolder
from scenetruth.dataset.recipe_loader import Recipe
from scenetruth.errors import MachineError
from scenetruth.jobs.executors import DaskExecutor
from tests.dataset.conftest import RECIPE
from tests.nightly import nightly


def contents(folder: Path) -> list[str]:
    files = sorted(path for path in (folder / "samples").rglob("*") if path.is_file())
    return [hashlib.sha256(path.read_bytes()).hexdigest() for path in files]


@pytest.fixture
def cluster() -> Iterator[Any]:
    distributed = pytest.importorskip("distributed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as found:
            yield found


@nightly
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_makes_the_same_samples_though_a_worker_is_killed(cluster: Any, tmp_path: Path) -> None:
    sampler = Recipe.from_dict({**copy.deepcopy(RECIPE), "samples": 6}).sampler()
    killed: list[int] = []

    def kill(what: str, done: int, total: int) -> None:
        if done == 2 and not killed:
            killed.append(cluster.workers[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    outcome = run_dataset(
        sampler.recipe, output=tmp_path / "cluster", scheduler=cluster.scheduler_address, progress=kill
    )
    assert outcome.made == 6
    assert killed
    run_dataset(sampler.recipe, output=tmp_path / "here", workers=1)
    assert contents(tmp_path / "cluster") == contents(tmp_path / "here")
    assert read_status(tmp_path / "cluster").missing == 0
    assert DatasetFolder(tmp_path / "cluster").catalogue.exists()


@nightly
def test_without_its_scheduler_a_run_ends_and_goes_on_with_another(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    dask, scenetruth = (str(Path(sys.executable).with_name(name)) for name in ("dask", "scenetruth"))
    recipe, folder, known = tmp_path / "recipe.yaml", tmp_path / "cluster", tmp_path / "scheduler.json"
    recipe.write_text(yaml.safe_dump({**copy.deepcopy(RECIPE), "samples": 30}), encoding="utf-8")
    command = [scenetruth, "dataset", "run", str(recipe), "-o", str(folder), "--scheduler", str(known)]
    alone = ["--scheduler-file", str(known)]
    for killed in (True, False):
        known.unlink(missing_ok=True)
        quiet: Any = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        with (
            subprocess.Popen([dask, "scheduler", *alone, "--port", "0", "--dashboard-address", ":0"], **quiet) as head,
            subprocess.Popen([dask, "worker", *alone, "--nworkers", "2", "--nthreads", "1"], **quiet) as hands,
        ):
            try:
                while not known.exists():
                    time.sleep(0.1)
                with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as run:
                    while killed and run.poll() is None and sum(1 for _ in DatasetFolder(folder).done()) < 2:
                        time.sleep(0.05)
                    if killed:
                        head.kill()
                    errors = run.communicate(timeout=200)[1]
            finally:
                head.kill()
                hands.terminate()
        assert run.returncode == (2 if killed else 0), errors
        assert ("the scheduler no longer responds" in " ".join(errors.split())) == killed
    status = read_status(folder)
    assert (status.done, status.failed) == (30, {})
    assert list(folder.rglob(".*")) == []
    run_dataset(Recipe.from_dict({**copy.deepcopy(RECIPE), "samples": 30}), output=tmp_path / "here", workers=1)
    assert contents(folder) == contents(tmp_path / "here")


@pytest.mark.filterwarnings("ignore")
def test_where_no_scheduler_answers_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("scenetruth.jobs.executors._PATIENCE_S", 1)
    with pytest.raises(MachineError, match="the scheduler does not respond"):
        DaskExecutor("tcp://127.0.0.1:9")


@pytest.mark.parametrize("threads", [1, 2])
def test_work_of_a_foreign_process_keeps_to_its_threads(threads: int) -> None:
    code = (
        "import sys\n"
        "from scenetruth.jobs.worker_setup import run_with_threads\n"
        "from scenetruth.compilation import thread_count\n"
        "threads = int(sys.argv[1])\n"
        "found = run_with_threads(threads, thread_count)\n"
        "import numba\n"
        "print(found, run_with_threads(threads, numba.get_num_threads), run_with_threads(1, thread_count))\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(threads)], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(threads), str(threads), "1"]
