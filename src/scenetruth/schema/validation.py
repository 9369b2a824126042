"""Validation of data sets: variables, dimensions, coordinates and attribute types."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from scenetruth.errors import Problem, RecordingError
from scenetruth.lazy_exports import lazy_module
from scenetruth.plain_data import parse_json, plain_problems
from scenetruth.schema.acquisition import acquisition_problems, is_finite_number
from scenetruth.schema.input_arrays import exclusion_mask_problems, noise_share_problems
from scenetruth.schema.outline import DatasetOutline
from scenetruth.schema.pixel_grid import pixel_grid_problems
from scenetruth.schema.variables import DEMOSAICING, REQUIRED, REQUIRED_ANY, VARIABLES

if TYPE_CHECKING:
    import xarray as xr
else:
    xr = lazy_module("xarray")

__all__ = ["check_dataset"]


_MAPPINGS_IN_JSON = ("scene", "versions", "settings")
_TEXTS = ("scene_hash", "recording_hash", "estimate_hash", "method", "render_backend", "truth_poses")


def attribute_problems(dataset: xr.Dataset | DatasetOutline) -> list[Problem]:
    """Return the problems of the optional attributes that are present."""
    attrs = dataset.attrs
    problems = [
        Problem(f"attrs.{name}", "must be text", attrs[name])
        for name in _TEXTS
        if name in attrs and not isinstance(attrs[name], str)
    ]
    for name in _MAPPINGS_IN_JSON:
        if name in attrs:
            problems += _json_problems(f"attrs.{name}", attrs[name], dict)
    if "object_names" in attrs:
        problems += _json_problems("attrs.object_names", attrs["object_names"], list)
    reason, seed = attrs.get("render_fallback_reason"), attrs.get("seed")
    if not (reason is None or isinstance(reason, str)):
        problems.append(Problem("attrs.render_fallback_reason", "must be text", reason))
    if not (seed is None or (isinstance(seed, int | np.integer) and not isinstance(seed, bool) and seed >= 0)):
        problems.append(Problem("attrs.seed", "must be a non-negative integer", seed))
    return problems


def _json_problems(path: str, text: Any, kind: type[Any]) -> list[Problem]:
    named = "a mapping" if kind is dict else "a list of texts"
    if not isinstance(text, str):
        return [Problem(path, f"must be {named} in JSON", "None" if text is None else text)]
    try:
        content = parse_json(text)
    except ValueError as error:
        return [Problem(path, f"must be {named} in JSON, but cannot be read: {error}", text)]
    if not isinstance(content, kind):
        return [Problem(path, f"must be {named} in JSON", text)]
    if kind is list and not all(isinstance(item, str) for item in content):
        return [Problem(path, f"must be {named} in JSON", text)]
    problems = [Problem(f"{path}.{item.path}", item.message, item.value) for item in plain_problems(content)]
    if path.endswith(".scene"):
        problems += [
            Problem(f"{path}.{name}", f"must be {'a mapping' if wanted is Mapping else 'text'}", content[name])
            for name, wanted in (("estimate", Mapping), ("score", Mapping), ("description", str))
            if content.get(name) is not None and not isinstance(content[name], wanted)
        ]
    return problems


def check_dataset(dataset: xr.Dataset | DatasetOutline, kind: str) -> None:
    """Raise a RecordingError that lists every violation of the data model."""
    if not isinstance(dataset, DatasetOutline) and not isinstance(dataset, xr.Dataset):
        raise RecordingError([Problem("", "must be an xarray.Dataset", type(dataset).__name__)], source=kind)
    problems = [*_variable_problems(dataset, kind), *_intrinsics_problems(dataset), *attribute_problems(dataset)]
    if kind == "recording":
        problems += [*_image_problems(dataset), *pixel_grid_problems(dataset), *acquisition_problems(dataset)]
    if problems:
        raise RecordingError(problems, source=kind)


def _variable_problems(dataset: xr.Dataset | DatasetOutline, kind: str) -> list[Problem]:
    problems = [
        Problem(name, f"is missing; required in a {kind}", sorted(map(str, dataset.data_vars)))
        for name in REQUIRED[kind]
        if name not in dataset
    ]
    any_of = REQUIRED_ANY.get(kind, ())
    if any_of and not any(name in dataset for name in any_of):
        *most, last = any_of
        problems.append(
            Problem(
                "variables",
                f"hold neither {', '.join(most)} nor {last}; at least one is required",
                sorted(map(str, dataset.data_vars)),
            )
        )
    for name, entry in VARIABLES[kind].items():
        if name not in dataset:
            continue
        if (kind, name) == ("recording", "exclusion_mask"):
            problems += exclusion_mask_problems(dataset)
            continue
        if (kind, name) == ("recording", "noise_share"):
            problems += noise_share_problems(dataset)
            continue
        dims = tuple(map(str, dataset.variables[name].dims))
        if kind == "recording" and dims[-1:] == ("channel",):
            dims = dims[:-1]
        if entry.by_band and dims[:1] == ("channel",):
            dims = dims[1:]
        # Ground truth may have one camera or all; a recording requires the camera dimension.
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
                problems.append(Problem(name, "must hold integers with 0 as the reference", str(numbers.dtype)))
    return problems


def _intrinsics_problems(dataset: xr.Dataset | DatasetOutline) -> list[Problem]:
    problems = []
    for name, positive in (("focal_length_px", True), ("baseline_mm", False), ("frame_interval_s", True)):
        value = dataset.attrs.get(name)
        if not is_finite_number(value):
            problems.append(Problem(f"attrs.{name}", "must be a finite number", value))
        elif positive and float(value or 0) <= 0:
            problems.append(Problem(f"attrs.{name}", "must be positive", value))
        elif value == 0 and dataset.sizes.get("s", 1) > 1:
            problems.append(Problem(f"attrs.{name}", "must not be zero; depth needs a baseline", value))
    point: Any = dataset.attrs.get("principal_point_px")
    two = isinstance(point, list | tuple | np.ndarray) and getattr(point, "ndim", 1) == 1 and len(point) == 2
    if not (two and all(map(is_finite_number, point))):
        problems.append(Problem("attrs.principal_point_px", "must be two finite numbers (c_x, c_y)", point))
    return problems


def _image_problems(dataset: xr.Dataset | DatasetOutline) -> list[Problem]:
    problems = []
    full_scale = dataset.attrs.get("full_scale")
    if not (is_finite_number(full_scale) and float(full_scale or 0) > 0):
        problems.append(Problem("attrs.full_scale", "must be a positive number", full_scale))
    demosaicing = dataset.attrs.get("demosaicing")
    if demosaicing is not None and not (isinstance(demosaicing, str) and demosaicing in DEMOSAICING):
        message = f"must be {' or '.join(DEMOSAICING)}; omit it for images that were not demosaiced"
        problems.append(Problem("attrs.demosaicing", message, demosaicing))
    if "image" not in dataset:
        return problems
    image = dataset.variables["image"]
    problems += [
        Problem(name, "is missing; coordinate required for the images", sorted(map(str, dataset.coords)))
        for name in ("s", "t", "stage_x_mm", *(("s_y", "stage_y_mm") if "s_y" in image.dims else ()))
        if name not in dataset.coords
    ]
    if image.dtype.kind == "b":
        problems.append(Problem("image", "must hold real numbers", str(image.dtype)))
    for name in ("s_y", "s", "t"):
        if name in dataset.coords and name in image.dims:
            values = dataset.variables[name].values
            if values.dtype.kind in "iu" and (0 not in values or np.any(np.diff(values.astype(np.int64)) != 1)):
                problems.append(Problem(name, "must be consecutive integers with 0 as the reference", values.tolist()))
    for name in ("stage_x_mm", "stage_y_mm"):
        if name in dataset.coords:
            values = dataset.variables[name].values
            if values.dtype.kind not in "fiu" or not np.all(np.isfinite(values)):
                problems.append(Problem(name, "must hold finite numbers", values.tolist()))
    return problems
