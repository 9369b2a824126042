"""One design point: simulation of its scene, estimation by all methods, and errors, time and memory."""

from __future__ import annotations

import math
import os
import threading
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.benchmark.cases.case import BOUND, METHOD_VALID, BenchmarkRecord, Case, CaseEstimates, all_cases
from scenetruth.benchmark.error_statistics import compute_statistic_records
from scenetruth.errors import EstimateError, EstimateWarning, SceneWarning, ScoreError
from scenetruth.estimators import find_method, prepare
from scenetruth.estimators.code_dependencies import with_called_code
from scenetruth.estimators.code_fingerprint import find_code_files
from scenetruth.estimators.external import CommandMethod
from scenetruth.estimators.method_specs import MethodSpec
from scenetruth.estimators.process_files import compute_hashes, list_process_code
from scenetruth.estimators.user_code import with_imported
from scenetruth.jobs.results import refuse_damaged, write_arrays
from scenetruth.random_streams import generator_for
from scenetruth.resources import Limits
from scenetruth.scene import Scene
from scenetruth.scoring import detect_convention_mismatches, get_units
from scenetruth.scoring.error_pairs import EstimateTruthPairs
from scenetruth.scoring.regions import visible_throughout
from scenetruth.simulation import simulate

__all__ = [
    "PICTURED_QUANTITIES",
    "CaseErrorMaps",
    "DesignPoint",
    "PeakMemory",
    "PointResult",
    "add_noise",
    "hash_called_code",
    "ignore_scene_warnings",
    "list_realisations",
    "measure",
    "read_error_maps",
    "simulate_point",
    "write_error_maps",
]


_STATM = Path("/proc/self/statm")
_POLL_S = 0.01


