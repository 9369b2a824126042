"""Bringing an estimate and a truth to the same camera, frames and pixels before they are compared."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr

from scenetruth.errors import Problem, RecordingError, ScoreError
from scenetruth.schema import check_dataset, intrinsics_of

__all__ = ["align", "check_recording"]

_RELATIVE_TOLERANCE = 1e-6
"""How far intrinsics may differ; enough for numbers that once were float32."""


def align(estimate: xr.Dataset, truth: xr.Dataset) -> tuple[xr.Dataset, xr.Dataset]:
    """Return an estimate and the part of the truth that it can be compared with.

    Parameters
    ----------
    estimate
        An estimate for the reference camera, dimensions (t, y, x).
    truth
        The truth of the reference camera, dimensions (t, y, x), or of all cameras, (s, t, y, x), of which s = 0 is
        taken. It may have more frames than the estimate.

    Returns
    -------
    tuple of xarray.Dataset
        The estimate, and the truth at s = 0 and at the estimate's frames.

    Raises
    ------
    ScoreError
        If either does not have the agreed form, or the two differ in frames, size, pixels or intrinsics; lists all
        that is wrong.
    """
    problems = [*_form_problems(estimate, "estimate"), *_form_problems(truth, "truth")]
    if problems:
        raise ScoreError(problems)
    problems = [
        *_frame_problems(estimate, truth),
        *_pixel_problems(estimate, truth),
        *_intrinsics_problems(estimate, truth),
    ]
    if problems:
        raise ScoreError(problems)
    reference = truth.sel({dim: 0 for dim in ("s_y", "s") if dim in truth.dims})
    return estimate, reference.sel(t=estimate["t"].values)


def check_recording(recording: xr.Dataset, estimate: xr.Dataset) -> None:
    """Check that a recording has the agreed form and the size of an estimate.

    Raises
    ------
    ScoreError
        If not; lists all that is wrong.
    """
    problems = [*_form_problems(recording, "recording")]
    if not problems:
        problems = [
            Problem(f"recording.{dim}", f"has the size {recording.sizes[dim]}, the estimate {estimate.sizes[dim]}")
            for dim in ("y", "x")
            if recording.sizes[dim] != estimate.sizes[dim]
        ]
    if problems:
        raise ScoreError(problems)


def _form_problems(dataset: xr.Dataset, kind: str) -> Iterator[Problem]:
    try:
        check_dataset(dataset, kind)
    except RecordingError as error:
        yield from (Problem(f"{kind}.{entry.path}", entry.message, entry.value) for entry in error.problems)
    if "t" in dataset.dims and ("t" not in dataset.coords or not dataset.indexes["t"].is_unique):
        yield Problem(f"{kind}.t", "must be a coordinate that tells the frames apart")
    if "s_y" in dataset.dims and ("s_y" not in dataset.coords or list(dataset["s_y"].values).count(0) != 1):
        yield Problem(f"{kind}.s_y", "must hold the reference row s_y = 0 once")
    if "s" not in dataset.dims:
        return
    if kind == "estimate":
        yield Problem("estimate.s", "must not be a dimension; an estimate belongs to the reference camera")
    elif "s" not in dataset.coords or list(dataset["s"].values).count(0) != 1:
        yield Problem(f"{kind}.s", "must hold the reference camera s = 0 once")


def _frame_problems(estimate: xr.Dataset, truth: xr.Dataset) -> Iterator[Problem]:
    missing = sorted(set(estimate["t"].values.tolist()) - set(truth["t"].values.tolist()))
    if missing:
        yield Problem("t", "the truth lacks frames of the estimate", missing)


def _pixel_problems(estimate: xr.Dataset, truth: xr.Dataset) -> Iterator[Problem]:
    for dim in ("y", "x"):
        here, there = estimate.sizes[dim], truth.sizes[dim]
        if here != there:
            yield Problem(dim, f"the estimate's size {here} differs from the truth's size {there}")
        elif (
            dim in estimate.coords
            and dim in truth.coords
            and not np.array_equal(estimate[dim].values, truth[dim].values)
        ):
            yield Problem(dim, "the estimate's pixel indices differ from the truth's")


def _intrinsics_problems(estimate: xr.Dataset, truth: xr.Dataset) -> Iterator[Problem]:
    here, there = intrinsics_of(estimate).to_attrs(), intrinsics_of(truth).to_attrs()
    for name, value in here.items():
        if not np.allclose(value, there[name], rtol=_RELATIVE_TOLERANCE, atol=_RELATIVE_TOLERANCE):
            yield Problem(f"attrs.{name}", f"the estimate's {value} differs from the truth's {there[name]}")
