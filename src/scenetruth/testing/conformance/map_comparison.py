"""Comparison of two estimates, map by map, and the failure of a check."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import Any
from unittest import SkipTest

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import STATUS_VALID, VARIABLES

__all__ = [
    "FLOOR",
    "MIN_RETAINED_FRACTION",
    "CheckFailure",
    "Maps",
    "NotApplicable",
    "change_sign",
    "compute_magnitude",
    "compute_rms",
    "flip_maps",
    "list_differing_variables",
    "require_agreement",
    "require_equal_to_rounding",
    "require_median_near",
    "scalar_maps",
]


class CheckFailure(AssertionError):
    """What a method does otherwise than it should.

    ``done``: What was done to the recording or asked of the method.
    ``expected``: What should have followed.
    ``found``: What followed, with numbers and units.
    ``remedy``: What to mend.
    """

    def __init__(self, done: str, expected: str, found: str, remedy: str) -> None:
        self.done, self.expected, self.found, self.remedy = done, expected, found, remedy
        super().__init__(done, expected, found, remedy)

    def __str__(self) -> str:
        parts = (("done", self.done), ("expected", self.expected), ("found", self.found), ("remedy", self.remedy))
        return "\n".join(f"{name + ':':9} {text}" for name, text in parts)


class NotApplicable(SkipTest):
    """Why a check says nothing of a method; runners of tests count it as skipped."""


Array = NDArray[np.float64]
Maps = Mapping[str, xr.DataArray]
"""Maps of single numbers, dimensions (t, y, x), float64, NaN where nothing is fully known."""

_SCALARS: Mapping[str, tuple[str, int | None]] = {
    "depth": ("depth", None),
    "disparity": ("disparity", None),
    "flow_x": ("flow", 0),
    "flow_y": ("flow", 1),
    "velocity_x": ("velocity", 0),
    "velocity_y": ("velocity", 1),
    "velocity_z": ("velocity", 2),
}
_STATUSES = {
    "depth": ("status_disparity",),
    "disparity": ("status_disparity",),
    "flow": ("status_motion",),
    "velocity": ("status_disparity", "status_motion"),
}

FLOOR = 2e-3
"""What counts as nothing, as a share of a quantity: far above the rounding of float32 (6e-8) and of images of 16 bits
(1 / 65535 of the range of grey values, 1e-4 of a texture's contrast), far below what a slip of convention makes."""
MIN_RETAINED_FRACTION = 0.2
"""Share of the pixels known before that must be known still: borders move when images are mirrored, and methods that
work in blocks leave what is over at one side."""
_MEDIAN_LIMIT = 0.2
"""Error in the median, as a share of the true value's median, or of the flow's length. Poor methods stay below it on
these textures, which have no noise; a wrong sign makes 2, the whole baseline instead of a step 0.5, millimetres instead
of pixels far more."""
_SCATTER_PERCENT = (2.5, 97.5)
"""Between these percentiles of the estimates, the true velocity must lie if the median error is larger than that."""
_ROUNDING = 1e-4
"""Relative difference that rounding of float32 leaves after some thousand operations."""
_MOST_ROUNDED = 0.01
"""Share of pixels that may differ by more, where rounding has decided otherwise on a threshold."""


def scalar_maps(estimate: xr.Dataset) -> dict[str, xr.DataArray]:
    """Return what an estimate claims to know fully, component by component.

    Returns: ``depth`` (mm), ``disparity`` (px/step), ``flow_x`` and so on, of what the estimate holds.
    """
    found: dict[str, tuple[tuple[Hashable, ...], Array]] = {}
    for name, (variable, component) in _SCALARS.items():
        if variable not in estimate.variables:
            continue
        item = estimate.variables[variable]
        values = np.array(item.values if component is None else item.values[component], dtype=np.float64)
        # As in scores, `status` takes the place of either that is missing.
        for status in {one if one in estimate.variables else "status" for one in _STATUSES[variable]}:
            if status in estimate.variables:
                values[estimate.variables[status].values != STATUS_VALID] = np.nan
        values[~np.isfinite(values)] = np.nan
        found[name] = (item.dims if component is None else item.dims[1:], values)
    return build_maps(found, {dim: estimate.variables[dim].values for dim in ("t", "y", "x") if dim in estimate.coords})


def build_maps(
    arrays: Mapping[str, tuple[Sequence[Hashable], Array]], coordinates: Mapping[str, NDArray[Any]]
) -> dict[str, xr.DataArray]:
    """Return arrays with dimensions as maps that share their coordinates."""
    # All at once: to make a map by itself takes longer than most methods take for images of this size.
    together = xr.Dataset({name: (tuple(dims), values) for name, (dims, values) in arrays.items()}, dict(coordinates))
    return {name: together[name] for name in arrays}


def get_unit(name: str) -> str:
    """Return the unit of a map of `scalar_maps`."""
    return VARIABLES["estimate"][_SCALARS[name][0]].units


def compute_rms(values: Array) -> float:
    """Return the root of the mean square of what is finite; NaN if nothing is."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def compute_magnitude(truth: Maps, name: str) -> float:
    """Return how large a quantity is: the rms of the true value, of vectors that of their length."""
    base = _SCALARS[name][0]
    return float(np.sqrt(sum(compute_rms(truth[other].values) ** 2 for other in truth if _SCALARS[other][0] == base)))


def flip_maps(maps: Maps, dim: str) -> dict[str, xr.DataArray]:
    """Return maps in the opposite order along a dimension, under the coordinates in which they stood."""
    back = slice(None, None, -1)
    return {name: item.isel({dim: back}).assign_coords({dim: item[dim].values}) for name, item in maps.items()}


def change_sign(maps: Maps, names: Iterable[str]) -> dict[str, xr.DataArray]:
    """Return maps, some of them with the other sign."""
    other = set(names)
    return {name: -item if name in other else item for name, item in maps.items()}


def require_agreement(
    found: Maps,
    expected: Maps,
    tolerances: Mapping[str, float],
    *,
    done: str,
    expectation: str,
    remedy: str,
    least_kept: float = MIN_RETAINED_FRACTION,
) -> None:
    """Demand that maps agree within tolerances, and that most of what was known still is."""
    wrong, compared = [], False
    for name, limit in tolerances.items():
        if name not in found:
            wrong.append(f"no {name} any more")
            continue
        one, other = _common(found[name], expected[name])
        before = int(np.isfinite(other).sum())
        if not before:
            continue
        compared = True
        kept = int(np.isfinite(one - other).sum()) / before
        if kept < least_kept:
            wrong.append(f"{name} is known in {kept:.0%} of the pixels where it was ({least_kept:.0%} are asked for)")
        difference = compute_rms(one - other)
        if difference > limit:
            unit = get_unit(name)
            wrong.append(f"{name} is off by {difference:.3g} {unit} rms ({limit:.3g} {unit} are allowed)")
    if wrong:
        raise CheckFailure(done, expectation, "; ".join(wrong), remedy)
    if not compared:
        msg = "the two estimates have no frame in common that can be compared"
        raise NotApplicable(msg)


def require_equal_to_rounding(found: Maps, expected: Maps, *, done: str, expectation: str, remedy: str) -> None:
    """Demand that maps are the same but for rounding."""
    wrong = []
    for name, values in expected.items():
        if name not in found:
            wrong.append(f"no {name} any more")
            continue
        if found[name].shape != values.shape:
            wrong.append(f"{name} has the shape {found[name].shape}, not {values.shape}")
            continue
        one, other = found[name].values, values.values
        room = _ROUNDING * np.maximum(np.abs(other), compute_rms(other))
        with np.errstate(invalid="ignore"):
            same = (np.abs(one - other) <= room) | (np.isnan(one) & np.isnan(other))
        if (share := 1 - float(np.mean(same))) > _MOST_ROUNDED:
            unit, most = get_unit(name), compute_rms(one - other)
            wrong.append(f"{name} differs in {share:.0%} of the pixels, by {most:.3g} {unit} rms")
    if wrong:
        raise CheckFailure(done, expectation, "; ".join(wrong), remedy)


def require_median_near(found: Maps, truth: Maps, names: Iterable[str], *, done: str, remedy: str) -> None:
    """Demand that the median error is a small share of the true value: 20 %.

    Velocity, which is made of differences of depths, may be less certain: what methods find in sixteenths of a pixel is
    rounded to nothing or to everything. It must then scatter around the true value.
    """
    wrong = []
    for name in names:
        if name not in found:
            continue
        one, other = _common(found[name], truth[name])
        known = np.isfinite(one)
        if not known.any():
            continue
        errors = (one - other)[known]
        error = float(np.median(np.abs(errors)))
        value = _median_magnitude(name, truth)
        low, high = np.percentile(errors, _SCATTER_PERCENT)
        scattered = name.startswith("velocity") and low < 0 < high
        if error > _MEDIAN_LIMIT * value and not scattered:
            unit, middle = get_unit(name), float(np.median(one[known]))
            true = float(np.median(other[known]))
            wrong.append(
                f"{name} is {middle:.4g} {unit} in the median, the truth {true:.4g}; the median error is {error:.3g}"
            )
    if wrong:
        expected = f"a median error below {_MEDIAN_LIMIT:.0%} of the true value's median"
        raise CheckFailure(done, expected, "; ".join(wrong), remedy)


def _median_magnitude(name: str, truth: Maps) -> float:
    """Return the median size of a quantity: of flow, whose components change their signs over the image, its length."""
    parts = [name] if not name.startswith("flow") else [other for other in truth if other.startswith("flow")]
    return float(np.median(np.sqrt(sum(truth[other].values ** 2 for other in parts))))


def _common(one: xr.DataArray, other: xr.DataArray) -> tuple[Array, Array]:
    """Return the values of two maps at the frames and pixels that both have."""
    alike = one.dims == other.dims and all(np.array_equal(one[dim].values, other[dim].values) for dim in one.dims)
    if not alike:
        one, other = xr.align(one, other, join="inner")
    return one.values, other.values


def list_differing_variables(one: xr.Dataset, other: xr.Dataset) -> list[str]:
    """Return the variables of two data sets that differ in any bit, type or shape, or that one of them lacks."""
    names = sorted({str(name) for name in (*one.variables, *other.variables)})
    return [name for name in names if name not in one or name not in other or not _same(one[name], other[name])]


def _same(one: xr.DataArray, other: xr.DataArray) -> bool:
    a, b = one.values, other.values
    if a.dtype != b.dtype or a.shape != b.shape or one.dims != other.dims:
        return False
    return bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f"))
