"""One design point: its scene is simulated, all methods estimate, and errors, time and memory are measured."""

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
from scenetruth.estimators import prepare
from scenetruth.estimators.method_specs import MethodSpec
from scenetruth.jobs.results import refuse_damaged, write_arrays
from scenetruth.random_streams import generator_for
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
    "ignore_scene_warnings",
    "measure",
    "read_error_maps",
    "write_error_maps",
]


_STATM = Path("/proc/self/statm")
_POLL_S = 0.01


class PeakMemory:
    """Context that finds how much more memory this process has at most than when it began.

    Where the system does not tell (`/proc`), ``megabytes`` is NaN. What is allocated and freed within 10 ms is not
    seen.
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
"""Quantities whose errors are pictured, the first that a case measures."""


@dataclass(frozen=True)
class CaseErrorMaps:
    """What is pictured of a point.

    ``image``: The reference camera's image at t = 0, shape (y, x).
    ``quantity``: Whose errors they are.
    ``errors``: Estimate minus truth in px by method, shape (y, x); NaN where nothing is told.
    """

    image: NDArray[np.float32]
    quantity: str
    errors: Mapping[str, NDArray[np.float32]]


def build_error_maps(case: Case, found: CaseEstimates) -> CaseErrorMaps | None:
    """Return the maps of what was found with the first noise; None if a case measures nothing in pixels."""
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
    return CaseErrorMaps(image, quantity, errors)


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
    """Return the maps in a file; None if there is none."""
    if not path.exists():
        return None
    with refuse_damaged(path, "run the comparison again"), np.load(path, allow_pickle=False) as stored:
        errors = dict(zip(map(str, stored["labels"]), stored["errors"].astype(np.float32), strict=True))
        return CaseErrorMaps(stored["image"].astype(np.float32), str(stored["quantity"]), errors)


BOUND_SIGMA_PX = 6.0
"""Window of the Cramér-Rao bound that is told: that of the methods by default."""


@dataclass(frozen=True)
class DesignPoint:
    """A scene of a case, and what is measured of it.

    ``case``: Kind of the case.
    ``values``: What was varied: one value, or all of a case whose values are of one scene.
    ``seeds``: How many noises.
    """

    case: str
    values: tuple[float, ...]
    seeds: int

    @property
    def name(self) -> str:
        """What its file is called."""
        return "all" if len(self.values) > 1 else all_cases()[self.case].label_of(self.values[0])


@dataclass
class PointResult:
    """What came of a point.

    ``rows``: The figures.
    ``failures``: Why methods have given nothing, by label.
    ``settled``: Labels of those whose failures need not be tried again: installed methods that refuse the recording.
    ``slips``: Likely slips of convention in what methods of others and of one's own gave, by label.
    ``maps``: What is pictured; None where nothing is measured in pixels, or figures were read from a file.
    """

    rows: list[BenchmarkRecord] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)
    settled: list[str] = field(default_factory=list)
    slips: dict[str, list[str]] = field(default_factory=dict)
    maps: CaseErrorMaps | None = None


def measure(case: Case, point: DesignPoint, contestants: Sequence[MethodSpec]) -> PointResult:
    """Make a scene, let all methods estimate from the same images, and measure what they find."""
    measured = PointResult()
    first = point.values[0]
    noise_std = case.noise_std(first)
    with ignore_scene_warnings():
        ideal, whole = simulate(Scene.from_dict(case.scene(first)))
        truth = whole.sel(t=[0])
        truth = truth.assign(seen_throughout=(("y", "x"), visible_throughout(whole)))
        found = []
        for seed in range(point.seeds if noise_std else 1):
            recording = add_noise(ideal, noise_std, case.kind, seed)
            estimates = {}
            for one in contestants:
                took, held, work = time.perf_counter(), PeakMemory(), None
                try:
                    with held:
                        work = prepare(recording, one.method, dict(one.settings))
                        maps = work.estimate().sel(t=[0])
                except (EstimateError, KeyError) as error:
                    measured.failures[one.label] = str(error)
                    if work is None and one.is_installed:
                        measured.settled.append(one.label)
                    continue
                took = time.perf_counter() - took
                estimates[one.label] = maps
                if seed == 0 and not one.is_own:
                    with suppress(ScoreError):
                        measured.slips[one.label] = [slip.message for slip in detect_convention_mismatches(maps, truth)]
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


def add_noise(ideal: xr.Dataset, noise_std: float, *keys: Any) -> xr.Dataset:
    """Return a recording with white Gaussian noise in its images."""
    if not noise_std:
        return ideal
    image = ideal["image"]
    noise = generator_for(0, "noise", *keys).normal(0.0, noise_std, image.shape)
    found = ideal.assign(image=(image.dims, (image.values + noise).astype(np.float32), image.attrs))
    # It is another recording now.
    found.attrs.pop("recording_hash", None)
    return found


def _bound_rows(
    case: Case, value: float, truth: xr.Dataset, ideal: xr.Dataset, noise_std: float
) -> Iterator[BenchmarkRecord]:
    from scenetruth.bound import cramer_rao_bound

    # No method is told that sheets do not grow, or that the light is steady.
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
    """Leave out what the suite's scenes are warned of: they are meant to be difficult."""
    with warnings.catch_warnings():
        for category in (EstimateWarning, SceneWarning, RuntimeWarning):
            warnings.simplefilter("ignore", category)
        yield
