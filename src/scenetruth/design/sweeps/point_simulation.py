"""One simulation of a sweep as a task: images, estimates, scores, Cramér-Rao bound, and retained errors."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.benchmark.design_point import ignore_scene_warnings
from scenetruth.bound.unknowns import Brightness, MotionChoice, Surface
from scenetruth.design.sweeps.factors import format_level
from scenetruth.design.sweeps.sweep_plan import SweepPlan
from scenetruth.errors import EstimateError, RecordingError
from scenetruth.estimators import find_method, prepare, validate_settings
from scenetruth.estimators.method_specs import MethodSpec
from scenetruth.jobs.results import ResultStore, TaskResult, compute_key, perform_task, refuse_damaged, write_arrays
from scenetruth.plain_data import parse_json
from scenetruth.provenance import scene_hash
from scenetruth.resources import Limits
from scenetruth.scene import Scene
from scenetruth.schema import read_intrinsics
from scenetruth.scoring import QUANTITIES, REGIONS, Score, score
from scenetruth.scoring.alignment import iterate_aligned_blocks
from scenetruth.scoring.error_pairs import EstimateTruthPair, EstimateTruthPairs, has_quantity, percent_per_hour
from scenetruth.scoring.growth_rate import compute_growth_pairs, has_growth_rate
from scenetruth.scoring.regions import further_regions, main_regions, visible_throughout
from scenetruth.settings import ScoreSettings
from scenetruth.simulation import make_truth, simulate

__all__ = [
    "BOUND",
    "BoundWindow",
    "RetainedErrors",
    "SimulationResult",
    "SweepTask",
    "bound_window_from_method",
    "compute_normal_statistics",
    "methods_from_scene",
    "read_retained_errors",
    "read_simulation_result",
    "run_sweep_task",
]


_PIXELS = 10_000  # largest number of retained pixels per image: errors are correlated over the width of a window

_REGION, _ERROR = "region", "error"
_REMEDY = "run the sweep again"
ErrorMap = NDArray[np.float32]


def compute_step_px(dataset: xr.Dataset) -> int:
    """Return the spacing of the retained rows and columns."""
    return max(1, math.ceil(math.sqrt(dataset.sizes["y"] * dataset.sizes["x"] / _PIXELS)))


@dataclass(frozen=True)
class RetainedErrors:
    """Errors of a simulation at a subset of pixels, and masks of regions, shape (t, y, x)."""

    regions: Mapping[tuple[str, str], NDArray[np.bool_]]  # by method and region
    errors: Mapping[tuple[str, str], ErrorMap]  # estimate minus truth by method and quantity; NaN where invalid


def compute_retained_errors(pairs: Mapping[str, EstimateTruthPair], step_px: int) -> dict[str, ErrorMap]:
    """Return the errors of all scalar quantities in every ``step_px``-th row and column."""
    found = {}
    for name, pair in pairs.items():
        if QUANTITIES[name].error != "difference":
            continue
        with np.errstate(over="ignore", invalid="ignore"):
            error = (pair.estimate - pair.truth)[..., ::step_px, ::step_px]
        known = np.isfinite(error)
        if pair.full is not None:
            known &= pair.full[..., ::step_px, ::step_px]
        found[name] = np.where(known, error, np.nan).astype(np.float32)
    return found


def write_retained_errors(kept: RetainedErrors, path: Path) -> None:
    """Write retained errors to a file."""
    arrays: dict[str, Any] = {json.dumps([_REGION, *names]): mask for names, mask in kept.regions.items()}
    arrays |= {json.dumps([_ERROR, *names]): errors for names, errors in kept.errors.items()}
    # Labels of methods may contain any character; names of arrays in a file may not.
    numbered: dict[str, Any] = {f"a{number}": array for number, array in enumerate(arrays.values())}
    write_arrays(path, {"names": np.array(list(arrays), dtype=str), **numbered})


def read_retained_errors(path: Path) -> RetainedErrors:
    """Return the retained errors of a file."""
    regions: dict[tuple[str, str], Any] = {}
    errors: dict[tuple[str, str], Any] = {}
    with refuse_damaged(path, _REMEDY), np.load(path, allow_pickle=False) as stored:
        for number, name in enumerate(map(str, stored["names"])):
            kind, method, what = parse_json(name)
            (regions if kind == _REGION else errors)[method, what] = stored[f"a{number}"]
    return RetainedErrors(regions, errors)


BOUND = "bound"
"""Label of records of the Cramér-Rao bound, in place of a method."""
_SIGMA_PX = 6.0  # window of the bound for methods without a window setting: the default of the built-in methods, in px

StdMap = NDArray[np.float64]


@dataclass(frozen=True)
class BoundWindow:
    """Window and unknown parameters of a bound, as in `scenetruth.bound.cramer_rao_bound`."""

    sigma_px: float
    surface: Surface
    motion: MotionChoice
    brightness: Brightness


def bound_window_from_method(contestant: MethodSpec) -> BoundWindow:
    """Return the window and the unknown parameters of a method from its settings.

    For a surface of ``auto``, slopes are unknown; for a motion of ``auto``, rotation and growth, and the affine
    velocity gradient where growth is anisotropic beyond noise. For a method without such settings, slopes, the velocity
    gradient and brightness are given, so that no method is below its bound.
    """
    settings = validate_settings(find_method(contestant.method), contestant.settings)
    sigma = getattr(settings, "window_sigma_px", None)
    return BoundWindow(
        float(sigma) if isinstance(sigma, int | float) else _SIGMA_PX,
        cast(Surface, _read_choice(settings, "surface", get_args(Surface), "constant", "plane")),
        cast(MotionChoice, _read_choice(settings, "motion", get_args(MotionChoice), "translation", "auto")),
        "per_image" if getattr(settings, "photometric_model", None) == "per_image" else "fixed",
    )


def _read_choice(settings: Any, name: str, words: Sequence[str], without: str, otherwise: str) -> str:
    """Return a setting if it is one of ``words``; otherwise ``without`` (no such setting) or ``otherwise``."""
    entries = getattr(settings, name, None)
    return without if entries is None else entries if entries in words else otherwise


def name_bounds(contestants: Sequence[MethodSpec]) -> dict[str, str]:
    """Return the names of the bounds by label of the method."""
    if len(contestants) == 1:
        return {contestants[0].label: BOUND}
    return {one.label: f"{BOUND} of {one.label}" for one in contestants}


def compute_bound_std(
    truth: xr.Dataset, recording: xr.Dataset, window: BoundWindow, step_px: int
) -> tuple[dict[str, StdMap], str]:
    """Return the Cramér-Rao bound at the reference frame.

    Returns: Standard deviations by quantity, shape (y, x), in its units, NaN where undefined; and the reason for a
    missing bound, or an empty text.
    """
    from scenetruth.bound import cramer_rao_bound

    grey = recording.sizes.get("channel", 1) == 1
    try:
        bound = cramer_rao_bound(
            truth,
            recording,
            window_sigma_px=window.sigma_px,
            surface=window.surface,
            motion=window.motion,
            brightness=window.brightness if grey else "fixed",
            step_px=step_px,
        ).sel(t=0)
    except RecordingError as error:
        return {}, "; ".join(map(str, error.problems))
    found = {}
    for quantity, entry in QUANTITIES.items():
        name = f"{entry.variable}_std"
        if entry.error == "difference" and name in bound:
            values = bound[name].values if entry.component is None else bound[name].values[entry.component]
            found[quantity] = values * (percent_per_hour(read_intrinsics(recording)) if entry.units == "%/h" else 1.0)
    return found, ""


def compute_normal_statistics(std: StdMap) -> dict[str, float]:
    """Return ``rmse`` and ``median_abs_error`` of normal errors with given standard deviations.

    ``std``: Standard deviations, any shape; only finite positive values are used.

    >>> {name: round(size, 4) for name, size in compute_normal_statistics(np.array([1.0, 1.0, np.nan])).items()}
    {'rmse': 1.0, 'median_abs_error': 0.6745}
    """
    kept = std[np.isfinite(std) & (std > 0)]
    return (
        {"rmse": float(np.sqrt(np.mean(np.square(kept)))), "median_abs_error": _compute_median(kept)}
        if kept.size
        else {}
    )


def _compute_median(std: StdMap) -> float:
    """Return the median absolute value of normal errors with given standard deviations."""
    from scipy.optimize import brentq
    from scipy.special import erf, erfinv

    factor = math.sqrt(2) * float(erfinv(0.5))
    low, high = factor * float(std.min()), factor * float(std.max())
    if high <= low * (1 + 1e-12):
        return low
    return float(brentq(lambda size: float(np.mean(erf(size / (math.sqrt(2) * std)))) - 0.5, low, high, rtol=1e-9))


SCORED_STATISTICS = ("rmse", "bias", "median_abs_error", "density")
"""Statistics of a sweep that are taken from scores."""

Mask = NDArray[np.bool_]
Figures = dict[str, dict[str, dict[str, float]]]
"""Region to quantity to statistic to value."""


@dataclass
class SimulationResult:
    """Result of one simulation."""

    figures: dict[str, Figures] = field(default_factory=dict)  # statistics by method
    bounds: dict[str, Figures] = field(default_factory=dict)  # statistics by name of the bound
    failures: dict[str, str] = field(default_factory=dict)  # reasons of failed methods, by label
    notes: list[str] = field(default_factory=list)  # reasons for missing bounds
    settled: list[str] = field(default_factory=list)  # final failures: installed methods that reject the recording
    grows: bool = False
    kept: RetainedErrors | None = None  # None if not requested


def methods_from_scene(scene: Scene) -> list[MethodSpec]:
    """Return the method of the scene file."""
    settings = scene.estimate.settings.model_dump(mode="json")
    return [MethodSpec(scene.estimate.method, settings, scene.estimate.method)]


def simulate_and_score(
    scene: Scene,
    contestants: Sequence[MethodSpec],
    *,
    bounded: bool,
    keeps: bool,
    limits: Limits | None = None,
) -> SimulationResult:
    """Simulate a scene, run all methods on the recording, and score the estimates."""
    methods = list(contestants) or methods_from_scene(scene)
    measured, seen = SimulationResult(), list[_MethodErrors]()
    with ignore_scene_warnings():
        with_radiance, truth = simulate(scene, save_radiance=bounded, limits=limits)
        recording = with_radiance.drop_vars("radiance", errors="ignore")
        step_px = compute_step_px(recording)
        for one in methods:
            work = None
            try:
                # Memory of its own: the other methods must not see what a method writes to its images through C.
                work = prepare(recording.copy(deep=True), one.method, dict(one.settings))
                maps = work.estimate()
            except (EstimateError, KeyError) as error:
                measured.failures[one.label] = " ".join(str(error).split())
                if work is None and one.is_installed:
                    measured.settled.append(one.label)
                continue
            if _is_further(maps, truth):
                truth = make_truth(scene, truth_content="complete", limits=limits)
            found = score(maps, truth, settings=scene.score)
            measured.figures[one.label] = _figures(found)
            measured.grows |= found.grows
            if keeps or bounded:
                seen.append(_collect_errors(one, maps, truth, scene.score, step_px))
        if keeps:
            measured.kept = RetainedErrors(
                {(each.contestant.label, name): mask for each in seen for name, mask in each.regions.items()},
                {(each.contestant.label, name): errors for each in seen for name, errors in each.errors.items()},
            )
        if bounded:
            names = name_bounds(methods)
            stds = {
                window: compute_bound_std(truth, with_radiance, window, step_px)
                for window in {each.window for each in seen}
            }
            for each in seen:
                entries, why = stds[each.window]
                measured.bounds[names[each.contestant.label]] = each.least(entries)
                if why and f"no bound: {why}" not in measured.notes:
                    measured.notes.append(f"no bound: {why}")
    return measured


def _is_further(maps: xr.Dataset, truth: xr.Dataset) -> bool:
    """Return whether an estimate has a scored quantity that the truth lacks."""
    return any(entry.variable in maps and not has_quantity(truth, name) for name, entry in QUANTITIES.items())


@dataclass(frozen=True)
class _MethodErrors:
    """Errors and region masks of a method at a subset of pixels, shape (t, y, x)."""

    contestant: MethodSpec
    regions: Mapping[str, Mask]
    errors: Mapping[str, NDArray[np.float32]]
    reference: int | None
    """Index of the frame t = 0; None if it is not estimated."""
    grows: bool
    """Whether the method itself estimates the growth rate, in its own window."""

    @property
    def window(self) -> BoundWindow:
        return bound_window_from_method(self.contestant)

    def least(self, std: Mapping[str, NDArray[np.float64]]) -> Figures:
        """Return the statistics of the bound at the valid pixels."""
        found: Figures = {}
        for region, mask in self.regions.items():
            for quantity, errors in self.errors.items():
                # Growth derived from depth and velocity has a larger window.
                if self.reference is None or quantity not in std or (quantity == "growth_rate" and not self.grows):
                    continue
                entries = mask[self.reference] & np.isfinite(errors[self.reference])
                sizes = compute_normal_statistics(std[quantity][entries])
                if sizes:
                    found.setdefault(region, {})[quantity] = sizes
        return found


def _collect_errors(
    contestant: MethodSpec, maps: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings, step_px: int
) -> _MethodErrors:
    regions = {name: mask[..., ::step_px, ::step_px] for name, mask in _regions(maps, truth, settings).items()}
    frames = maps["t"].values.tolist()
    reference = frames.index(0) if 0 in frames else None
    return _MethodErrors(contestant, regions, _errors(maps, truth, settings, step_px), reference, "growth_rate" in maps)


def _is_reported(region: str) -> bool:
    return region in REGIONS or region.startswith("object_")


def _figures(found: Score) -> Figures:
    return {
        region: {
            quantity: {name: float(value) for name in SCORED_STATISTICS if (value := statistics.get(name)) is not None}
            for quantity, statistics in quantities.items()
            if any(name in statistics for name in SCORED_STATISTICS)
        }
        for region, quantities in found.regions.items()
        if _is_reported(region)
    }


def _regions(maps: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings) -> dict[str, Mask]:
    """Return the masks of the scored regions at the frames of an estimate, shape (t, y, x)."""
    reference = truth.sel({dim: 0 for dim in ("s_y", "s") if dim in truth["depth"].dims})
    here = reference.sel(t=maps["t"].values)
    masks = main_regions(here, settings.interior_margin_px)
    masks |= further_regions(here, masks["interior"], settings, throughout=visible_throughout(truth))
    return {name: mask for name, mask in masks.items() if _is_reported(name)}


def _errors(
    maps: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings, step_px: int
) -> dict[str, NDArray[np.float32]]:
    """Return errors in every ``step_px``-th row and column by quantity, shape (t, y, x)."""
    parts: list[dict[str, NDArray[np.float32]]] = []
    for found, exact in iterate_aligned_blocks(maps, truth):
        grown = compute_growth_pairs(found, exact, settings) if has_growth_rate(found, exact) else None
        parts.append(compute_retained_errors(EstimateTruthPairs(found, exact, grown), step_px))
    common = [name for name in parts[0] if all(name in part for part in parts)]
    return {name: np.concatenate([part[name] for part in parts]) for name in common}


_FORMAT = 4  # version of the results; increased when the statistics of the same simulation change


@dataclass(frozen=True)
class SweepTask:
    """Input of a worker for all simulations of a sweep; without ``contestants``, the method of each scene is used."""

    folder: str
    plan: SweepPlan
    contestants: tuple[MethodSpec, ...]
    versions: tuple[tuple[str, str], ...]
    limits: Limits | None = None

    @property
    def keeps(self) -> bool:
        """Whether errors are retained for the scatter between seeds."""
        return self.plan.each > 1

    def key(self, number: int) -> str:
        """Return a hash of all inputs of a simulation, which names its files."""
        scene = self.plan.scene(number)
        methods = self.contestants or tuple(methods_from_scene(scene))
        depends: dict[str, Any] = {
            "format": _FORMAT,
            "scene": scene_hash(scene),
            "score": scene.score.model_dump(mode="json"),
            "methods": [(one.label, one.identity) for one in methods],
            "bounded": self.plan.is_first(number),
            "versions": self.versions,
        }
        return compute_key(depends)

    @property
    def store(self) -> ResultStore:
        """Results of the simulations by key."""
        return ResultStore(Path(self.folder), _REMEDY)

    def is_done(self, key: str) -> bool:
        """Return whether the results of a simulation exist and have no failure to repeat."""
        return self.store.is_done(key, key, arrays=self.keeps)

    def label(self, number: int) -> str:
        """Return a label of a simulation with scene, levels and seed."""
        point, seed = self.plan.at(number)
        values = ", ".join(f"{path} = {format_level(value)}" for path, value in self.plan.values(point).items())
        scene = f"{self.plan.labels[point.scene]}, " if len(self.plan.labels) > 1 else ""
        return f"{scene}{values}, seed {seed}"


def run_sweep_task(job: SweepTask, number: int) -> TaskResult:
    """Run and score one simulation; an exception is returned as part of the result."""

    def work() -> dict[str, Any]:
        key = job.key(number)
        found = simulate_and_score(
            job.plan.scene(number),
            job.contestants,
            bounded=job.plan.is_first(number),
            keeps=job.keeps,
            limits=job.limits,
        )
        if found.kept is not None:
            write_retained_errors(found.kept, job.store.arrays_path(key))
        job.store.write(key, key, _plain(found))
        return {"simulation": number}

    return perform_task(number, work, label=job.label(number), versions=job.versions)


def _plain(found: SimulationResult) -> dict[str, Any]:
    names = ("figures", "bounds", "failures", "notes", "settled", "grows")
    return {name: getattr(found, name) for name in names}


def read_simulation_result(job: SweepTask, key: str) -> SimulationResult:
    """Return the stored result of a simulation without the retained errors."""
    with job.store.reading(key) as plain:
        return SimulationResult(
            dict(plain["figures"]),
            dict(plain["bounds"]),
            dict(plain["failures"]),
            list(plain["notes"]),
            list(plain.get("settled", ())),
            bool(plain["grows"]),
        )
