"""All figures of one value of a case: errors on each method's own pixels, on those of all methods, on all pixels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from scenetruth.comparison.case import Case, Found
from scenetruth.comparison.measures.confidence import KEPT, WITHIN, calibration, reliability, sparsification
from scenetruth.comparison.measures.sizes import Size, sizes_of
from scenetruth.comparison.rows import ALL, COMMON, OWN, Row
from scenetruth.scoring import units_of
from scenetruth.scoring.reading import Pairs

__all__ = ["GOOD_PX", "figure_rows"]

GOOD_PX = 0.1
"""An estimate is good that is off by so much at most, in px per step or per frame."""
_IN_PX = ("disparity", "flow_x", "flow_y")

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


def figure_rows(case: Case, value: float, found: Sequence[Found]) -> Iterator[Row]:
    """Give the figures of all methods at one value.

    Parameters
    ----------
    case
        The case.
    value
        What was varied.
    found
        What was found, for each noise.
    """
    region = case.region_at(found[0].truth.isel(t=0), value)
    for quantity in case.quantities:
        errors, told, std = _stacks(found, quantity, region)
        common = np.logical_and.reduce(list(told.values())) if told else np.zeros(0, dtype=bool)
        for label, known in told.items():
            rows = _rows_of(errors[label], known, common, region, std.get(label), alone=len(told) == 1)
            for pixels, statistic, size, at in rows:
                unit = "1" if statistic in _SHARES else units_of(quantity)
                if quantity in _IN_PX or statistic != "good":
                    yield Row(
                        case.kind, value, label, quantity, pixels, statistic, size.number, size.low, size.high, at, unit
                    )


_SHARES = ("density", "good", "within", "calibration")


def _stacks(
    found: Sequence[Found], quantity: str, region: Mask
) -> tuple[dict[str, Map], dict[str, Mask], dict[str, Map]]:
    """Return errors, where they are known, and stated standard deviations by method, shape (seed, y, x)."""
    errors: dict[str, list[Map]] = {}
    told: dict[str, list[Mask]] = {}
    stated: dict[str, list[Map]] = {}
    for one in found:
        for label, estimate in one.estimates.items():
            pairs = Pairs(estimate, one.truth)
            if quantity not in pairs:
                continue
            pair = pairs[quantity]
            with np.errstate(invalid="ignore"):
                error = pair.estimate[0] - pair.truth[0]
            known = region & np.isfinite(error) & (True if pair.full is None else pair.full[0])
            errors.setdefault(label, []).append(np.where(known, error, 0.0))
            told.setdefault(label, []).append(known)
            if pair.std is not None:
                stated.setdefault(label, []).append(pair.std[0])
    return (
        {label: np.stack(maps) for label, maps in errors.items()},
        {label: np.stack(maps) for label, maps in told.items()},
        {label: np.stack(maps) for label, maps in stated.items() if len(maps) == len(errors[label])},
    )


def _rows_of(
    errors: Map, known: Mask, common: Mask, region: Mask, std: Map | None, *, alone: bool
) -> Iterator[tuple[str, str, Size, float]]:
    """Give (pixels, statistic, figure, at) of one method and quantity."""
    there = len(errors) * np.count_nonzero(region)
    if not there:
        return
    yield OWN, "density", Size(np.count_nonzero(known) / there), math.nan
    good = np.count_nonzero(known & (np.abs(errors) <= GOOD_PX))
    yield ALL, "good", Size(good / there), math.nan
    for name, size in sizes_of(errors, known).items():
        yield OWN, name, size, math.nan
    if not alone:
        for name, size in sizes_of(errors, common).items():
            yield COMMON, name, size, math.nan
    noise = _noise(errors, known)
    if noise is not None:
        yield OWN, "noise", noise, math.nan
    if std is None:
        return
    kept = known & np.isfinite(std) & (std > 0)
    if not kept.any():
        return
    off, bars = errors[kept], std[kept]
    yield OWN, "calibration", Size(calibration(off, bars)), math.nan
    for at, share in zip(WITHIN, reliability(off, bars), strict=True):
        yield OWN, "within", Size(share), at
    for at, left in zip(KEPT, sparsification(off, bars), strict=True):
        yield OWN, "rms_of_surest", Size(left), at


def _noise(errors: Map, known: Mask) -> Size | None:
    """Return the root of the mean variance over noises, of pixels that are known with all; None of a single noise."""
    count = len(errors)
    always: Mask = np.asarray(known.all(axis=0))
    if count < 2 or not always.any():
        return None
    variance = errors[:, always].var(axis=0, ddof=1)
    # Blocks are drawn again as for other errors; squares and not errors are averaged.
    deviations = np.zeros(always.shape)
    deviations[always] = np.sqrt(variance)
    return sizes_of(deviations[None], always[None])["rms"]


def by_case(rows: Sequence[Row]) -> Mapping[str, list[Row]]:
    """Return rows by their case."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row.case, []).append(row)
    return found
