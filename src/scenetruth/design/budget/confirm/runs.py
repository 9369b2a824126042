"""Simulations with some causes on, as pieces of work: each leaves its errors in a file, whole or not at all."""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.camera import LinearImage, chain_of
from scenetruth.dataset.sample import Made
from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.calibration_cause import CalibrationCause
from scenetruth.design.budget.cause import all_causes
from scenetruth.design.budget.confirm.errors import ErrorMaps, error_maps
from scenetruth.design.budget.sensor_cause import SensorCause
from scenetruth.design.budget.switches import scene_with
from scenetruth.errors import EstimateError, EstimateWarning, SceneWarning, StoreError
from scenetruth.estimators import estimate
from scenetruth.placing import is_full_disk, write_aside
from scenetruth.randomness import generator_for
from scenetruth.scene import Scene, scene_from_plain
from scenetruth.schema import digest
from scenetruth.simulation import simulate

__all__ = ["Job", "Run", "observed", "perform", "quiet", "read_run", "without_sensor"]


@dataclass(frozen=True)
class Run:
    """A simulation.

    Parameters
    ----------
    kinds
        The causes that are on, in order.
    seed
        Seed of the scene.
    draw
        Which draw it is, from 0 on: what the calibration is off by.
    """

    kinds: tuple[str, ...]
    seed: int
    draw: int


@dataclass(frozen=True)
class Job:
    """All that a worker needs for any run of a budget.

    Parameters
    ----------
    folder
        Where files of runs go.
    plain
        The scene with all its causes, as JSON.
    method, settings
        How depth and motion are estimated; settings as JSON.
    calibration
        How well the calibration is known.
    runs
        The runs.
    versions
        What figures depend on besides.
    """

    folder: str
    plain: str
    method: str
    settings: str
    calibration: Calibration
    runs: tuple[Run, ...]
    versions: tuple[tuple[str, str], ...]

    @property
    def scene(self) -> Scene:
        """The scene with all its causes."""
        return scene_from_plain(json.loads(self.plain))

    def path(self, run: Run) -> Path:
        """Return the file of a run, which is called by a hash of all that the run depends on."""
        return Path(self.folder) / f"{_key(replace(self, folder='', runs=()), run)}.npz"


@lru_cache(maxsize=4096)
def _key(job: Job, run: Run) -> str:
    """Return a hash of all that a run of a job depends on."""
    plain = scene_with(job.scene, run.kinds, run.seed).to_plain()
    told = {key: value for key, value in plain.items() if key not in ("description", "estimate", "storage")}
    wrong = {kind: job.calibration.model_dump() for kind in run.kinds if all_causes()[kind].group == "calibration"}
    parts = [told, wrong, run.draw if wrong else 0, job.method, json.loads(job.settings), job.versions]
    return digest(json.loads(json.dumps(parts)))


def perform(job: Job, number: int) -> Made:
    """Simulate and estimate one run, for whoever works through many: what goes wrong is returned."""
    start, run = time.perf_counter(), job.runs[number]
    try:
        path = job.path(run)
        found = _errors(job, run)
        arrays: dict[str, Any] = {"told": np.array(json.dumps(asdict(run)))}
        for group, maps in (("error", found.errors), ("truth", found.truths)):
            arrays |= {f"{group}.{name}": values.astype(np.float32) for name, values in maps.items()}
        arrays |= {f"region.{name}": mask for name, mask in found.regions.items()}
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_aside(path, overwrite=True) as aside, aside.open("wb") as file:
            np.savez_compressed(file, **arrays)
    except Exception as error:  # whatever it is, the others go on
        message = f"{' + '.join(run.kinds) or 'ideal'}, seed {run.seed}: {type(error).__name__}: {error}"
        return Made(number, failure={"message": message}, disk_full=is_full_disk(error))
    return Made(number, {"run": number}, seconds=time.perf_counter() - start)


def observed(job: Job, run: Run) -> tuple[xr.Dataset, xr.Dataset]:
    """Return recording, with its linear images, and truth of a run: what `simulate` makes of its scene.

    Runs that differ in the sensor or the calibration alone, one after the other, are rendered once.
    """
    scene = scene_with(job.scene, run.kinds, run.seed)
    with quiet():
        linear, truth = _rendered(json.dumps({**scene.to_plain(), "sensor": "ideal"}))
    chain = chain_of(scene.sensor)
    opened = chain.open((scene.camera.height, scene.camera.width), partial(generator_for, scene.seed, "sensor"))
    radiance = linear["image"].values
    images = np.empty(radiance.shape, dtype=chain.dtype)
    places = [(n, m, int(t), int(s)) for n, t in enumerate(scene.frames.t) for m, s in enumerate(scene.stage.s)]
    previous: LinearImage | None = None
    # In the order of the scan: some sensors need the image before.
    for n, m, t, s in sorted(places, key=lambda at: (at[0], scene.stage.number_in_scan(at[3], at[2]))):
        image = LinearImage(radiance[m, n], 0, s, t)
        images[m, n] = opened.read(image, previous)
        previous = image if chain.remembers else None
    dims = linear["image"].dims
    recording = linear.assign(image=(dims, images, linear["image"].attrs), ideal=(dims, radiance))
    told = {"full_scale": float(chain.full_scale), "scene": json.dumps(scene.to_plain())}
    recording.attrs = {**{key: value for key, value in linear.attrs.items() if not key.endswith("_hash")}, **told}
    return recording, truth


def without_sensor(kinds: Sequence[str]) -> tuple[str, ...]:
    """Return those of some causes that what a camera sees depends on."""
    causes = all_causes()
    return tuple(kind for kind in kinds if not isinstance(causes[kind], SensorCause | CalibrationCause))


def _errors(job: Job, run: Run) -> ErrorMaps:
    with quiet():
        recording, truth = observed(job, run)
        for kind in run.kinds:
            all_causes()[kind].miscalibrate(recording, job.calibration, run.draw)
        try:
            found = estimate(recording.drop_vars("ideal"), job.method, json.loads(job.settings))
        except EstimateError:
            if not run.kinds:
                raise
            # A method that tells nothing of such images tells nothing.
            return ErrorMaps({}, {}, {})
        return error_maps(found, truth, job.scene.score)


@lru_cache(maxsize=1)
def _rendered(plain: str) -> tuple[xr.Dataset, xr.Dataset]:
    return simulate(scene_from_plain(json.loads(plain)))


def read_run(job: Job, run: Run) -> ErrorMaps:
    """Return what the file of a run holds.

    Raises
    ------
    StoreError
        If it is not there, or damaged.
    """
    path = job.path(run)
    try:
        with np.load(path) as file:
            groups: Mapping[str, dict[str, Any]] = {"error": {}, "truth": {}, "region": {}}
            for key in file.files:
                group, _, name = key.partition(".")
                if group in groups:
                    groups[group][name] = file[key] if group == "region" else file[key].astype(np.float64)
    except (OSError, ValueError, KeyError) as error:
        message = f"is damaged: {error}; remove it, and make the budget again"
        raise StoreError(path, message) from error
    return ErrorMaps(groups["error"], groups["truth"], groups["region"])


@contextmanager
def quiet() -> Iterator[None]:
    """Leave out what scenes are warned of: whoever asks for a budget is told by it."""
    with warnings.catch_warnings():
        for category in (EstimateWarning, SceneWarning, RuntimeWarning):
            warnings.simplefilter("ignore", category)
        yield
