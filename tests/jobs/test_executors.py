"""Numbers of workers, results and job folders; and a Dask cluster makes the same bytes."""

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
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import yaml

from scenetruth import compilation
from scenetruth.dataset.generation import read_status, run_dataset
from scenetruth.dataset.layout import DatasetFolder
from scenetruth.dataset.recipe_loader import Recipe
from scenetruth.errors import ArgumentError, MachineError, OutputExistsError, ScenetruthError, StoreError
from scenetruth.jobs.executors import DaskExecutor, ProcessExecutor, SerialExecutor, create_executor, resolve_workers
from scenetruth.jobs.job_folder import JobFolder
from scenetruth.jobs.results import ResultStore, perform_task
from tests.helpers.nightly import by_night, nightly
from tests.helpers.small_recipes import RECIPE


@pytest.mark.parametrize("workers", [0, -2, 1.5, True, None])
def test_other_numbers_of_workers_are_rejected(workers: Any) -> None:
    with pytest.raises(ArgumentError, match="must be 1 or more, or -1"):
        create_executor(workers)
    assert issubclass(ArgumentError, ScenetruthError)


def test_one_worker_starts_no_process() -> None:
    assert isinstance(create_executor(), SerialExecutor)
    assert isinstance(create_executor(2), ProcessExecutor)
    assert resolve_workers(-1) >= 1


@nightly
def test_workers_have_the_variables_of_their_parent_and_nothing_else_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(JobFolder, "mark", True, raising=False)
    for number in ("1", "2"):
        monkeypatch.setenv("SCENETRUTH_PROBE", number)
        with closing(ProcessExecutor(2, threads=1)) as workers:
            assert workers.submit(os.getenv, "SCENETRUTH_PROBE").result() == number
            assert workers.submit(os.getenv, "NUMBA_NUM_THREADS").result() == "1"
            assert workers.submit(compilation.thread_count).result() == 1
            assert not workers.submit(hasattr, JobFolder, "mark").result()
    monkeypatch.delenv("SCENETRUTH_PROBE")
    with closing(ProcessExecutor(2)) as workers:
        assert workers.submit(os.getenv, "SCENETRUTH_PROBE").result() is None


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


@nightly
@pytest.mark.filterwarnings("ignore")
def test_where_no_scheduler_answers_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("scenetruth.jobs.executors._PATIENCE_S", 1)
    with pytest.raises(MachineError, match="the scheduler does not respond"):
        DaskExecutor("tcp://127.0.0.1:9")


@nightly
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


@pytest.mark.parametrize("begun", [False, *by_night(True)])
def test_processes_with_limited_threads_can_compile(begun: bool) -> None:
    # Forked with numba imported, and with its threads begun before the limit.
    code = (
        "import sys\n"
        "import numba\n"
        "from scenetruth.compilation import thread_count\n"
        "from scenetruth.jobs.worker_setup import limit_threads\n"
        "if sys.argv[1] == 'True':\n"
        "    numba.get_num_threads()\n"
        "limit_threads(1)\n"
        "numba.config.reload_config()\n"  # what the compiler does first
        "print(thread_count(), numba.config.NUMBA_NUM_THREADS)\n"
    )
    environment = {**os.environ, "NUMBA_NUM_THREADS": "2"}
    done = subprocess.run([sys.executable, "-c", code, str(begun)], capture_output=True, text=True, env=environment)
    assert done.stdout.split() == ["1", "2" if begun else "1"], done.stderr
