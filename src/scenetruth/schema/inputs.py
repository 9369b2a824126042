"""What callers give: arrays and numbers of any origin, taken as copies of our own, or what is wrong with them."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem

__all__ = ["attributes_from", "number_from", "numbers_from", "own_copy", "pair_from", "real_array", "without_repeats"]


def real_array(name: str, values: Any, problems: list[Problem], *, masked_is_nan: bool = False) -> NDArray[Any] | None:
    """Return an array of real numbers as it was given, not yet copied; None, with a problem noted, if it is none.

    Parameters
    ----------
    name
        What to call it.
    values
        Anything; masked arrays must have nothing masked, unless that means NaN.
    problems
        Where to note what is wrong.
    masked_is_nan
        Whether masked values become NaN.
    """
    try:
        masked = np.ma.isMaskedArray(values) and bool(np.ma.getmaskarray(values).any())
        if masked and masked_is_nan and values.dtype.kind in "fiu":
            return np.asarray(values.astype(np.float64).filled(np.nan))
        raw = np.asarray(values)
    except MemoryError:
        raise
    except Exception as error:  # whatever a foreign class raises; rows of different lengths, for one
        problems.append(Problem(name, f"cannot be made into an array of numbers: {' '.join(str(error).split())}"))
        return None
    if masked:
        problems.append(Problem(name, "has masked values; fill them, or give a part without"))
        return None
    if raw.dtype.kind not in "fiu":
        told = "None" if values is None else str(raw.dtype)
        problems.append(Problem(name, "must hold real numbers", told))
        return None
    # What 64 bits cannot hold, no store can either.
    return raw.astype(np.float64) if raw.dtype.kind == "f" and raw.dtype.itemsize > 8 else raw


def own_copy(values: NDArray[Any]) -> NDArray[Any]:
    """Return a copy; of a view that repeats its values by strides of zero, one of what it repeats."""
    return np.broadcast_to(without_repeats(values).copy(), values.shape) if 0 in values.strides else values.copy()


def without_repeats(values: NDArray[Any]) -> NDArray[Any]:
    """Return the part of a view that it repeats by strides of zero: every value once; other arrays as they are."""
    return values[tuple(slice(1) if stride == 0 else slice(None) for stride in values.strides)]


def number_from(
    name: str, value: Any, problems: list[Problem], *, positive: bool = False, nonzero: bool = False
) -> float:
    """Return a finite number; NaN, with a problem noted, if it is none.

    Parameters
    ----------
    name, value
        What to call it, and what was given: Python's or NumPy's real number, or an array of one without dimensions.
    problems
        Where to note what is wrong.
    positive, nonzero
        What else it must be.
    """
    given = value.item() if isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "fiu" else value
    real = isinstance(given, int | float | np.integer | np.floating) and not isinstance(given, bool)
    try:
        number = float(given) if real else np.nan
    except OverflowError:
        number = np.inf
    if not np.isfinite(number):
        # A problem shows no None.
        problems.append(Problem(name, "must be a finite number", "None" if value is None else value))
        return np.nan
    if (positive and number <= 0) or (nonzero and number == 0):
        problems.append(Problem(name, "must be positive" if positive else "must not be zero", value))
        return np.nan
    return number


def pair_from(name: str, values: Any, problems: list[Problem]) -> tuple[float, float]:
    """Return two finite numbers; NaN, with a problem noted, if they are none."""
    listed = isinstance(values, list | tuple | np.ndarray) and getattr(values, "ndim", 1) == 1
    if not listed or len(values) != 2:
        problems.append(Problem(name, "must be two finite numbers", values))
        return np.nan, np.nan
    first, second = (number_from(f"{name}.{index}", value, problems) for index, value in enumerate(values))
    return first, second


def numbers_from(name: str, values: Any, count: int, of_what: str, problems: list[Problem]) -> NDArray[np.float64]:
    """Return so many finite numbers as an array of its own; a problem is noted if they are none."""
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
    """Return attributes as a copy; those of names that have a meaning of their own are refused."""
    if values is None:
        return {}
    if not isinstance(values, Mapping) or not all(isinstance(name, str) for name in values):
        problems.append(Problem("attrs", "must be a mapping from texts", values))
        return {}
    taken = sorted(reserved & set(values))
    if taken:
        problems.append(Problem("attrs", f"must not hold {', '.join(taken)}: these are arguments of their own"))
    return {name: deepcopy(value) for name, value in values.items() if name not in reserved}
