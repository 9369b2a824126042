"""Alignment of an estimate and a truth to the same camera, frames and pixels, in blocks of frames."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr

from scenetruth.errors import Problem, RecordingError, ScoreError
from scenetruth.schema import check_dataset, read_intrinsics
from scenetruth.scoring.regions import edge_distance

__all__ = [
    "align",
    "check_alignable",
    "check_estimate",
    "check_recording",
    "count_blocks",
    "iterate_aligned_blocks",
    "iterate_blocks",
    "select_pixels",
]


_RELATIVE_TOLERANCE = 1e-6
"""Relative tolerance of intrinsics, sufficient for values that were stored as float32."""


def align(estimate: xr.Dataset, truth: xr.Dataset) -> tuple[xr.Dataset, xr.Dataset]:
    """Return an estimate and the matching part of the truth; frames and pixels are matched by coordinates t, y, x."""
    check_alignable(estimate, truth)
    reference = truth.sel({dim: 0 for dim in ("s_y", "s") if dim in truth.dims}).sel(t=estimate["t"].values)
    if "boundary_distance" not in reference:
        mixed = reference["mixed"]
        # Distances are computed before pixels are selected: a discontinuity outside the selected part still counts.
        distance = edge_distance(mixed.values.astype(bool))
        reference = reference.assign(boundary_distance=(mixed.dims, distance, {"units": "px"}))
    return estimate, select_pixels(reference, estimate)


def check_alignable(estimate: xr.Dataset, truth: xr.Dataset) -> None:
    """Check that an estimate can be compared with a truth; see `align`."""
    problems = [*_form_problems(estimate, "estimate"), *_form_problems(truth, "truth")]
    if problems:
        raise ScoreError(problems)
    problems = [
        *_frame_problems(estimate, truth),
        *_pixel_problems(estimate, truth, "truth"),
        *_intrinsics_problems(estimate, truth),
    ]
    if problems:
        raise ScoreError(problems)


def select_pixels(dataset: xr.Dataset, estimate: xr.Dataset) -> xr.Dataset:
    """Return the pixels of an estimate from a data set that `align` or `check_recording` has checked."""
    indexers = {dim: estimate[dim].values for dim in _named_dims(dataset, estimate)}
    return dataset.sel({dim: at for dim, at in indexers.items() if not np.array_equal(at, dataset[dim].values)})


def check_estimate(estimate: xr.Dataset) -> None:
    """Check that an estimate conforms to the data model."""
    problems = [*_form_problems(estimate, "estimate")]
    if problems:
        raise ScoreError(problems)


def check_recording(recording: xr.Dataset, estimate: xr.Dataset) -> None:
    """Check that a recording conforms to the data model and has the pixels of an estimate."""
    problems = [*_form_problems(recording, "recording")] or [*_pixel_problems(estimate, recording, "recording")]
    if problems:
        raise ScoreError(problems)


def _form_problems(dataset: xr.Dataset, kind: str) -> Iterator[Problem]:
    try:
        check_dataset(dataset, kind)
    except RecordingError as error:
        yield from (Problem(f"{kind}.{entry.path}", entry.message, entry.value) for entry in error.problems)
    if "t" in dataset.dims and ("t" not in dataset.coords or not dataset.indexes["t"].is_unique):
        yield Problem(f"{kind}.t", "must be a coordinate with unique values")
    if "s_y" in dataset.dims and ("s_y" not in dataset.coords or list(dataset["s_y"].values).count(0) != 1):
        yield Problem(f"{kind}.s_y", "must hold the reference row s_y = 0 exactly once")
    if "s" not in dataset.dims:
        return
    if kind == "estimate":
        # Quantities of the cameras themselves have no pixels.
        if any({"s", "x"} <= set(item.dims) for item in dataset.data_vars.values()):
            message = "must not be a dimension of maps; an estimate belongs to the reference camera"
            yield Problem("estimate.s", message)
    elif "s" not in dataset.coords or list(dataset["s"].values).count(0) != 1:
        yield Problem(f"{kind}.s", "must hold the reference camera s = 0 exactly once")


def _frame_problems(estimate: xr.Dataset, truth: xr.Dataset) -> Iterator[Problem]:
    missing = sorted(set(estimate["t"].values.tolist()) - set(truth["t"].values.tolist()))
    if missing:
        yield Problem("t", "the truth lacks frames of the estimate", missing)


def _named_dims(dataset: xr.Dataset, estimate: xr.Dataset) -> list[str]:
    """Return which of y and x have coordinates in both data sets; the others are matched by index."""
    return [dim for dim in ("y", "x") if dim in dataset.coords and dim in estimate.coords]


def _pixel_problems(estimate: xr.Dataset, other: xr.Dataset, kind: str) -> Iterator[Problem]:
    """Report the pixels of an estimate that are missing from the other data set, a ``kind``."""
    named = _named_dims(other, estimate)
    for dim, lines in (("y", "rows"), ("x", "columns")):
        path = f"{kind}.{dim}"
        here, there = estimate.sizes[dim], other.sizes[dim]
        if dim not in named:
            if here != there:
                message = (
                    f"has the size {there}, the estimate {here}; to compare a part of the image, both must have the "
                    f"coordinate {dim}"
                )
                yield Problem(path, message)
        elif not other.indexes[dim].is_unique:
            yield Problem(path, f"must be unique; pixel {lines} are duplicated")
        else:
            missing = sorted(set(estimate[dim].values.tolist()) - set(other[dim].values.tolist()))
            if missing:
                message = f"lacks pixel {lines} of the estimate; both must be counted from the corner of the full image"
                yield Problem(path, message, missing)


def _intrinsics_problems(estimate: xr.Dataset, truth: xr.Dataset) -> Iterator[Problem]:
    here, there = read_intrinsics(estimate).to_attrs(), read_intrinsics(truth).to_attrs()
    for name, value in here.items():
        if not np.allclose(value, there[name], rtol=_RELATIVE_TOLERANCE, atol=_RELATIVE_TOLERANCE):
            yield Problem(f"attrs.{name}", f"the estimate's {value} differs from the truth's {there[name]}")


_PIXELS = 1_500_000
"""Largest number of pixels in a block of frames; a frame is never divided."""


def count_blocks(estimate: xr.Dataset) -> int:
    """Return the number of blocks that `iterate_aligned_blocks` yields."""
    return -(-estimate.sizes["t"] // _frames(estimate))


def iterate_aligned_blocks(estimate: xr.Dataset, truth: xr.Dataset) -> Iterator[tuple[xr.Dataset, xr.Dataset]]:
    """Yield blocks of successive frames of an estimate, each with the aligned part of the truth."""
    for part in iterate_blocks(estimate):
        yield align(part, truth)


def iterate_blocks(estimate: xr.Dataset) -> Iterator[xr.Dataset]:
    """Yield blocks of successive frames of an estimate."""
    count = _frames(estimate)
    for first in range(0, estimate.sizes["t"], count):
        yield estimate.isel(t=slice(first, first + count))


def _frames(estimate: xr.Dataset) -> int:
    return max(1, _PIXELS // max(1, estimate.sizes["y"] * estimate.sizes["x"]))
