"""One job is a method on a case of the suite, or on a scene of the gallery; each leaves a file."""

from __future__ import annotations

import datetime
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import xarray as xr

import scenetruth as st
from benchmarks.peers.catalogue import HERE, PEERS, requirements_of, words_of
from benchmarks.results.contestants import PROGRAM, SUBMITTED, Contestant, version_of
from scenetruth import estimators
from scenetruth.benchmark.cases.case import BenchmarkRecord, Case, all_cases
from scenetruth.benchmark.design_point import (
    DesignPoint,
    ignore_scene_warnings,
    list_realisations,
    measure,
)
from scenetruth.estimators import MethodSpec
from scenetruth.estimators.external import ResultsFolder, recording_key, write_recording
from scenetruth.jobs.results import ResultStore, compute_key
from scenetruth.provenance import content_hash, scene_hash
from scenetruth.simulation import simulate

__all__ = [
    "GALLERY_SIZE",
    "ONE_THREAD",
    "Job",
    "estimators_hash",
    "list_jobs",
    "measure_jobs",
    "processor_name",
    "result_key",
    "run_batch",
    "stored_cost",
    "stored_rows",
]

GALLERY_SIZE = ("camera.width=288", "camera.height=192")
"""Scenes of the gallery are the middle of their images."""
TIMEOUT_S = 3600.0
CHUNK_RECORDINGS = 64
"""Recordings that a program measures in one process."""
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OMP_WAIT_POLICY": "PASSIVE",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "QT_QPA_PLATFORM": "offscreen",
}
_REMEDY = "run `make results` again"

Simulated = tuple[xr.Dataset, xr.Dataset]


@dataclass(frozen=True)
class Job:
    """A case with its levels, which every method measures.

    Parameters
    ----------
    name
        Name of its files: the case, or the case and the level.
    case
        The case.
    points
        Its scenes.
    """

    name: str
    case: Case
    points: tuple[DesignPoint, ...]

    def scene(self, point: DesignPoint) -> st.Scene:
        """Return the scene of a point."""
        scene = point.scene()
        return st.load_scene(scene.to_dict(), overrides=GALLERY_SIZE) if self.case.kind == "gallery" else scene

    def simulate(self, point: DesignPoint) -> Simulated:
        """Return the recording without added noise, and the truth."""
        with ignore_scene_warnings():
            recording, truth = simulate(self.scene(point), truth_content=self.case.truth_content)
        return recording, truth


def list_jobs(cases: Sequence[str] | None = None, levels: Sequence[str] | None = None) -> list[Job]:
    """Return the jobs of each method: every case with the levels and the noise realisations of ``full``.

    Parameters
    ----------
    cases
        Keys of cases; all if not given.
    levels
        Levels; those of the suite if not given.
    """
    found = []
    for kind, case in all_cases().items():
        if (cases and kind not in cases) or case.lacks():
            continue
        chosen = tuple(map(case.parse_level, levels)) if levels else case.values("full")
        seeds = tuple(range(case.seeds["full"]))
        groups = [chosen] if case.one_scene else [(level,) for level in chosen]
        points = [DesignPoint(kind, group, seeds) for group in groups]
        if kind == "gallery":
            found += [Job(f"{kind}/{point.name}", case, (point,)) for point in points]
        else:
            found.append(Job(kind, case, tuple(points)))
    return found


