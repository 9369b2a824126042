"""Whether a data set has the agreed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from scenetruth.errors import Problem, RecordingError
from scenetruth.schema.attribute_types import attribute_problems, is_finite_number
from scenetruth.schema.masking import mask_problems
from scenetruth.schema.pixels import pixel_grid_problems
from scenetruth.schema.variables import REQUIRED, REQUIRED_ANY, VARIABLES

__all__ = ["check_dataset"]


def check_dataset(dataset: xr.Dataset, kind: str) -> None:
    """Check that a data set has the agreed form.

    Parameters
    ----------
    dataset
        The data set.
    kind
        ``"recording"``, ``"truth"`` or ``"estimate"``.

    Raises
    ------
    RecordingError
        With every deviation: missing variables, wrong dimensions, missing or impossible intrinsics; of a
        recording also pixels that are no even grid, and a mask that does not fit its images.
    """
    if not isinstance(dataset, xr.Dataset):
        raise RecordingError([Problem("", "must be an xarray.Dataset", type(dataset).__name__)], source=kind)
    problems = [*_variable_problems(dataset, kind), *_intrinsics_problems(dataset), *attribute_problems(dataset)]
    if kind == "recording":
        problems += [*_image_problems(dataset), *pixel_grid_problems(dataset)]
    if problems:
        raise RecordingError(problems, source=kind)


def _variable_problems(dataset: xr.Dataset, kind: str) -> list[Problem]:
    problems = [
        Problem(name, f"is missing; a {kind} must have it", sorted(map(str, dataset.data_vars)))
        for name in REQUIRED[kind]
        if name not in dataset
    ]
    any_of = REQUIRED_ANY.get(kind, ())
    if any_of and not any(name in dataset for name in any_of):
        *most, last = any_of
        problems.append(
            Problem(
                "variables",
                f"hold neither {', '.join(most)} nor {last}; at least one of them must be there",
                sorted(map(str, dataset.data_vars)),
            )
        )
    for name, entry in VARIABLES[kind].items():
        if name not in dataset:
            continue
        if (kind, name) == ("recording", "mask"):
            problems += mask_problems(dataset)
            continue
        dims = tuple(map(str, dataset.variables[name].dims))
        if kind == "recording" and dims[-1:] == ("channel",):
            dims = dims[:-1]
        # A truth may be that of one camera or of all; a recording needs its cameras.
        views = ("s_y",) if kind == "recording" else ("s_y", "s")
        found, needed = (tuple(dim for dim in names if dim not in views) for names in (dims, entry.dims))
        if found != needed:
            problems.append(Problem(name, f"must have the dimensions {entry.dims}", dims))
        dtype = dataset.variables[name].dtype
        if dtype.kind not in "fiub":
            problems.append(Problem(name, "must hold real numbers", str(dtype)))
    for name in ("t", "s", "s_y"):
        if name in dataset.coords:
            numbers = dataset.variables[name]
            if numbers.dtype.kind not in "iu" or numbers.ndim > 1:
                problems.append(Problem(name, "must hold integers, 0 the reference", str(numbers.dtype)))
    return problems


def _intrinsics_problems(dataset: xr.Dataset) -> list[Problem]:
    problems = []
    for name, positive in (("focal_length_px", True), ("baseline_mm", False), ("frame_interval_s", True)):
        value = dataset.attrs.get(name)
        if not is_finite_number(value):
            problems.append(Problem(f"attrs.{name}", "must be a finite number", value))
        elif positive and float(value or 0) <= 0:
            problems.append(Problem(f"attrs.{name}", "must be positive", value))
        elif value == 0 and dataset.sizes.get("s", 1) > 1:
            problems.append(
                Problem(f"attrs.{name}", "must not be zero: depth cannot be seen without a baseline", value)
            )
    point: Any = dataset.attrs.get("principal_point_px")
    two = isinstance(point, list | tuple | np.ndarray) and getattr(point, "ndim", 1) == 1 and len(point) == 2
    if not (two and all(map(is_finite_number, point))):
        problems.append(Problem("attrs.principal_point_px", "must be two finite numbers (c_x, c_y)", point))
    return problems


def _image_problems(dataset: xr.Dataset) -> list[Problem]:
    problems = []
    full_scale = dataset.attrs.get("full_scale")
    if not (is_finite_number(full_scale) and float(full_scale or 0) > 0):
        problems.append(Problem("attrs.full_scale", "must be a positive number", full_scale))
    if "image" not in dataset:
        return problems
    image = dataset.variables["image"]
    problems += [
        Problem(name, "is missing; the images need this coordinate", sorted(map(str, dataset.coords)))
        for name in ("s", "t", "stage_x_mm", *(("s_y", "stage_y_mm") if "s_y" in image.dims else ()))
        if name not in dataset.coords
    ]
    if image.dtype.kind == "b":
        problems.append(Problem("image", "must hold real numbers", str(image.dtype)))
    for name in ("s_y", "s", "t"):
        if name in dataset.coords and name in image.dims:
            values = dataset.variables[name].values
            if values.dtype.kind in "iu" and (0 not in values or np.any(np.diff(values.astype(np.int64)) != 1)):
                problems.append(Problem(name, "must be consecutive integers with 0 the reference", values.tolist()))
    for name in ("stage_x_mm", "stage_y_mm"):
        if name in dataset.coords:
            values = dataset.variables[name].values
            if values.dtype.kind not in "fiu" or not np.all(np.isfinite(values)):
                problems.append(Problem(name, "must hold finite numbers", values.tolist()))
    return problems
