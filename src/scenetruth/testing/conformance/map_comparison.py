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
    "FLOOR", "MIN_RETAINED_FRACTION", "CheckFailure", "Maps", "NotApplicable", "change_sign", "compute_magnitude",
    "compute_rms", "flip_maps", "list_differing_variables", "require_agreement", "require_equal_to_rounding",
    "require_median_near", "scalar_maps",
]  # fmt: skip


class CheckFailure(AssertionError):
    """A failed check: procedure, expected result, actual result with numbers and units, and correction."""

    def __init__(self, done: str, expected: str, found: str, remedy: str) -> None:
        self.done, self.expected, self.found, self.remedy = done, expected, found, remedy
        super().__init__(done, expected, found, remedy)

    def __str__(self) -> str:
        parts = (("done", self.done), ("expected", self.expected), ("found", self.found), ("remedy", self.remedy))
        return "\n".join(f"{name + ':':9} {text}" for name, text in parts)


class NotApplicable(SkipTest):
    """The reason why a check does not apply to a method; test runners count it as skipped."""


Array = NDArray[np.float64]
Maps = Mapping[str, xr.DataArray]
"""Scalar maps, dimensions (t, y, x), float64, NaN where invalid."""

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
"""Smallest significant fraction of a quantity: above float32 and 16-bit rounding, below convention errors."""
MIN_RETAINED_FRACTION = 0.2
"""Minimum fraction of valid pixels that remain valid; borders move in mirrored images, and blocks omit remainders."""
_MEDIAN_LIMIT = 0.2
"""Maximum median error over the median true value or length of flow; a wrong sign gives 2, a wrong baseline 0.5."""
_SCATTER_PERCENT = (2.5, 97.5)
"""Percentiles of the estimates that must enclose the true velocity if the median error is larger."""
_ROUNDING = 1e-4
"""Relative rounding error of float32 after several thousand operations."""
_MOST_ROUNDED = 0.01
"""Fraction of pixels that may differ more, where rounding changes the result of a threshold."""


def scalar_maps(estimate: xr.Dataset) -> dict[str, xr.DataArray]:
    """Return the valid values of an estimate by component: ``depth`` (mm), ``disparity`` (px/step), ``flow_x``, ..."""
    found: dict[str, tuple[tuple[Hashable, ...], Array]] = {}
    for name, (variable, component) in _SCALARS.items():
        if variable not in estimate.variables:
            continue
        item = estimate.variables[variable]
        values = np.array(item.values if component is None else item.values[component], dtype=np.float64)
        # As in scores, `status` replaces a missing specific status.
        for status in {one if one in estimate.variables else "status" for one in _STATUSES[variable]}:
            if status in estimate.variables:
                values[estimate.variables[status].values != STATUS_VALID] = np.nan
        values[~np.isfinite(values)] = np.nan
        found[name] = (item.dims if component is None else item.dims[1:], values)
    return build_maps(found, {dim: estimate.variables[dim].values for dim in ("t", "y", "x") if dim in estimate.coords})


def build_maps(
    arrays: Mapping[str, tuple[Sequence[Hashable], Array]], coordinates: Mapping[str, NDArray[Any]]
) -> dict[str, xr.DataArray]:
    """Return arrays with dimensions as maps with common coordinates."""
    # Created together: separate construction of each map takes longer than the estimation of such small images.
    together = xr.Dataset({name: (tuple(dims), values) for name, (dims, values) in arrays.items()}, dict(coordinates))
    return {name: together[name] for name in arrays}


def get_unit(name: str) -> str:
    """Return the unit of a map of `scalar_maps`."""
    return VARIABLES["estimate"][_SCALARS[name][0]].units


def compute_rms(values: Array) -> float:
    """Return the RMS of the finite values; NaN without any."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def compute_magnitude(truth: Maps, name: str) -> float:
    """Return the RMS of the true value of a quantity, for components of a vector that of its length."""
    base = _SCALARS[name][0]
    return float(np.sqrt(sum(compute_rms(truth[other].values) ** 2 for other in truth if _SCALARS[other][0] == base)))


def flip_maps(maps: Maps, dim: str) -> dict[str, xr.DataArray]:
    """Return maps reversed along a dimension, with unchanged coordinates."""
    back = slice(None, None, -1)
    return {name: item.isel({dim: back}).assign_coords({dim: item[dim].values}) for name, item in maps.items()}


def change_sign(maps: Maps, names: Iterable[str]) -> dict[str, xr.DataArray]:
    """Return maps, with the opposite sign for the given names."""
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
    """Require agreement within tolerances, and validity of the majority of the previously valid pixels."""
    wrong, compared = [], False
    for name, limit in tolerances.items():
        if name not in found:
            wrong.append(f"no {name} is estimated")
            continue
        one, other = _common(found[name], expected[name])
        before = int(np.isfinite(other).sum())
        if not before:
            continue
        compared = True
        kept = int(np.isfinite(one - other).sum()) / before
        if kept < least_kept:
            wrong.append(f"{name} is valid in {kept:.0%} of the previously valid pixels ({least_kept:.0%} required)")
        difference = compute_rms(one - other)
        if difference > limit:
            unit = get_unit(name)
            wrong.append(f"{name} differs by {difference:.3g} {unit} rms (limit {limit:.3g} {unit})")
    if wrong:
        raise CheckFailure(done, expectation, "; ".join(wrong), remedy)
    if not compared:
        msg = "the two estimates have no common frame for comparison"
        raise NotApplicable(msg)


def require_equal_to_rounding(found: Maps, expected: Maps, *, done: str, expectation: str, remedy: str) -> None:
    """Require equality of maps up to rounding."""
    wrong = []
    for name, values in expected.items():
        if name not in found:
            wrong.append(f"no {name} is estimated")
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
    """Require a median error below 20 % of the true value.

    Velocity is a difference of depths and may be less certain: values that a method finds in sixteenths of a pixel are
    rounded to zero or to the next step. It must then scatter around the true value.
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
    """Return the median magnitude of a quantity; for flow, whose components change sign in the image, of its length."""
    parts = [name] if not name.startswith("flow") else [other for other in truth if other.startswith("flow")]
    return float(np.median(np.sqrt(sum(truth[other].values ** 2 for other in parts))))


def _common(one: xr.DataArray, other: xr.DataArray) -> tuple[Array, Array]:
    """Return the values of two maps at their common frames and pixels."""
    alike = one.dims == other.dims and all(np.array_equal(one[dim].values, other[dim].values) for dim in one.dims)
    if not alike:
        one, other = xr.align(one, other, join="inner")
    return one.values, other.values


def list_differing_variables(one: xr.Dataset, other: xr.Dataset) -> list[str]:
    """Return the variables of two data sets that differ in any bit, type or shape, or are missing from either."""
    names = sorted({str(name) for name in (*one.variables, *other.variables)})
    return [name for name in names if name not in one or name not in other or not _same(one[name], other[name])]


def _same(one: xr.DataArray, other: xr.DataArray) -> bool:
    a, b = one.values, other.values
    if a.dtype != b.dtype or a.shape != b.shape or one.dims != other.dims:
        return False
    return bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f"))
