"""Checks of the contract: requirements independent of the content of the images."""

from __future__ import annotations

import copy
import pickle
import tempfile
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import EstimateError, ScenetruthError
from scenetruth.estimators import StreamingMethod, prepare, validate_settings
from scenetruth.estimators.estimation import output_problems
from scenetruth.schema import STATUS_INVALID, STATUS_VALID, VARIABLES, IncrementalDataset
from scenetruth.storage import load_store, open_store, save_store
from scenetruth.testing.conformance.bench import ConformanceBench, conformance_check
from scenetruth.testing.conformance.map_comparison import (
    CheckFailure,
    NotApplicable,
    list_differing_variables,
    require_equal_to_rounding,
    scalar_maps,
)

__all__ = []


@conformance_check()
def check_deterministic(bench: ConformanceBench) -> None:
    """Two calls with the same recording give the same bytes."""
    again = bench.estimate(bench.recording())
    differing = list_differing_variables(bench.plain, again)
    if differing:
        raise CheckFailure(
            "the plain recording was estimated twice",
            "the same bytes",
            f"they differ in {', '.join(differing)}",
            "seed random numbers with a setting (numpy.random.default_rng(settings.seed)), keep no state between "
            "calls, and sum in an order that is independent of threads",
        )


_INTRINSIC_VARIABLES = ("focal_length_px", "principal_point_px", "baseline_mm", "frame_interval_s")


@conformance_check(plain=False)
def check_output_schema(bench: ConformanceBench) -> None:
    """The estimate has the documented dimensions, units and types, and the images' frames, pixels and intrinsics."""
    recording = bench.recording()
    part = recording.isel(y=slice(1, None), x=slice(2, None))
    found = bench.estimate_if_it_suits(part)
    wrong = [str(problem) for problem in output_problems(found, part, frozenset())]
    wrong += [
        f"{name} begins at {found[name].values[:1]}, but in the recording at {part[name].values[:1]}"
        for name in ("y", "x")
        if name in found.coords and not np.array_equal(found[name].values, part[name].values)
    ]
    wrong += [
        f"attrs.{name} is {found.attrs.get(name)}, but in the recording {part.attrs[name]}"
        for name in _INTRINSIC_VARIABLES
        if not np.array_equal(np.asarray(found.attrs.get(name)), np.asarray(part.attrs[name]))
    ]
    if wrong:
        raise CheckFailure(
            "a part of the plain recording was estimated, without its first row and its first two columns",
            "an estimate of this part, as specified in docs/reference/data_model.md",
            "; ".join(dict.fromkeys(wrong)),
            "return scenetruth.make_estimate(recording=recording, ...), which adds all of this to plain arrays",
        )


@conformance_check(plain=False)
def check_declared_outputs(bench: ConformanceBench) -> None:
    """The plain recording has an estimate with the variables of `gives`, each valid at some pixel."""
    sizes = dict(bench.recording()["image"].sizes)
    found = bench.estimate(bench.recording())
    missing = [name for name in sorted(bench.method.gives) if name not in found]
    blank = [name for name in sorted(bench.method.gives) if name in found and not found[name].notnull().any()]
    if missing or blank:
        entries = [f"no {', '.join(missing)}"] if missing else []
        entries += [f"NaN everywhere in {', '.join(blank)}"] if blank else []
        raise CheckFailure(
            f"a textured plane was estimated, images {sizes}, noise-free",
            f"all of {', '.join(sorted(bench.method.gives))}, with valid pixels",
            "; ".join(entries),
            "return it, or remove it from `gives`; check a method that requires larger or more images with "
            "size=, cameras=, frames=",
        )