class PeakMemory:
    """Context that measures the peak increase of the memory of this process.

    ``megabytes`` is NaN on systems without `/proc`. Allocations shorter than 10 ms may be missed.
    """

    def __init__(self) -> None:
        self.megabytes = math.nan
        self._over = threading.Event()

    def __enter__(self) -> PeakMemory:
        before = _resident_bytes()
        if before is None:
            return self
        self.megabytes = 0.0
        self._thread = threading.Thread(target=self._look, args=(before,), name="memory", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._over.set()
        if not math.isnan(self.megabytes):
            self._thread.join()

    def _look(self, before: int) -> None:
        over = False
        while not over:
            over = self._over.wait(_POLL_S)
            now = _resident_bytes() or before
            self.megabytes = max(self.megabytes, (now - before) / 1e6)


def _resident_bytes() -> int | None:
    try:
        pages = int(_STATM.read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


PICTURED_QUANTITIES = ("disparity", "flow_x", "flow_y")
"""Quantities for error images; the first that a case evaluates is shown."""


@dataclass(frozen=True)
class CaseErrorMaps:
    """Image (y, x) of the reference camera at t = 0, and errors of a quantity in px by method, NaN where invalid."""

    image: NDArray[np.float32]
    quantity: str
    errors: Mapping[str, NDArray[np.float32]]


def build_error_maps(case: Case, found: CaseEstimates) -> CaseErrorMaps | None:
    """Return the error maps of the first noise realisation; None if a case evaluates no quantity in px."""
    quantity = next((name for name in PICTURED_QUANTITIES if name in case.quantities), None)
    if quantity is None:
        return None
    errors = {}
    for label, estimate in found.estimates.items():
        pairs = EstimateTruthPairs(estimate, found.truth)
        if quantity in pairs:
            pair = pairs[quantity]
            with np.errstate(invalid="ignore"):
                error = pair.estimate[0] - pair.truth[0]
            errors[label] = np.where(True if pair.full is None else pair.full[0], error, np.nan).astype(np.float32)
    image = np.asarray(found.recording["image"].sel(s=0, t=0).values, dtype=np.float32)
    return CaseErrorMaps(image.mean(axis=2) if image.ndim == 3 else image, quantity, errors)


def write_error_maps(maps: CaseErrorMaps, path: Path) -> None:
    """Write maps to a file."""
    labels = list(maps.errors)
    stack = np.stack([maps.errors[label] for label in labels]) if labels else np.zeros((0, *maps.image.shape))
    arrays = {
        "image": maps.image.astype(np.float16),
        "quantity": np.array(maps.quantity),
        "labels": np.array(labels, dtype=str),
        "errors": stack.astype(np.float16),
    }
    write_arrays(path, arrays)


def read_error_maps(path: Path) -> CaseErrorMaps | None:
    """Return the maps in a file; None if there is no file."""
    if not path.exists():
        return None
    with refuse_damaged(path, "run the comparison again"), np.load(path, allow_pickle=False) as stored:
        errors = dict(zip(map(str, stored["labels"]), stored["errors"].astype(np.float32), strict=True))
        return CaseErrorMaps(stored["image"].astype(np.float32), str(stored["quantity"]), errors)


BOUND_SIGMA_PX = 6.0
"""Window of the Cramér-Rao bound, the default of the methods."""


@dataclass(frozen=True)
class DesignPoint:
    """A scene of a case, with its levels (several if they share the scene) and the seeds of the noise."""

    case: str
    values: tuple[float, ...]
    seeds: tuple[int, ...]

    def scene(self) -> Scene:
        """Return the scene, without noise."""
        return Scene.from_dict(all_cases()[self.case].scene(self.values[0]))

    @property
    def name(self) -> str:
        """The name of its file."""
        return "all" if len(self.values) > 1 else all_cases()[self.case].get_label(self.values[0])


@dataclass
class PointResult:
    """The result of a design point; ``failures`` and likely ``convention_mismatches`` by label.

    ``settled``: Labels whose failures are final: installed methods that reject the recording.
    ``maps``: Error maps; None if no quantity is in px, or if the result was read from a file.
    """

    rows: list[BenchmarkRecord] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)
    settled: list[str] = field(default_factory=list)
    convention_mismatches: dict[str, list[str]] = field(default_factory=dict)
    maps: CaseErrorMaps | None = None


def simulate_point(case: Case, point: DesignPoint, limits: Limits | None = None) -> tuple[xr.Dataset, xr.Dataset]:
    """Return the recording without added noise, and the truth."""
    with ignore_scene_warnings():
        return simulate(point.scene(), truth_content=case.truth_content, limits=limits)


def list_realisations(case: Case, point: DesignPoint, ideal: xr.Dataset) -> Iterator[tuple[int, xr.Dataset]]:
    """Yield the seed and the recording of every noise realisation; the scene itself if its case adds no noise."""
    noise_std = case.noise_std(point.values[0])
    for seed in point.seeds if noise_std else (0,):
        yield seed, add_noise(ideal, noise_std, case.kind, seed)


def measure(
    case: Case,
    point: DesignPoint,
    contestants: Sequence[MethodSpec],
    limits: Limits | None = None,
    simulated: tuple[xr.Dataset, xr.Dataset] | None = None,
) -> PointResult:
    """Simulate a scene, unless it was ``simulated``, run all methods on the same images, and evaluate the estimates."""
    measured = PointResult()
    first = point.values[0]
    noise_std = case.noise_std(first)
    with ignore_scene_warnings():
        ideal, whole = simulate_point(case, point, limits) if simulated is None else simulated
        truth = whole.sel(t=[0])
        truth = truth.assign(seen_throughout=(("y", "x"), visible_throughout(whole)))
        found = []
        for realisation, (seed, recording) in enumerate(list_realisations(case, point, ideal)):
            estimates = {}
            for one in contestants:
                # A method may write to its images through C: the other methods must not see that.
                own = recording.copy(deep=True)
                took, held, work = time.perf_counter(), PeakMemory(), None
                try:
                    with held:
                        work = prepare(own, one.method, dict(one.settings))
                        maps = work.estimate().sel(t=[0])
                except (EstimateError, KeyError) as error:
                    measured.failures[one.label] = str(error)
                    if work is None and one.is_installed:
                        measured.settled.append(one.label)
                    continue
                took = time.perf_counter() - took
                estimates[one.label] = maps
                if realisation == 0 and not one.is_own:
                    with suppress(ScoreError):
                        measured.convention_mismatches[one.label] = [
                            mismatch.message for mismatch in detect_convention_mismatches(maps, truth)
                        ]
                for name, number, unit in (("seconds", took, "s"), ("peak_memory", held.megabytes, "MB")):
                    measured.rows.append(
                        BenchmarkRecord(
                            case.kind, first, one.label, "", METHOD_VALID, name, number, threshold=seed, unit=unit
                        )
                    )
            found.append(CaseEstimates(estimates, truth, recording, first))
        measured.maps = build_error_maps(case, found[0])
        for value in point.values:
            measured.rows += compute_statistic_records(case, value, found)
            here = CaseEstimates(found[0].estimates, truth, found[0].recording, value)
            measured.rows += case.further_rows(here)
            if case.bounded and noise_std:
                measured.rows += _bound_rows(case, value, whole, ideal, noise_std)
    return measured


def hash_called_code(contestants: Sequence[MethodSpec], started: float) -> dict[str, str]:
    """Return the hashes of the code that user-defined methods call, without what was written since ``started``."""
    methods = [one.method for one in contestants if one.fingerprint]
    if not methods:
        return {}
    own = {file for method in methods for file in find_code_files(method)}
    called = with_called_code(own, Path.cwd())
    commands = [found for found in map(find_method, methods) if isinstance(found, CommandMethod)]
    for command in commands:
        called |= command.called_code
    if len(commands) < len(methods):
        called |= list_process_code()
    # What they import is part of the fingerprint.
    return compute_hashes(called.difference(*map(with_imported, own)), started, own)


def add_noise(ideal: xr.Dataset, noise_std: float, *keys: Any) -> xr.Dataset:
    """Return a recording with additive white Gaussian noise."""
    if not noise_std:
        return ideal
    image = ideal["image"]
    noise = generator_for(0, "noise", *keys).normal(0.0, noise_std, image.shape)
    found = ideal.assign(image=(image.dims, (image.values + noise).astype(np.float32), image.attrs))
    # The changed images are a different recording.
    found.attrs.pop("recording_hash", None)
    return found


def _bound_rows(
    case: Case, value: float, truth: xr.Dataset, ideal: xr.Dataset, noise_std: float
) -> Iterator[BenchmarkRecord]:
    from scenetruth.bound import cramer_rao_bound

    # The methods do not assume constant area or constant illumination.
    bound = cramer_rao_bound(
        truth,
        ideal,
        noise_std=noise_std,
        window_sigma_px=BOUND_SIGMA_PX,
        motion="growing",
        brightness="per_image",
    ).sel(t=0)
    region = case.region_at(truth.sel(t=0).assign(seen_throughout=(("y", "x"), visible_throughout(truth))), value)
    for quantity in case.quantities:
        name, _, axis = quantity.partition("_")
        if f"{name}_std" not in bound:
            continue
        maps = bound[f"{name}_std"].values
        std = (maps["xyz".index(axis)] if axis else maps)[region]
        std = std[np.isfinite(std)]
        number = float(np.sqrt(np.mean(np.square(std)))) if std.size else math.nan
        yield BenchmarkRecord(
            case.kind, value, BOUND, quantity, METHOD_VALID, "noise_std", number, unit=get_units(quantity)
        )


@contextmanager
def ignore_scene_warnings() -> Iterator[None]:
    """Suppress warnings about the scenes of the suite, which are difficult by design."""
    with warnings.catch_warnings():
        for category in (EstimateWarning, SceneWarning, RuntimeWarning):
            warnings.simplefilter("ignore", category)
        yield
