"""The simulations of a sweep as pieces of work: each leaves its figures in a file, whole or not at all."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenetruth.comparison.contestants import Contestant
from scenetruth.comparison.jobs import to_try_again
from scenetruth.dataset.sample import Made
from scenetruth.design.sweep.factors import label_of
from scenetruth.design.sweep.kept import write_kept
from scenetruth.design.sweep.measure import Measured, contestants_of_scene, measure
from scenetruth.design.sweep.plan import Plan
from scenetruth.errors import StoreError
from scenetruth.placing import is_full_disk, write_aside
from scenetruth.plain import parse_json
from scenetruth.provenance import scene_hash
from scenetruth.resources import Limits
from scenetruth.schema import digest

__all__ = ["Job", "measure_one", "read_measured"]

_FORMAT = 2
"""Counts up when figures of the same simulation change."""


@dataclass(frozen=True)
class Job:
    """All that a worker needs to make any simulation of a sweep.

    Parameters
    ----------
    folder
        Where the files of simulations go.
    plan
        The simulations.
    contestants
        The methods; the scenes' own if there are none.
    versions
        What figures depend on besides.
    limits
        Bounds of what scenes may ask for.
    """

    folder: str
    plan: Plan
    contestants: tuple[Contestant, ...]
    versions: tuple[tuple[str, str], ...]
    limits: Limits | None = None

    @property
    def keeps(self) -> bool:
        """Whether errors are kept, for the scatter between seeds."""
        return self.plan.each > 1

    def key(self, number: int) -> str:
        """Return a hash of all that the figures of a simulation depend on; its file goes by it."""
        scene = self.plan.scene(number)
        methods = self.contestants or tuple(contestants_of_scene(scene))
        depends: dict[str, Any] = {
            "format": _FORMAT,
            "scene": scene_hash(scene),
            "score": scene.score.model_dump(mode="json"),
            "methods": [(one.label, one.identity) for one in methods],
            "bounded": self.plan.is_first(number),
            "versions": self.versions,
        }
        return digest(json.loads(json.dumps(depends, default=list)))

    def path(self, key: str) -> Path:
        """Return the file of a simulation by its key."""
        return Path(self.folder) / f"{key}.json"

    def is_done(self, key: str) -> bool:
        """Return whether the figures of a simulation are there, with no failure to try again."""
        path = self.path(key)
        try:
            plain = parse_json(path.read_bytes())
        except (OSError, ValueError):
            return False
        whole = isinstance(plain, dict) and plain.get("key") == key and not to_try_again(plain)
        return whole and (not self.keeps or path.with_suffix(".npz").exists())

    def told(self, number: int) -> str:
        """Return which simulation it is, in words."""
        point, seed = self.plan.at(number)
        values = ", ".join(f"{path} = {label_of(value)}" for path, value in self.plan.values(point).items())
        scene = f"{self.plan.labels[point.scene]}, " if len(self.plan.labels) > 1 else ""
        return f"{scene}{values}, seed {seed}"


def measure_one(job: Job, number: int) -> Made:
    """Make a simulation and measure it, for whoever works through many: what goes wrong is returned."""
    start = time.perf_counter()
    try:
        key = job.key(number)
        path = job.path(key)
        found = measure(
            job.plan.scene(number),
            job.contestants,
            bounded=job.plan.is_first(number),
            keeps=job.keeps,
            limits=job.limits,
        )
        path.parent.mkdir(parents=True, exist_ok=True)
        if found.kept is not None:
            write_kept(found.kept, path.with_suffix(".npz"))
        # A simulation is done when its figures are there.
        with write_aside(path, overwrite=True) as aside:
            aside.write_text(
                json.dumps({"key": key, **_plain(found)}, ensure_ascii=False, allow_nan=False), encoding="utf-8"
            )
    except Exception as error:  # whatever it is, the others go on
        message = f"{job.told(number)}: {type(error).__name__}: {error}"
        return Made(number, failure={"message": message}, disk_full=is_full_disk(error))
    return Made(number, {"simulation": number}, seconds=time.perf_counter() - start)


def _plain(found: Measured) -> dict[str, Any]:
    names = ("figures", "bounds", "failures", "notes", "settled", "grows")
    return {name: getattr(found, name) for name in names}


def read_measured(path: Path) -> Measured:
    """Return what the file of a simulation holds, without the errors that are kept beside it.

    Raises
    ------
    StoreError
        If it is not there, or damaged.
    """
    try:
        plain = parse_json(path.read_bytes())
        return Measured(
            dict(plain["figures"]),
            dict(plain["bounds"]),
            dict(plain["failures"]),
            list(plain["notes"]),
            list(plain.get("settled", ())),
            bool(plain["grows"]),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StoreError(path, f"is damaged: {error}; remove it, and run the sweep again") from error
