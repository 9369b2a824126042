"""Benchmark tasks for workers, and their results on disk."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from scenetruth.benchmark.cases.case import BenchmarkRecord, Case, all_cases
from scenetruth.benchmark.design_point import (
    DesignPoint,
    PointResult,
    hash_called_code,
    measure,
    write_error_maps,
)
from scenetruth.errors import SceneError
from scenetruth.estimators.method_specs import MethodSpec
from scenetruth.estimators.process_files import have_changed
from scenetruth.input_files import collect_input_files
from scenetruth.jobs.results import ResultStore, TaskResult, compute_key, perform_task
from scenetruth.provenance import content_hash
from scenetruth.resources import Limits
from scenetruth.scene import Scene

__all__ = [
    "BenchmarkTask",
    "compute_point_key",
    "list_design_points",
    "measure_point",
    "read_point_result",
]


_REMEDY = "run the comparison again"


@dataclass(frozen=True)
class BenchmarkTask:
    """Inputs of a worker: result directory, design points, methods, versions, limits, and start time in s."""

    folder: str
    points: tuple[DesignPoint, ...]
    contestants: tuple[MethodSpec, ...]
    versions: tuple[tuple[str, str], ...]
    limits: Limits | None = None
    started: float = field(default_factory=time.time)

    @property
    def store(self) -> ResultStore:
        """The store of the results."""
        return ResultStore(Path(self.folder), _REMEDY)

    def name(self, number: int) -> str:
        """Return the name of a result."""
        point = self.points[number]
        return f"{point.case}/{point.name}"

    def path(self, number: int) -> Path:
        """Return the file of a result."""
        return self.store.path(self.name(number))

    def is_done(self, number: int) -> bool:
        """Return whether a matching result exists and contains no failure that should be retried."""
        name = self.name(number)
        key = compute_point_key(self, number)
        if not (self.store.path(name).exists() and self.store.is_done(name, key)):
            return False
        return not have_changed((self.store.find(name, key) or {}).get("called", {}))


def list_design_points(
    cases: Sequence[Case],
    suite: str,
    values: Sequence[float | str] | None = None,
    seeds: Sequence[int] | None = None,
) -> list[DesignPoint]:
    """Return the design points of cases."""
    found = []
    for case in cases:
        chosen = tuple(case.parse_level(value) for value in (case.values(suite) if values is None else values))
        groups = [chosen] if case.one_scene else [(value,) for value in chosen]
        chosen_seeds = tuple(range(case.seeds[suite]) if seeds is None else seeds)
        found += [DesignPoint(case.kind, group, chosen_seeds) for group in groups]
    return found


def compute_point_key(job: BenchmarkTask, number: int) -> str:
    """Return a hash of all inputs of a result."""
    point = job.points[number]
    case = all_cases()[point.case]
    scene = case.scene(point.values[0])
    depends: dict[str, Any] = {
        "format": 2,
        "point": asdict(point),
        "scene": scene,
        "noise_std": case.noise_std(point.values[0]),
        "methods": [(one.label, one.identity) for one in job.contestants],
        "versions": job.versions,
    }
    files = _hash_files(scene)
    if files:
        depends["files"] = files
    return compute_key(depends)


def _hash_files(scene: Mapping[str, Any]) -> list[str]:
    """Return the hashes of the files that a scene refers to; their contents may change under the same path."""
    try:
        return [content_hash(file) for _, file in collect_input_files(Scene.from_dict(scene))]
    except SceneError:
        # The error is reported when the scene is simulated.
        return []


def measure_point(job: BenchmarkTask, number: int) -> TaskResult:
    """Process a design point in a worker; errors are returned."""
    point = job.points[number]

    def work() -> dict[str, Any]:
        found = measure(all_cases()[point.case], point, job.contestants, job.limits)
        plain = {
            "rows": [row.to_dict() for row in found.rows],
            "failures": found.failures,
            "settled": found.settled,
            "called": hash_called_code(job.contestants, job.started),
            "convention_mismatches": {
                label: entries for label, entries in found.convention_mismatches.items() if entries
            },
        }
        name = job.name(number)
        if found.maps is not None:
            write_error_maps(found.maps, job.store.arrays_path(name))
        job.store.write(name, compute_point_key(job, number), plain)
        return {"point": number}

    return perform_task(number, work, label=f"{point.case} at {point.name}", versions=job.versions)


def read_point_result(path: Path) -> PointResult:
    """Return the result in a file."""
    with ResultStore(path.parent, _REMEDY).reading(path.stem) as plain:
        rows = [BenchmarkRecord.from_plain(row) for row in plain["rows"]]
        return PointResult(
            rows, dict(plain["failures"]), convention_mismatches=dict(plain.get("convention_mismatches", {}))
        )
