"""The scenes of a comparison as pieces of work: each leaves its figures in a file, whole or not at all."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from scenetruth.comparison.case import Case, all_cases
from scenetruth.comparison.contestants import Contestant
from scenetruth.comparison.maps import write_maps
from scenetruth.comparison.point import Measured, Point, measure
from scenetruth.comparison.rows import Row
from scenetruth.dataset.sample import Made
from scenetruth.errors import SceneError, StoreError
from scenetruth.files import input_files
from scenetruth.placing import is_full_disk, write_aside
from scenetruth.plain import parse_json
from scenetruth.provenance import content_hash
from scenetruth.scene import scene_from_plain
from scenetruth.schema import digest

__all__ = ["Job", "key_of", "measure_one", "points_of", "read_measured", "to_try_again"]


@dataclass(frozen=True)
class Job:
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
    points: tuple[Point, ...]
    contestants: tuple[Contestant, ...]
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
        return isinstance(plain, dict) and not to_try_again(plain) and plain.get("key") == key_of(self, number)


def to_try_again(plain: Mapping[str, Any]) -> bool:
    """Tell whether a file of figures holds failures that may be gone when they are tried again."""
    failures, settled = plain.get("failures"), plain.get("settled")
    return bool(set(failures if isinstance(failures, dict) else ()).difference(settled or ()))


def points_of(cases: Sequence[Case], suite: str, values: Sequence[float | str] | None = None) -> list[Point]:
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
        found += [Point(case.kind, group, case.seeds[suite]) for group in groups]
    return found


def key_of(job: Job, number: int) -> str:
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
    files = _files_of(scene)
    if files:
        depends["files"] = files
    return digest(json.loads(json.dumps(depends, default=list)))


def _files_of(scene: Mapping[str, Any]) -> list[str]:
    """Return hashes of what the files hold that a scene names: their paths stay when they change."""
    try:
        return [content_hash(file) for _, file in input_files(scene_from_plain(scene))]
    except SceneError:
        # Whoever makes the scene says what is wrong with it.
        return []


def measure_one(job: Job, number: int) -> Made:
    """Measure a point, for whoever works through many: what goes wrong is returned."""
    start = time.perf_counter()
    point, path = job.points[number], job.path(number)
    try:
        found = measure(all_cases()[point.case], point, job.contestants)
        plain = {
            "key": key_of(job, number),
            "rows": [row.to_plain() for row in found.rows],
            "failures": found.failures,
            "settled": found.settled,
            "slips": {label: told for label, told in found.slips.items() if told},
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        if found.maps is not None:
            write_maps(found.maps, path.with_suffix(".npz"))
        # A point is done when its figures are there.
        with write_aside(path, overwrite=True) as aside:
            aside.write_text(json.dumps(plain, ensure_ascii=False, allow_nan=False), encoding="utf-8")
    except Exception as error:  # whatever it is, the others go on
        message = f"{point.case} at {point.name}: {type(error).__name__}: {error}"
        return Made(number, failure={"message": message}, disk_full=is_full_disk(error))
    return Made(number, {"point": number}, seconds=time.perf_counter() - start)


def read_measured(path: Path) -> Measured:
    """Return what the file of a point holds.

    Raises
    ------
    StoreError
        If it is not there, or damaged.
    """
    try:
        plain = parse_json(path.read_bytes())
        rows = [Row.from_plain(row) for row in plain["rows"]]
        return Measured(rows, dict(plain["failures"]), slips=dict(plain.get("slips", {})))
    except (OSError, ValueError, KeyError, TypeError) as error:
        message = f"is damaged: {error}; remove it, and run the comparison again"
        raise StoreError(path, message) from error
