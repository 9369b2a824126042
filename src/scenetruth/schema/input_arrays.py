"""Validation and copying of user-supplied arrays, numbers, attributes and exclusion masks."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.lazy_exports import lazy_module
from scenetruth.schema.outline import DatasetOutline
from scenetruth.schema.variables import describe_variable

if TYPE_CHECKING:
    import xarray as xr
else:
    xr = lazy_module("xarray")

__all__ = [
    "attributes_from",
    "copy_array",
    "exclusion_mask_from",
    "exclusion_mask_problems",
    "images_from",
    "noise_share_problems",
    "number_from",
    "numbers_from",
    "order_problems",
    "pair_from",
    "real_array",
    "without_repeats",
]


def real_array(name: str, values: Any, problems: list[Problem], *, masked_is_nan: bool = False) -> NDArray[Any] | None:
    """Return an array of real numbers without copying, or None after appending a problem."""
    try:
        masked = np.ma.isMaskedArray(values) and bool(np.ma.getmaskarray(values).any())
        if masked and masked_is_nan and values.dtype.kind in "fiu":
            return np.asarray(values.astype(np.float64).filled(np.nan))
        raw = np.asarray(values)
    except MemoryError:
        raise
    except Exception as error:  # array-like classes may raise any exception, for example for rows of different lengths
        problems.append(Problem(name, f"cannot be made into an array of numbers: {' '.join(str(error).split())}"))
        return None
    if masked:
        problems.append(Problem(name, "has masked values; fill them or select a part without masked values"))
        return None
    if raw.dtype.kind not in "fiu":
        text = "None" if values is None else str(raw.dtype)
        problems.append(Problem(name, "must hold real numbers", text))
        return None
    # Stores support at most 64 bits.
    return raw.astype(np.float64) if raw.dtype.kind == "f" and raw.dtype.itemsize > 8 else raw


_IMAGE_DIMS = ("s_y", "s", "t", "y", "x", "channel")
_MOST_CHANNELS = 16


def images_from(
    images: Any, *, grid: bool, problems: list[Problem]
) -> tuple[NDArray[Any] | None, NDArray[np.bool_] | None]:
    """Return images in the order ([s_y, ]s, t, y, x[, channel]) and their mask, or None after appending a problem.

    Labelled arrays are put into this order by the names of their dimensions. Masked arrays have their mask, without
    channels; arrays of Dask are computed.
    """
    if isinstance(images, xr.DataArray | xr.Variable):
        unknown = [str(dim) for dim in images.dims if dim not in _IMAGE_DIMS]
        wanted = [dim for dim in _IMAGE_DIMS if dim in images.dims or dim in ("s", "t")]
        if unknown or not {"y", "x"} <= set(images.dims) or ("s_y" in images.dims and not grid):
            expected = f"must have the dimensions {', '.join(_IMAGE_DIMS[not grid :])}; channel, s and t may be missing"
            problems.append(Problem("images", expected, images.dims))
            return None, None
        disordered = order_problems("images", images)
        if disordered:
            problems += disordered
            return None, None
        missing = [dim for dim in wanted if dim not in images.dims]
        images = xr.DataArray(images.data, dims=images.dims).expand_dims(missing).transpose(*wanted).data
    mask = None
    if np.ma.isMaskedArray(images):
        mask = np.array(np.ma.getmaskarray(images))
        images = np.asarray(np.ma.getdata(images))
    elif not hasattr(images, "shape"):
        found = _differing_images(images, depth=2 + grid)
        if found:
            problems.append(Problem("images", found))
            return None, None
    values = real_array("images", images, problems)
    if values is None:
        return None, None
    if values.ndim - grid not in (4, 5) or 0 in values.shape:
        names = ", ".join(_IMAGE_DIMS[not grid : -1])
        message = f"must be a non-empty array with the dimensions ({names}) or ({names}, channel)"
        problems.append(Problem("images", message, values.shape))
        return None, None
    if values.ndim - grid == 5 and values.shape[-1] > _MOST_CHANNELS:
        place = next((n for n in range(values.ndim) if values.shape[n] in (3, 4) and n > grid), None)
        remedy = "channels come last" if place is None else f"channels come last: use np.moveaxis(images, {place}, -1)"
        message = f"would have {values.shape[-1]} channels; {remedy}"
        problems.append(Problem("images", message, values.shape))
        return None, None
    if mask is not None:
        mask = np.asarray(mask.any(axis=-1)) if mask.ndim - grid == 5 else mask
        mask = mask if mask.any() else None
    return values, mask


def order_problems(name: str, values: xr.DataArray | xr.Variable) -> list[Problem]:
    """Return dimensions whose labels contradict their order: indices, or times, that do not increase.

    Labels of x and y count where they are indices of pixels; others may be lengths that increase upwards.
    """
    found = []
    for dim in values.dims:
        if not isinstance(values, xr.DataArray) or dim not in values.coords or values.sizes[dim] < 2:
            continue
        labels = values.coords[dim].values
        if labels.dtype.kind not in "iufM" or labels.ndim != 1:
            continue
        steps = np.diff(labels).astype(np.float64)
        if dim in ("x", "y") and not (np.abs(steps) == 1).all():
            continue
        if not (steps > 0).all():
            sort = f"sort it, {name}.sortby({str(dim)!r}), or drop the labels, {name}.drop_vars({str(dim)!r})"
            message = f"has labels of {dim} that do not increase, so that its order is not certain: {sort}"
            found.append(Problem(name, message, [str(label) for label in labels[:5]]))
    return found


def _differing_images(images: Any, depth: int) -> str:
    """Return which images of nested lists are missing or have another shape than most; empty if none."""
    names = _IMAGE_DIMS[3 - depth : 3]
    entries: list[tuple[str, Any]] = [("", images)]
    for name in names:
        if not all(isinstance(each, list | tuple) for _, each in entries):
            return ""
        lengths = [len(each) for _, each in entries]
        if len(set(lengths)) > 1:
            return _differing_lengths(name, [place for place, _ in entries], lengths)
        entries = [(f"{place}{', ' if place else ''}{name} = {n}", own)
                   for place, each in entries for n, own in enumerate(each)]  # fmt: skip
    shapes = [() if image is None else np.shape(image) if _is_regular(image) else None for _, image in entries]
    if len(set(shapes)) <= 1:
        return ""
    usual = max(set(shapes) - {(), None}, key=shapes.count, default=())
    wrong = [f"({place}) " + ("is missing" if not shape else f"has the shape {shape}")
             for (place, _), shape in zip(entries, shapes, strict=True) if shape != usual]  # fmt: skip
    listed = "; ".join(wrong[:5]) + (f"; and {len(wrong) - 5} more" if len(wrong) > 5 else "")
    return (
        f"must all have the same shape; most have {usual}, and the one at {listed}. Fill missing images with NaN, or "
        "with zeros and an exclusion_mask that is True"
    )


def _differing_lengths(name: str, places: list[str], lengths: list[int]) -> str:
    """Return which of several lists have fewer or more images than most."""
    usual = max(set(lengths), key=lambda length: (lengths.count(length), length))
    wrong = [f"{place or 'one'} has {length}" for place, length in zip(places, lengths, strict=True) if length != usual]
    listed = "; ".join(wrong[:5]) + (f"; and {len(wrong) - 5} more" if len(wrong) > 5 else "")
    what = "images (t)" if name == "t" else "positions (s)"
    return (
        f"cannot be made into an array: their number of {what} must be the same everywhere; most have {usual}, and "
        f"{listed}. Fill missing images with NaN, or with zeros and an exclusion_mask that is True"
    )


def _is_regular(image: Any) -> bool:
    try:
        np.asarray(image, dtype=np.float64)
    except (ValueError, TypeError):
        return False
    return True


def copy_array(values: NDArray[Any]) -> NDArray[Any]:
    """Return a copy; dimensions with stride zero stay broadcast."""
    return np.broadcast_to(without_repeats(values).copy(), values.shape) if 0 in values.strides else values.copy()


def without_repeats(values: NDArray[Any]) -> NDArray[Any]:
    """Return a view without the repetitions along dimensions with stride zero."""
    return values[tuple(slice(1) if stride == 0 else slice(None) for stride in values.strides)]


def number_from(
    name: str, value: Any, problems: list[Problem], *, positive: bool = False, nonzero: bool = False
) -> float:
    """Return a finite number, or NaN after appending a problem."""
    given = value.item() if isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "fiu" else value
    real = isinstance(given, int | float | np.integer | np.floating) and not isinstance(given, bool)
    try:
        number = float(given) if real else np.nan
    except OverflowError:
        number = np.inf
    if not np.isfinite(number):
        # Problems do not display a value of None.
        problems.append(Problem(name, "must be a finite number", "None" if value is None else value))
        return np.nan
    if (positive and number <= 0) or (nonzero and number == 0):
        problems.append(Problem(name, "must be positive" if positive else "must not be zero", value))
        return np.nan
    return number


def pair_from(name: str, values: Any, problems: list[Problem]) -> tuple[float, float]:
    """Return two finite numbers, or NaN after appending a problem."""
    listed = isinstance(values, list | tuple | np.ndarray) and getattr(values, "ndim", 1) == 1
    if not listed or len(values) != 2:
        problems.append(Problem(name, "must be two finite numbers", values))
        return np.nan, np.nan
    first, second = (number_from(f"{name}.{index}", value, problems) for index, value in enumerate(values))
    return first, second


def numbers_from(name: str, values: Any, count: int, of_what: str, problems: list[Problem]) -> NDArray[np.float64]:
    """Return a copied array of ``count`` finite numbers, or append a problem."""
    raw = real_array(name, values, problems)
    if raw is None:
        return np.zeros(count)
    if raw.shape != (count,):
        problems.append(Problem(name, f"must hold one position for each of the {count} {of_what}", raw.shape))
        return np.zeros(count)
    if not np.isfinite(raw).all():
        problems.append(Problem(name, "must be finite", raw.tolist()))
    return np.array(raw, dtype=np.float64)


def attributes_from(values: Any, reserved: frozenset[str], problems: list[Problem]) -> dict[str, Any]:
    """Return a copy of the attributes; reserved names are rejected."""
    if values is None:
        return {}
    if not isinstance(values, Mapping) or not all(isinstance(name, str) for name in values):
        problems.append(Problem("attrs", "must be a mapping with string keys", values))
        return {}
    taken = sorted(reserved & set(values))
    if taken:
        problems.append(Problem("attrs", f"must not contain {', '.join(taken)}: use the arguments of these names"))
    return {name: deepcopy(value) for name, value in values.items() if name not in reserved}


_BOOLEANS = "must be boolean, True where a pixel must not be used; use a comparison such as exclusion_mask=values > 0"


def exclusion_mask_from(values: Any, sizes: Mapping[str, int], problems: list[Problem]) -> xr.Variable | None:
    """Return a copy of an exclusion mask with named dimensions, or None after appending a problem.

    ``values``: Array of shape (y, x), of all ``sizes`` except t, or of all ``sizes``, where leading dimensions may be
      1; or a DataArray with y, x and any other image dimensions.

    >>> sizes = {"s": 2, "t": 9, "y": 3, "x": 4}
    >>> exclusion_mask_from(np.zeros((2, 3, 4), dtype=bool), sizes, []).dims
    ('s', 'y', 'x')
    >>> exclusion_mask_from(np.zeros((1, 9, 3, 4), dtype=bool), sizes, []).dims
    ('t', 'y', 'x')
    """
    every = tuple(sizes)
    attrs = describe_variable("recording", "exclusion_mask")
    if isinstance(values, xr.DataArray | xr.Variable):
        dims = tuple(dim for dim in every if dim in values.dims)
        unknown = sorted(str(dim) for dim in values.dims if dim not in every)
        if unknown or dims[-2:] != every[-2:]:
            problems.append(
                Problem("exclusion_mask", f"must have the dimensions y and x, and any of {every}", values.dims)
            )
            return None
        disordered = order_problems("exclusion_mask", values)
        if disordered:
            problems += disordered
            return None
        found = np.array(values.transpose(*dims).values)
    else:
        try:
            found = np.array(values)
        except ValueError as error:  # rows of different lengths
            problems.append(Problem("exclusion_mask", f"cannot be made into an array: {' '.join(str(error).split())}"))
            return None
        forms = {2: every[-2:], len(every) - 1: tuple(dim for dim in every if dim != "t"), len(every): every}
        if found.ndim not in forms:
            shapes = ", ".join(f"({', '.join(form)})" for form in forms.values())
            problems.append(Problem("exclusion_mask", f"must have one of the shapes {shapes}", found.shape))
            return None
        dims = forms[found.ndim]
        if found.ndim == len(every):
            # A dimension of size 1 is constant along that dimension.
            same = [n for n, dim in enumerate(every[:-2]) if found.shape[n] == 1 and sizes[dim] > 1]
            found, dims = found.squeeze(tuple(same)), tuple(dim for n, dim in enumerate(every) if n not in same)
    if found.dtype != np.bool_:
        problems.append(Problem("exclusion_mask", _BOOLEANS, str(found.dtype)))
        return None
    expected = tuple(sizes[dim] for dim in dims)
    if found.shape != expected:
        problems.append(
            Problem(
                "exclusion_mask",
                f"must have the shape {expected} of the images in {dims}",
                found.shape,
            )
        )
        return None
    return xr.Variable(dims, found, attrs)


def exclusion_mask_problems(recording: xr.Dataset | DatasetOutline) -> list[Problem]:
    """Return the problems of a recording's exclusion mask."""
    mask = recording.variables["exclusion_mask"]
    problems = []
    if mask.dtype != np.bool_:
        problems.append(Problem("exclusion_mask", _BOOLEANS, str(mask.dtype)))
    return problems + _dimension_problems(recording, "exclusion_mask")


def noise_share_problems(recording: xr.Dataset | DatasetOutline) -> list[Problem]:
    """Return the problems of a recording's noise share."""
    share = recording.variables["noise_share"]
    problems = _dimension_problems(recording, "noise_share")
    if share.dtype.kind != "f":
        problems.append(Problem("noise_share", "must hold floats above 0 and up to 1", str(share.dtype)))
    return problems


def _dimension_problems(recording: xr.Dataset | DatasetOutline, name: str) -> list[Problem]:
    """Return the problems of the dimensions of a variable that may lack some of those of the images."""
    dims = recording.variables[name].dims
    image = recording.variables["image"].dims if "image" in recording else ("s_y", "s", "t", "y", "x")
    # A single selected image lacks the dimensions s and t.
    allowed = tuple(dim for dim in image if dim != "channel")
    if tuple(dim for dim in allowed if dim in dims) == dims and {"y", "x"} <= set(dims):
        return []
    message = f"must have the dimensions y and x, and any others of {allowed}, in this order"
    return [Problem(name, message, dims)]