@conformance_check()
def check_input_unchanged(bench: ConformanceBench) -> None:
    """The recording is unchanged when the method returns: images, coordinates and attributes."""
    recording = bench.recording()
    before, attributes = recording.copy(deep=True), copy.deepcopy(recording.attrs)
    of_variables = {name: copy.deepcopy(item.attrs) for name, item in recording.variables.items()}
    bench.estimate(recording)
    changed = [*list_differing_variables(before, recording)]
    changed += [f"attrs.{name}" for name in sorted({*attributes, *recording.attrs}, key=str)
                if attributes.get(name) != recording.attrs.get(name)]  # fmt: skip
    changed += [
        f"{name}.attrs" for name, item in recording.variables.items() if item.attrs != of_variables.get(name, {})
    ]
    if changed:
        raise CheckFailure(
            "the plain recording was handed over in arrays that can be written to",
            "the recording as it was",
            f"changed: {', '.join(map(str, changed))}",
            "work on copies: recording['image'].values.copy(), dict(recording.attrs)",
        )


_STATUS_MAPS = {"status_disparity": ("depth", "disparity"), "status_motion": ("flow",)}


@conformance_check()
def check_invalid_is_nan(bench: ConformanceBench) -> None:
    """Invalid is NaN, not 0 or infinite; depths are positive; `status` and `invalid_reason` agree with the maps."""
    blank = bench.plane.images()
    blank[:, :, :, -(blank.shape[3] // 3) :] = 0.5
    wrong = _invalid_values(bench.plain, bench)
    try:
        found = bench.estimate(bench.plane.recording(blank))
    except ScenetruthError:
        # A method may require texture everywhere if it reports this.
        pass
    else:
        wrong += [f"{entries}, where a third of the images is blank" for entries in _invalid_values(found, bench)]
    if wrong:
        raise CheckFailure(
            "the plain recording was estimated, and a recording whose right third has a constant grey value",
            "NaN wherever there is no estimate, and status 0 exactly there",
            "; ".join(wrong),
            "write NaN at invalid pixels; scenetruth.make_estimate derives the status from it",
        )


def _invalid_values(found: xr.Dataset, bench: ConformanceBench) -> list[str]:
    wrong = []
    for name in map(str, found.data_vars):
        if name in VARIABLES["estimate"] and found[name].dtype.kind == "f" and not name.endswith("_std"):
            count = int(np.isinf(found[name].values).sum())
            wrong += [f"{name} holds {count} infinite values"] if count else []
    sign = np.sign(bench.plane.baseline_mm)
    for name, positive in (("depth", 1.0), ("disparity", sign)):
        if name in found:
            count = int((found[name].values * positive <= 0).sum())
            wrong += [f"{name} holds {count} values that are zero or of the wrong sign"] if count else []
    for status, names in _STATUS_MAPS.items():
        for name in names:
            if status not in found or name not in found:
                continue
            known = np.isfinite(found[name].values)
            # For flow, both components.
            known = known if known.ndim == found[status].ndim else known.all(axis=0)
            count = int((known == (found[status].values == STATUS_INVALID)).sum())
            wrong += [f"{status} and {name} are inconsistent in {count} pixels"] if count else []
    valid = found["valid"].values
    for name, says in (("status", found["status"] == STATUS_VALID), ("invalid_reason", found["invalid_reason"] == 0)):
        count = int((says.values != valid).sum())
        wrong += [f"{name} and valid are inconsistent in {count} pixels"] if count else []
    return wrong


@conformance_check()
def check_no_shared_memory(bench: ConformanceBench) -> None:
    """The estimate's arrays share no memory with the recording or with the estimate of another call."""
    recording = bench.recording()
    first, second = bench.estimate(recording), bench.estimate(recording)
    wrong = []
    for name, variable in first.data_vars.items():
        values = variable.values
        wrong += [
            f"{name} shares memory with the recording's {other}"
            for other, item in recording.variables.items()
            if np.may_share_memory(values, item.values) and values.size
        ]
        if name in second and np.may_share_memory(values, second[name].values) and values.size:
            wrong.append(f"{name} shares memory with the estimate of the next call")
    if wrong:
        raise CheckFailure(
            "the plain recording was estimated twice, and the addresses of all arrays were compared",
            "separate arrays for each estimate",
            "; ".join(wrong),
            "return copies (array.copy()), and allocate new arrays in every call",
        )


class _Interruption(Exception):
    pass


@conformance_check()
def check_progress(bench: ConformanceBench) -> None:
    """Progress is optional and does not change the estimate, and exceptions of the callback are propagated."""
    entries: list[tuple[object, object, object]] = []

    def listen(what: object, done: object, total: object) -> None:
        entries.append((what, done, total))

    found = bench.estimate(bench.recording(), listen)
    require_equal_to_rounding(
        scalar_maps(found),
        scalar_maps(bench.plain),
        done="a progress callback was given",
        expectation="the same estimate",
        remedy="only report progress: the estimate must not depend on the callback",
    )
    if not entries:
        msg = "the method reports no progress"
        raise NotApplicable(msg)
    wrong = [item for item in entries if not _is_progress_call(*item)]
    if wrong:
        raise CheckFailure(
            "a progress callback was given",
            "calls with (what: str, done: int, total: int), 0 <= done <= total",
            f"called with {wrong[0]}",
            "call progress(what, done, total) with integers",
        )

    def interrupt(what: object, done: object, total: object) -> None:
        raise _Interruption

    try:
        bench.estimate(bench.recording(), interrupt)
    except _Interruption:
        return
    except Exception as error:
        if isinstance(error.__cause__ or error.__context__, _Interruption):
            came_out = f"{type(error).__name__} instead, which hides it"
        else:
            raise
    else:
        came_out = "the method continued to its end"
    raise CheckFailure(
        "an exception was raised in progress, as for an interruption",
        "the same exception is propagated",
        came_out,
        "do not catch exceptions of progress",
    )


def _is_progress_call(what: object, done: object, total: object) -> bool:
    return isinstance(what, str) and isinstance(done, int) and isinstance(total, int) and 0 <= done <= total


_ROUND_TRIP_REMEDY = (
    "return plain arrays and attributes of plain values (numbers, texts, lists), as scenetruth.make_estimate does"
)


@conformance_check()
def check_round_trip(bench: ConformanceBench) -> None:
    """The estimate is unchanged after saving, loading and pickling."""
    estimate = bench.plain
    wrong = []
    try:
        pickled: xr.Dataset = pickle.loads(pickle.dumps(estimate))
        wrong += [f"{name} changes when pickled" for name in list_differing_variables(estimate, pickled)]
    except Exception as error:  # any error of an attribute
        wrong.append(f"it cannot be pickled: {type(error).__name__}: {error}")
    with tempfile.TemporaryDirectory() as folder:
        try:
            save_store(estimate, Path(folder) / "estimate.zarr")
            loaded = load_store(Path(folder) / "estimate.zarr", kind="estimate")
            wrong += [f"{name} changes when saved and loaded" for name in list_differing_variables(estimate, loaded)]
        except (ScenetruthError, TypeError, ValueError) as error:
            wrong.append(f"it cannot be saved and loaded: {' '.join(str(error).split())}")
    if wrong:
        raise CheckFailure(
            "the estimate was pickled, and saved and loaded", "the same bytes", "; ".join(wrong), _ROUND_TRIP_REMEDY
        )


@conformance_check()
def check_standard_deviations(bench: ConformanceBench) -> None:
    """Standard deviations are positive and finite wherever they are stated."""
    found = bench.plain
    names = [str(name) for name in found.data_vars if str(name).endswith("_std")]
    if not names:
        msg = "the method states no standard deviations"
        raise NotApplicable(msg)
    wrong = []
    for name in names:
        values = found[name].values
        bad = int((np.isinf(values) | (values <= 0)).sum())
        wrong += [f"{name} is 0, negative or infinite in {bad} pixels"] if bad else []
        what = name.removesuffix("_std")
        if what in found and found[what].dims == found[name].dims:
            alone = int((np.isfinite(values) & ~np.isfinite(found[what].values)).sum())
            wrong += [f"{name} is stated in {alone} pixels where {what} is invalid"] if alone else []
    if wrong:
        raise CheckFailure(
            "the plain recording was estimated",
            "standard deviations above 0, or NaN",
            "; ".join(wrong),
            "write NaN where no standard deviation is available",
        )


_FURTHER_FRAMES = 2


@conformance_check()
def check_streaming(bench: ConformanceBench) -> None:
    """A `StreamingMethod` returns the same frame by frame, from a store that is read on demand, as in memory."""
    method = bench.method
    if not isinstance(method, StreamingMethod):
        msg = "the method is not a StreamingMethod: it holds all images in memory"
        raise NotApplicable(msg)
    recording = replace(bench.plane, frames=bench.plane.frames + _FURTHER_FRAMES).recording()
    whole = bench.estimate(recording)
    puts: dict[str, NDArray[np.int64]] = {}
    with tempfile.TemporaryDirectory() as folder:
        save_store(recording, Path(folder) / "recording.zarr")
        opened = open_store(Path(folder) / "recording.zarr", kind="recording")
        estimation = prepare(opened, method, bench.settings)
        blank = estimation.blank()
        assert blank is not None
        filling = IncrementalDataset(blank)

        def put(name: str, at: Mapping[str, int], values: NDArray[Any]) -> None:
            variable = blank.variables[name]
            counts = puts.setdefault(name, np.zeros(variable.shape, dtype=np.int64))
            counts[tuple(at.get(str(dim), slice(None)) for dim in variable.dims)] += 1
            filling.put(name, at, np.array(values))

        estimation.fill(put)
        found = filling.dataset()
    wrong = [f"{name} differs" for name in list_differing_variables(whole, found)]
    for name in map(str, blank.data_vars):
        counts = puts.get(name, np.zeros(1, dtype=np.int64))
        if (counts != 1).any():
            wrong.append(f"values of {name} were written {counts.min()} to {counts.max()} times")
    if wrong:
        sizes = dict(recording["image"].sizes)
        raise CheckFailure(
            f"a recording of {sizes} was saved, opened without loading it, and estimated by `blank` and `fill`",
            "every map written once, with the same bytes as by `estimate`",
            "; ".join(wrong),
            "write every map of every frame of `blank`, and do not override `estimate` of StreamingMethod",
        )


_THREAD_ROUNDS = 3


@conformance_check()
def check_thread_safe(bench: ConformanceBench) -> None:
    """A method with `thread_safe = True` returns the same in two concurrent threads as in one."""
    if not bench.says_it_is_thread_safe:
        msg = "the method is not declared thread-safe: it has no attribute thread_safe = True"
        raise NotApplicable(msg)
    plain = bench.recording()
    upside_down = bench.plane.recording(bench.plane.images()[:, :, ::-1])
    recordings = (plain, upside_down)
    alone = [bench.estimate(recording.copy(deep=True)) for recording in recordings]
    together = Barrier(len(recordings))

    def work(recording: xr.Dataset) -> xr.Dataset:
        together.wait(timeout=60)
        return bench.estimate(recording.copy(deep=True))

    differing: set[str] = set()
    with ThreadPoolExecutor(len(recordings)) as threads:
        for _ in range(_THREAD_ROUNDS):
            for one, other in zip(alone, threads.map(work, recordings), strict=True):
                differing |= set(list_differing_variables(one, other))
    if differing:
        raise CheckFailure(
            f"two recordings were estimated in two concurrent threads, {_THREAD_ROUNDS} times",
            "the same bytes as in a single thread",
            f"they differ in {', '.join(sorted(differing))}",
            "keep the state of a call in local variables, not in the method or in globals; or remove thread_safe",
        )


_UNKNOWN_SETTING = "no_such_setting_of_any_method"


@conformance_check(plain=False)
def check_unknown_settings(bench: ConformanceBench) -> None:
    """Unknown settings are rejected."""
    try:
        validate_settings(bench.method, {**bench.settings.model_dump(), _UNKNOWN_SETTING: 1})
    except EstimateError as error:
        if any(_UNKNOWN_SETTING in problem.path for problem in error.problems):
            return
        raise
    raise CheckFailure(
        f"the settings contained '{_UNKNOWN_SETTING}'",
        "an EstimateError with its name",
        "it was accepted, so that a misspelled setting is silently ignored",
        "derive settings from scenetruth.estimators.MethodSettings, without extra='allow' or 'ignore'",
    )