def measure_jobs(
    jobs: Sequence[Job], contestants: Sequence[Contestant], folder: Path, peers: Path, *, fresh: bool = False
) -> Iterator[tuple[str, str, float]]:
    """Measure what is missing; yield job, method and processor time in s of each result as it is written.

    Parameters
    ----------
    jobs
        The jobs.
    contestants
        The methods.
    folder
        Folder of the results.
    peers
        Folder of the environments.
    fresh
        Measure all jobs again.
    """
    for chunk in _chunks(jobs):
        simulated: dict[DesignPoint, Simulated] = {}
        for one in contestants:
            store = _store(folder, one)
            missing = [job for job in chunk if fresh or not store.is_done(_file(job), result_key(job, one))]
            if not missing:
                continue
            for job in missing:
                simulated |= {point: job.simulate(point) for point in job.points if point not in simulated}
            with tempfile.TemporaryDirectory(prefix="results-") as work:
                started, spec, ended = _processor_s(), None, {}
                if one.group == PROGRAM:
                    spec, ended = _run_program(missing, one, simulated, peers, Path(work))
                share = (_processor_s() - started) / len(missing)
                for job in missing:
                    started = _processor_s()
                    values = _measured(job, one, spec or one.spec, simulated, ended)
                    seconds = share + _processor_s() - started
                    store.write(_file(job), result_key(job, one), values | {"processor_s": seconds})
                    yield job.name, one.key, seconds


def _chunks(jobs: Sequence[Job]) -> Iterator[list[Job]]:
    """Yield jobs whose recordings programs measure in one process, so that each starts a few times only."""
    for of_gallery in (False, True):
        chunk: list[Job] = []
        for job in (one for one in jobs if (one.case.kind == "gallery") is of_gallery):
            if chunk and sum(_weight(one) for one in (*chunk, job)) > CHUNK_RECORDINGS:
                yield chunk
                chunk = []
            chunk.append(job)
        if chunk:
            yield chunk


def _weight(job: Job) -> int:
    """Return the recordings of a job; one of the gallery, which is larger, counts as eight."""
    if job.case.kind == "gallery":
        return 8
    return sum(len(point.seeds) if job.case.noise_std(point.values[0]) else 1 for point in job.points)


def stored_rows(
    jobs: Sequence[Job], contestant: Contestant, folder: Path
) -> tuple[list[BenchmarkRecord], dict[str, str], list[str], list[dict[str, Any]]]:
    """Return the records of a method, its failures by scene, missing jobs, and what else its files hold.

    Parameters
    ----------
    jobs
        The jobs.
    contestant
        The method.
    folder
        Folder of the results.
    """
    rows: list[BenchmarkRecord] = []
    failures: dict[str, str] = {}
    others = []
    missing: list[str] = []
    for job in jobs:
        values = _store(folder, contestant).find(_file(job), result_key(job, contestant))
        if values is None:
            missing.append(job.name)
            continue
        here = [BenchmarkRecord.from_plain(row) for row in values["rows"]]
        rows += [*here, *job.case.conclusions(here)]
        for name, why in values["failures"].items():
            failures[f"{job.name}/{name}" if len(job.points) > 1 else job.name] = why
        others.append({name: values[name] for name in ("date", "machine", "version", "processor_s")})
    return rows, failures, missing, others


def stored_cost(
    one: Contestant, folder: Path, measured: Callable[[], dict[str, float]], *, fresh: bool = False
) -> dict[str, float]:
    """Return time and memory of a method, measured unless they are there."""
    key = compute_key({"format": 1, "method": _identity(one)})
    store = _store(folder, one)
    found = None if fresh else store.find("cost", key)
    if found is None:
        found = {"cost": measured()}
        if found["cost"]:
            store.write("cost", key, found)
    return dict(found["cost"])


def _measured(
    job: Job,
    one: Contestant,
    spec: MethodSpec,
    simulated: Mapping[DesignPoint, Simulated],
    ended: Mapping[DesignPoint, str],
) -> dict[str, Any]:
    rows: list[BenchmarkRecord] = []
    failures: dict[str, str] = {}
    settled: list[str] = []
    for point in job.points:
        # Arithmetic on pixels without a result is not an error here.
        with ignore_scene_warnings():
            measured = measure(job.case, point, [spec], simulated=simulated[point])
        rows += measured.rows
        if measured.failures:
            failures[point.name] = ended.get(point) or next(iter(measured.failures.values()))
            # A program that ended without a valid map will do so again; one that did not start may start next time.
            if one.group != PROGRAM or point in ended:
                settled.append(point.name)
    return {
        "rows": [row.to_dict() for row in rows],
        "failures": failures,
        "settled": settled,
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "machine": processor_name(),
        "version": version_of(one),
    }


