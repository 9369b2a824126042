"""Simulations with selected sources of uncertainty, and the resulting error maps."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.camera import LinearImage, build_sensor_chain
from scenetruth.design.uncertainty.source import Calibration, all_sources, restrict_sources
from scenetruth.design.uncertainty.sources.calibration import CalibrationSource
from scenetruth.design.uncertainty.sources.imaging import SensorSource
from scenetruth.errors import EstimateError, EstimateWarning, SceneWarning
from scenetruth.estimators import estimate
from scenetruth.jobs.results import ResultStore, TaskResult, compute_key, perform_task, refuse_damaged, write_arrays
from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene
from scenetruth.scoring.error_pairs import read_pair
from scenetruth.scoring.growth_rate import compute_growth_pairs, has_growth_rate
from scenetruth.scoring.quantities import QUANTITIES
from scenetruth.scoring.regions import further_regions, main_regions, visible_throughout
from scenetruth.settings import ScoreSettings
from scenetruth.simulation import simulate

__all__ = [
    "BUDGET_QUANTITIES",
    "GROWTH",
    "BudgetTask",
    "ErrorMaps",
    "SimulationRun",
    "perform_run",
    "read_run",
    "select_optical_sources",
    "simulate_run",
    "suppress_warnings",
]


Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

GROWTH = "growth_rate"
"""Growth rate: estimated by the method if available, otherwise from the windows used for scoring."""
BUDGET_QUANTITIES = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z", GROWTH)
"""Quantities of a budget, keys of `scenetruth.scoring.QUANTITIES`."""


@dataclass(frozen=True, eq=False)
class ErrorMaps:
    """Errors and true values (y, x) by quantity at the reference frame, NaN where invalid, and masks of regions."""

    errors: Mapping[str, Map]
    truths: Mapping[str, Map]
    regions: Mapping[str, Mask]

    @property
    def known(self) -> Mask:
        """Mask of pixels with valid depth and, if present, motion."""
        entries = {name: np.isfinite(values) for name, values in self.errors.items()}
        # Motion maps of a single frame are present, but empty.
        wanted = [name for name in ("depth", "velocity_z") if name in entries and entries[name].any()] or list(entries)[
            :1
        ]
        return np.asarray(np.all([entries[name] for name in wanted], axis=0))


def compute_error_maps(estimate: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings) -> ErrorMaps:
    """Return the errors of an estimate at the reference frame."""
    throughout = visible_throughout(truth)
    found, exact = estimate.sel(t=[0]), truth.sel(t=[0])
    masks = main_regions(exact, settings.interior_margin_px)
    further = further_regions(exact, masks["interior"], settings, throughout=throughout)
    regions = {**masks, **{name: mask for name, mask in further.items() if name.startswith("object_")}}
    errors, truths = {}, {}
    for name in BUDGET_QUANTITIES:
        variable = QUANTITIES[name].variable
        if variable not in found or variable not in exact:
            continue
        pair = read_pair(found, exact, name)
        entries = pair.estimate if pair.full is None else np.where(pair.full, pair.estimate, np.nan)
        errors[name], truths[name] = entries[0] - pair.truth[0], pair.truth[0]
    if GROWTH not in errors and has_growth_rate(found, exact):
        windowed = compute_growth_pairs(found, exact, settings)["growth_rate_windowed"]
        errors[GROWTH], truths[GROWTH] = (windowed.estimate - windowed.truth)[0], windowed.truth[0]
    return ErrorMaps(errors, truths, {name: mask[0] for name, mask in regions.items()})


@dataclass(frozen=True)
class SimulationRun:
    """A simulation: active sources (sorted), seed of the scene, and index of the seed for calibration errors."""

    kinds: tuple[str, ...]
    seed: int
    draw: int


_REMEDY = "compute the budget again"


@dataclass(frozen=True)
class BudgetTask:
    """Inputs of a worker for any run of a budget; the scene with all sources and the settings are JSON texts."""

    folder: str
    plain: str
    method: str
    settings: str
    calibration: Calibration
    runs: tuple[SimulationRun, ...]
    versions: tuple[tuple[str, str], ...]

    @property
    def scene(self) -> Scene:
        """The scene with all sources."""
        return Scene.from_dict(json.loads(self.plain))

    def path(self, run: SimulationRun) -> Path:
        """Return the file of a run, named by a hash of all inputs of the run."""
        key = _key(replace(self, folder="", runs=()), run)
        return ResultStore(Path(self.folder), _REMEDY).arrays_path(key)


@lru_cache(maxsize=4096)
def _key(job: BudgetTask, run: SimulationRun) -> str:
    """Return a hash of all inputs of a run."""
    plain = restrict_sources(job.scene, run.kinds, run.seed).to_dict()
    entries = {key: value for key, value in plain.items() if key not in ("description", "estimate", "storage")}
    wrong = {kind: job.calibration.model_dump() for kind in run.kinds if all_sources()[kind].group == "calibration"}
    parts = [entries, wrong, run.draw if wrong else 0, job.method, json.loads(job.settings), job.versions]
    return compute_key(parts)


def perform_run(job: BudgetTask, number: int) -> TaskResult:
    """Simulate and estimate one run, and return errors instead of raising them."""
    run = job.runs[number]

    def work() -> dict[str, Any]:
        path = job.path(run)
        found = _errors(job, run)
        arrays: dict[str, Any] = {"run": np.array(json.dumps(asdict(run)))}
        for group, maps in (("error", found.errors), ("truth", found.truths)):
            arrays |= {f"{group}.{name}": values.astype(np.float32) for name, values in maps.items()}
        arrays |= {f"region.{name}": mask for name, mask in found.regions.items()}
        write_arrays(path, arrays)
        return {"run": number}

    label = f"{' + '.join(run.kinds) or 'ideal'}, seed {run.seed}"
    return perform_task(number, work, label=label, versions=job.versions)


def simulate_run(job: BudgetTask, run: SimulationRun) -> tuple[xr.Dataset, xr.Dataset]:
    """Return recording, with linear images, and truth of a run, equal to `simulate` for its scene.

    Consecutive runs that differ only in the sensor or the calibration are rendered once.
    """
    scene = restrict_sources(job.scene, run.kinds, run.seed)
    with suppress_warnings():
        linear, truth = _rendered(json.dumps({**scene.to_dict(), "sensor": "ideal"}))
    chain = build_sensor_chain(scene.sensor)
    opened = chain.open((scene.camera.height, scene.camera.width), partial(generator_for, scene.seed, "sensor"))
    radiance = linear["image"].values
    images = np.empty(radiance.shape, dtype=chain.dtype)
    places = [(n, m, int(t), int(s)) for n, t in enumerate(scene.frames.t) for m, s in enumerate(scene.stage.s)]
    previous: LinearImage | None = None
    # In the order of the scan: some sensors depend on the previous image.
    for n, m, t, s in sorted(places, key=lambda at: (at[0], scene.stage.number_in_scan(at[3], at[2]))):
        image = LinearImage(radiance[m, n], 0, s, t)
        images[m, n] = opened.read(image, previous)
        previous = image if chain.remembers else None
    dims = linear["image"].dims
    recording = linear.assign(image=(dims, images, linear["image"].attrs), radiance=(dims, radiance))
    entries = {"full_scale": float(chain.full_scale), "scene": json.dumps(scene.to_dict())}
    recording.attrs = {**{key: value for key, value in linear.attrs.items() if not key.endswith("_hash")}, **entries}
    return recording, truth


def select_optical_sources(kinds: Sequence[str]) -> tuple[str, ...]:
    """Return the sources that affect the rendered images."""
    causes = all_sources()
    return tuple(kind for kind in kinds if not isinstance(causes[kind], SensorSource | CalibrationSource))


def _errors(job: BudgetTask, run: SimulationRun) -> ErrorMaps:
    with suppress_warnings():
        recording, truth = simulate_run(job, run)
        for kind in run.kinds:
            all_sources()[kind].miscalibrate(recording, job.calibration, run.draw)
        try:
            found = estimate(recording.drop_vars("radiance"), job.method, json.loads(job.settings))
        except EstimateError:
            if not run.kinds:
                raise
            # A method that rejects such images has no valid pixels.
            return ErrorMaps({}, {}, {})
        return compute_error_maps(found, truth, job.scene.score)


@lru_cache(maxsize=1)
def _rendered(plain: str) -> tuple[xr.Dataset, xr.Dataset]:
    return simulate(Scene.from_dict(json.loads(plain)))


def read_run(job: BudgetTask, run: SimulationRun) -> ErrorMaps:
    """Return the error maps from the file of a run."""
    path = job.path(run)
    groups: Mapping[str, dict[str, Any]] = {"error": {}, "truth": {}, "region": {}}
    with refuse_damaged(path, _REMEDY), np.load(path) as file:
        for key in file.files:
            group, _, name = key.partition(".")
            if group in groups:
                groups[group][name] = file[key] if group == "region" else file[key].astype(np.float64)
    return ErrorMaps(groups["error"], groups["truth"], groups["region"])


@contextmanager
def suppress_warnings() -> Iterator[None]:
    """Suppress warnings about scenes and estimates."""
    with warnings.catch_warnings():
        for category in (EstimateWarning, SceneWarning, RuntimeWarning):
            warnings.simplefilter("ignore", category)
        yield
