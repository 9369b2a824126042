"""Tasks of a benchmark for workers, and their results on disk."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from scenetruth.benchmark.cases.case import BenchmarkRecord, Case, all_cases
from scenetruth.benchmark.design_point import DesignPoint, PointResult, measure, write_error_maps
from scenetruth.dataset.samples import SampleResult
from scenetruth.errors import SceneError, StoreError
from scenetruth.estimators.method_specs import MethodSpec
from scenetruth.input_files import collect_input_files
from scenetruth.output import is_full_disk, write_atomically
from scenetruth.plain_data import parse_json
from scenetruth.provenance import content_hash
from scenetruth.scene import Scene
from scenetruth.schema import digest

__all__ = [
    "BenchmarkTask",
    "compute_point_key",
    "has_retryable_failures",
    "list_design_points",
    "measure_point",
    "read_point_result",
]


@dataclass(frozen=True)
class BenchmarkTask:
    """All that a worker needs to measure any point of a comparison.

    Parameters
    ----------
    folder
        Where the files of points go.
    points
        The points.
    contestants
        The methods.
    versions
        What figures depend on besides.
    """

    folder: str
    points: tuple[DesignPoint, ...]
    contestants: tuple[MethodSpec, ...]
    versions: tuple[tuple[str, str], ...]

    def path(self, number: int) -> Path:
        """Return the file of a point."""
        point = self.points[number]
        return Path(self.folder) / point.case / f"{point.name}.json"

    def is_done(self, number: int) -> bool:
        """Return whether the file of a point is there, is of this very point, and tells of no failure to try again."""
        try:
            plain = parse_json(self.path(number).read_bytes())
        except (OSError, ValueError):
            return False
        return (
            isinstance(plain, dict)
            and not has_retryable_failures(plain)
            and plain.get("key") == compute_point_key(self, number)
        )


def has_retryable_failures(plain: Mapping[str, Any]) -> bool:
    """Tell whether a file of figures holds failures that may be gone when they are tried again."""
    failures, settled = plain.get("failures"), plain.get("settled")
    return bool(set(failures if isinstance(failures, dict) else ()).difference(settled or ()))


def list_design_points(
    cases: Sequence[Case], suite: str, values: Sequence[float | str] | None = None
) -> list[DesignPoint]:
    """Return the scenes of cases.

    Parameters
    ----------
    cases
        The cases.
    suite
        ``core`` or ``full``.
    values
        Only these of what is varied, or their labels; those of the suite if not given.
    """
    found = []
    for case in cases:
        chosen = tuple(case.value_of(value) for value in (case.values(suite) if values is None else values))
        groups = [chosen] if case.one_scene else [(value,) for value in chosen]
        found += [DesignPoint(case.kind, group, case.seeds[suite]) for group in groups]
    return found


def compute_point_key(job: BenchmarkTask, number: int) -> str:
    """Return a hash of all that the figures of a point depend on."""
    point = job.points[number]
    case = all_cases()[point.case]
    scene = case.scene(point.values[0])
    depends: dict[str, Any] = {
        "point": asdict(point),
        "scene": scene,
        "noise_std": case.noise_std(point.values[0]),
        "methods": [(one.label, one.identity) for one in job.contestants],
        "versions": job.versions,
    }
    files = _hash_files(scene)
    if files:
        depends["files"] = files
    return digest(json.loads(json.dumps(depends, default=list)))


def _hash_files(scene: Mapping[str, Any]) -> list[str]:
    """Return hashes of what the files hold that a scene names: their paths stay when they change."""
    try:
        return [content_hash(file) for _, file in collect_input_files(Scene.from_dict(scene))]
    except SceneError:
        # Whoever makes the scene says what is wrong with it.
        return []


def measure_point(job: BenchmarkTask, number: int) -> SampleResult:
    """Measure a point, for whoever works through many: what goes wrong is returned."""
    start = time.perf_counter()
    point, path = job.points[number], job.path(number)
    try:
        found = measure(all_cases()[point.case], point, job.contestants)
        plain = {
            "key": compute_point_key(job, number),
            "rows": [row.to_dict() for row in found.rows],
            "failures": found.failures,
            "settled": found.settled,
            "slips": {label: told for label, told in found.slips.items() if told},
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        if found.maps is not None:
            write_error_maps(found.maps, path.with_suffix(".npz"))
        # A point is done when its figures are there.
        with write_atomically(path, overwrite=True) as aside:
            aside.write_text(json.dumps(plain, ensure_ascii=False, allow_nan=False), encoding="utf-8")
    except Exception as error:  # whatever it is, the others go on
        message = f"{point.case} at {point.name}: {type(error).__name__}: {error}"
        return SampleResult(number, failure={"message": message}, disk_full=is_full_disk(error))
    return SampleResult(number, {"point": number}, seconds=time.perf_counter() - start)


def read_point_result(path: Path) -> PointResult:
    """Return what the file of a point holds.

    Raises
    ------
    StoreError
        If it is not there, or damaged.
    """
    try:
        plain = parse_json(path.read_bytes())
        rows = [BenchmarkRecord.from_plain(row) for row in plain["rows"]]
        return PointResult(rows, dict(plain["failures"]), slips=dict(plain.get("slips", {})))
    except (OSError, ValueError, KeyError, TypeError) as error:
        message = f"is damaged: {error}; remove it, and run the comparison again"
        raise StoreError(path, message) from error