def _run_program(
    jobs: Sequence[Job], one: Contestant, simulated: Mapping[DesignPoint, Simulated], peers: Path, work: Path
) -> tuple[MethodSpec, dict[DesignPoint, str]]:
    """Run a program on all recordings of jobs, in one process.

    Returns its results as a method, and for each scene on all of whose recordings it ended, its error if there is one.
    """
    pairs: list[list[str]] = []
    places: dict[DesignPoint, list[Path]] = {}
    for job in jobs:
        for point in job.points:
            for _, recording in list_realisations(job.case, point, simulated[point][0]):
                key = recording_key(recording)
                source, output = work / "recordings" / key, work / "results" / key
                if not source.exists():
                    source.parent.mkdir(exist_ok=True)
                    write_recording(recording, source, "npy")
                    output.mkdir(parents=True)
                    pairs.append([str(source), str(output)])
                places.setdefault(point, []).append(output)
    run_batch(words_of(peers, one.key), pairs, work)
    ended = {}
    for point, outputs in places.items():
        errors = [file for output in outputs if (file := output / "further" / "error.txt").exists()]
        if all(any(output.rglob("*.npy")) for output in outputs if output / "further" / "error.txt" not in errors):
            ended[point] = errors[0].read_text(encoding="utf-8").strip().splitlines()[-1] if errors else ""
    return MethodSpec(ResultsFolder(work / "results", one.key), label=one.key), ended


def run_batch(words: Sequence[str], pairs: Sequence[Sequence[str]], work: Path) -> None:
    """Run a program on pairs of a recording and an output."""
    batch = work / "batch.json"
    batch.write_text(json.dumps(pairs), encoding="utf-8")
    ended = subprocess.run(
        [*words, "--batch", str(batch)],
        cwd=work,
        env={**os.environ, **ONE_THREAD},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    if ended.returncode:
        # What it has written counts; the other recordings have no result.
        print(f"{words[1]}: exit code {ended.returncode}: {ended.stderr[-300:]}", file=sys.stderr, flush=True)


def _store(folder: Path, one: Contestant) -> ResultStore:
    return ResultStore(folder / "jobs" / one.key, _REMEDY)


def _file(job: Job) -> str:
    return job.name.replace("/", "_")


def result_key(job: Job, one: Contestant) -> str:
    """Return the digest of all on which the results of a method on a job depend."""
    return compute_key({"format": 1, "case": job.case.kind, "scenes": _scenes(job), "method": _identity(one)})


@cache
def _scenes(job: Job) -> list[tuple[Any, ...]]:
    """Return all scenes of a job as plain values; files count by their content, wherever they are."""
    scenes = [(point, job.scene(point)) for point in job.points]
    return [
        (point.values, point.seeds, scene_hash(scene), scene.to_dict()["score"], job.case.noise_std(point.values[0]))
        for point, scene in scenes
    ]


def _identity(one: Contestant) -> Any:
    """Return all on which the results of a method depend."""
    if one.group != PROGRAM:
        return [one.spec.identity, version_of(one), *([] if one.group == SUBMITTED else [estimators_hash()])]
    programs = HERE / "programs"
    code = [programs / "folder.py", programs / f"{PEERS[one.key].program}.py"]
    requirements = requirements_of(PEERS[one.key].environment)[1]
    return [requirements, [content_hash(file) for file in code], PEERS[one.key].options]


@cache
def estimators_hash() -> str:
    """Return a hash of the code of the built-in methods, whose results are of this code only."""
    folder = Path(estimators.__path__[0])
    files = sorted(folder.rglob("*.py"))
    return compute_key([(file.relative_to(folder).as_posix(), content_hash(file)) for file in files])


def processor_name() -> str:
    """Return the model of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def _processor_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
