"""How fast data sets are made, and what making them costs: the figures of docs/results/scaling.md.

Run it from the top of the repository: ``python -m benchmarks.datasets throughput``, or ``tiny``, ``resume``,
``memory``, ``kills``, ``cluster``, ``sleeping``; all if nothing is named.
Results go to a temporary folder and are removed.

- throughput: 200 noise cubes of 320 x 240 px, 5 x 9 images, with truth, by one and two processes of one thread each;
  the same samples made by `simulate_into` in one process, without engine, statistics, hashes and catalogue.
- tiny: 2,000 samples of 48 x 36 px, time per sample in tenths of the run; then what it takes to find all of them done.
- resume: what it takes to find 10,000 samples done, all of them copies of one.
- memory: largest memory of one worker after every 30 of 300 samples.
- kills: 100 SIGKILLs of workers, of the driver, and of all, at random moments; then bytes against an undisturbed run.
- cluster: the same as throughput's two processes, by a Dask cluster of two.
- sleeping: 10,000 samples that sleep, on a Dask cluster of many threads: what the scheduler takes.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import yaml

from scenetruth.dataset.catalogue import CatalogueWriter
from scenetruth.dataset.fingerprint import begin_dataset
from scenetruth.dataset.generation import read_status, run_dataset
from scenetruth.dataset.layout import DatasetFolder
from scenetruth.dataset.recipe_loader import Recipe
from scenetruth.dataset.sampler import Sampler
from scenetruth.dataset.samples import build_sample_scene, make_sample, try_sample
from scenetruth.jobs.executors import ProcessExecutor
from scenetruth.jobs.results import TaskResult
from scenetruth.jobs.worker_setup import limit_threads
from tests.helpers.small_recipes import RECIPE

SCENES = Path(__file__).parents[1] / "scenes"
CUBES: dict[str, Any] = {
    "name": "cubes",
    "base": str(SCENES / "cube.yaml"),
    "set": {"camera.width": 320, "camera.height": 240, "camera.focal_length_px": 2508},
    "seed": 5,
    "distributions": {
        "objects.0.pose.position_mm.2": {"kind": "uniform", "low": 650, "high": 750},
        "objects.0.pose.rotations.0.angle_deg": {"kind": "uniform", "low": 30, "high": 60},
        "objects.0.texture.rms_contrast": {"kind": "uniform", "low": 0.1, "high": 0.3},
    },
}


def cubes(samples: int) -> Sampler:
    return Recipe.from_dict({**copy.deepcopy(CUBES), "samples": samples}).sampler()


def tiles(samples: int) -> Sampler:
    return Recipe.from_dict({**copy.deepcopy(RECIPE), "samples": samples}).sampler()


def contents(folder: Path) -> dict[str, str]:
    files = sorted(path for path in (folder / "samples").rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


class Clock:
    """Notes when samples are done."""

    def __init__(self) -> None:
        self.at: list[float] = []

    def __call__(self, what: str, done: int, total: int) -> None:
        self.at.append(time.perf_counter())

    def steady_s(self, skip: int) -> float:
        """Seconds per sample, without the first ones, during which processes start."""
        return (self.at[-1] - self.at[skip]) / (len(self.at) - 1 - skip)


def bare(folder: str, number: int) -> TaskResult:
    """Make images and truth of a sample, and nothing else."""
    from scenetruth.dataset.samples import _opened
    from scenetruth.simulation import simulate_into
    from scenetruth.truth import TruthOptions

    sampler, identity = _opened(folder, 0)
    target = Path(folder) / "bare" / str(number)
    target.mkdir(parents=True)
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        simulate_into(target, build_sample_scene(sampler, identity, sampler.draw(number)), TruthOptions())
    shutil.rmtree(target)
    return TaskResult(number, seconds=time.perf_counter() - start)


def throughput(folder: Path, samples: int = 200) -> None:
    sampler = cubes(samples)
    steady: dict[int, float] = {}
    # With one worker, samples are made in this process: by one thread, as in the others.
    limit_threads(1)
    for count in (1, 2):
        clock = Clock()
        run_dataset(sampler.recipe, output=folder / f"by{count}", workers=count, progress=clock)
        steady[count] = clock.steady_s(2 * count)
        print(f"{count} processes: {steady[count]:.3f} s per sample", flush=True)
    print(f"two processes are {steady[1] / steady[2]:.2f} times as fast as one")
    same = contents(folder / "by1") == contents(folder / "by2")
    print(f"bytes are {'the same' if same else 'NOT the same'}")
    # In one process of the same kind, one after the other.
    begin_dataset(DatasetFolder(folder / "bare"), sampler)
    workers = ProcessExecutor(1)
    count = min(samples, 60)
    took = [workers.submit(bare, str(folder / "bare"), number).result().seconds for number in range(count)]
    workers.close()
    alone = sum(took[2:]) / len(took[2:])
    print(f"images and truth alone: {alone:.3f} s per sample; engine and catalogue: {steady[1] / alone - 1:+.1%}")


def cluster(folder: Path, samples: int = 100) -> None:
    from distributed import LocalCluster

    sampler = cubes(samples)
    steady = {}
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as found:
        clock = Clock()
        run_dataset(sampler.recipe, output=folder / "dask", scheduler=found.scheduler_address, progress=clock)
        steady["dask"] = clock.steady_s(6)
    clock = Clock()
    run_dataset(sampler.recipe, output=folder / "pool", workers=2, progress=clock)
    steady["pool"] = clock.steady_s(6)
    print(
        f"Dask {steady['dask']:.3f}, pool {steady['pool']:.3f} s per sample: {steady['dask'] / steady['pool'] - 1:+.1%}"
    )


def tiny(folder: Path, samples: int = 2000) -> None:
    clock = Clock()
    run_dataset(tiles(samples).recipe, output=folder / "tiny", workers=2, progress=clock)
    part = samples // 10
    each = [(clock.at[(n + 1) * part] - clock.at[max(n * part, 5)]) / part for n in range(10)]
    print("s per sample, by tenths of the run:", ", ".join(f"{one:.4f}" for one in each), flush=True)
    start = time.perf_counter()
    outcome = run_dataset(tiles(samples).recipe, output=folder / "tiny", workers=2)
    print(f"to find {outcome.present} samples done: {time.perf_counter() - start:.2f} s")


def resume(folder: Path, samples: int = 10_000) -> None:
    places, sampler = DatasetFolder(folder / "resume"), tiles(samples)
    row = make_sample(sampler, begin_dataset(places, sampler), 0, places.sample(0))
    writer = CatalogueWriter(places, sampler)
    for number in range(samples):
        if number:
            shutil.copytree(places.sample(0), places.sample(number), copy_function=os.link)
        writer.add({**row, "sample": number, "draw": number})
    writer.flush()
    for what in ("the first time, with all rows joined", "again"):
        start = time.perf_counter()
        outcome = run_dataset(sampler.recipe, output=places.path, workers=1)
        print(f"to find {outcome.present} samples done, {what}: {time.perf_counter() - start:.2f} s", flush=True)


def memory(folder: Path, samples: int = 300) -> None:
    begin_dataset(DatasetFolder(folder / "memory"), cubes(samples))
    workers = ProcessExecutor(1)
    for number in range(samples):
        workers.submit(try_sample, str(folder / "memory"), {}, number).result()
        if (number + 1) % 30 == 0:
            (process,) = workers._pool._processes  # type: ignore[union-attr]
            lines = Path(f"/proc/{process}/status").read_text(encoding="utf-8").splitlines()
            now, most = (
                next(line.split()[1] for line in lines if line.startswith(name)) for name in ("VmRSS", "VmHWM")
            )
            print(f"after {number + 1:3d}: {int(now) / 1e3:.0f} MB now, {int(most) / 1e3:.0f} MB at most", flush=True)
    workers.close()


def kills(folder: Path, samples: int = 200, wanted: int = 100) -> None:
    generator = random.Random(1)
    recipe, killed = folder / "recipe.yaml", folder / "killed"
    recipe.write_text(yaml.safe_dump({**copy.deepcopy(RECIPE), "samples": samples}), encoding="utf-8")
    command = [sys.executable, "-m", "scenetruth", "dataset", "run", str(recipe), "-o", str(killed), "--workers", "2"]
    counts = {"worker": 0, "driver": 0, "all": 0}
    while sum(counts.values()) < wanted and sum(1 for _ in DatasetFolder(killed).done()) < samples:
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
        while run.poll() is None and sum(counts.values()) < wanted:
            time.sleep(generator.uniform(1.0, 7.0))
            what = generator.choice(list(counts))
            counts[what] += _kill(run.pid, what)
        run.wait()
    print("killed:", counts, f"; {read_status(killed).done} of {samples} samples were there", flush=True)
    while subprocess.run(command, check=False, capture_output=True).returncode:
        time.sleep(1)
    run_dataset(Recipe.from_dict({**copy.deepcopy(RECIPE), "samples": samples}), output=folder / "calm", workers=2)
    same = contents(killed) == contents(folder / "calm")
    once = pq.read_table(DatasetFolder(killed).catalogue)["sample"].to_pylist() == list(range(samples))
    left = len(list(killed.rglob(".*")))
    print(f"bytes {'the same' if same else 'NOT the same'}; every sample once: {once}; left over: {left}")


def _kill(driver: int, what: str) -> bool:
    """Kill a worker, the driver alone, or all; tell whether there was anything to kill."""
    children = subprocess.run(["pgrep", "-P", str(driver)], capture_output=True, text=True, check=False).stdout.split()
    workers = [int(one) for one in children if "spawn_main" in _command_of(int(one))]
    targets = {"worker": workers[:1], "driver": [driver], "all": [driver, *workers]}[what]
    for target in targets:
        with contextlib.suppress(ProcessLookupError):
            os.kill(target, signal.SIGKILL)
    return bool(targets)


def _command_of(process: int) -> str:
    try:
        return Path(f"/proc/{process}/cmdline").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def sleep(seconds: float, number: int) -> TaskResult:
    time.sleep(seconds)
    return TaskResult(number)


def sleeping(folder: Path, samples: int = 10_000, seconds: float = 0.5, threads: int = 100) -> None:
    from distributed import LocalCluster

    from scenetruth.jobs.executors import DaskExecutor
    from scenetruth.jobs.scheduler import TaskScheduler

    with LocalCluster(n_workers=2, threads_per_worker=threads // 2, dashboard_address=":0") as found:
        crew = DaskExecutor(found.scheduler_address)
        done: list[TaskResult] = []
        start, used = time.perf_counter(), time.process_time()
        TaskScheduler(crew, sleep, (seconds,), done.append, lambda *_: None, print).run(range(samples))
        wall, taken = time.perf_counter() - start, time.process_time() - used
        crew.close()
    ideal = samples * seconds / threads
    print(f"{len(done)} samples of {seconds} s on {threads} threads: {wall:.1f} s, {ideal:.1f} s if nothing cost time")
    print(f"driver and scheduler together: {1e3 * taken / samples:.2f} ms of processor time per sample")


CASES = {case.__name__: case for case in (throughput, tiny, resume, memory, kills, cluster, sleeping)}


def main() -> None:
    """Print what is asked for."""
    for name in sys.argv[1:] or CASES:
        print(f"# {name}", flush=True)
        with tempfile.TemporaryDirectory(prefix="scenetruth-") as folder:
            CASES[name](Path(folder))


if __name__ == "__main__":
    main()
