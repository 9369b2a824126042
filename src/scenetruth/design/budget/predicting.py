"""Predicted parts of all causes: root of the mean square of the propagated errors over regions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause
from scenetruth.design.budget.confirm.errors import GROWTH, ErrorMaps
from scenetruth.design.budget.growth import growth_error
from scenetruth.design.budget.propagation.base import Errors, Propagation
from scenetruth.design.budget.sight import Map, Mask, Sight
from scenetruth.design.budget.switches import scene_with
from scenetruth.randomness import generator_for
from scenetruth.scoring.reading import percent_per_hour

__all__ = ["Figures", "explained", "predicted", "predicted_drawn"]

Figures = dict[tuple[str, str], float]
"""Roots of mean squares by quantity and region."""

# Windows of growth take time: of more errors than this, sums with random signs stand for all.
_MOST_GROWTHS = 4


def predicted(
    cause: Cause, sight: Sight, propagation: Propagation, calibration: Calibration, regions: Mapping[str, Mask]
) -> Figures:
    """Return what one standard deviation of a cause makes of every quantity.

    Parameters
    ----------
    cause
        The cause.
    sight, propagation
        The scene, and the model of the method.
    calibration
        How well the calibration is known.
    regions
        Where, of the pixels that the method tells.
    """
    found = list(cause.responses(sight, propagation, calibration))
    if not found:
        return {}
    squares: dict[str, Map] = {}
    for errors in found:
        for name, values in errors.items():
            squares[name] = squares.get(name, np.zeros_like(sight.depth)) + values**2
    factor = percent_per_hour(sight.intrinsics)
    if GROWTH in squares:
        squares[GROWTH] = squares[GROWTH] * factor**2
    elif "velocity_z" in squares:
        squares[GROWTH] = _growth(found, sight) * factor**2
    return _over(squares, regions)


def predicted_drawn(
    cause: Cause,
    sight: Sight,
    propagation: Propagation,
    calibration: Calibration,
    regions: Mapping[str, Mask],
    seeds: Iterable[int],
) -> Figures:
    """Return what the very errors that are simulated make of every quantity; nothing if only their size is known."""
    total: dict[str, Map] = {}
    count = 0
    for draw, seed in enumerate(seeds):
        scene = scene_with(sight.scene, (cause.kind,), seed)
        responses = cause.responses_drawn(sight, propagation, calibration, scene, draw)
        if responses is None:
            return {}
        errors: dict[str, Map] = {}
        for one in responses:
            for name, values in one.items():
                errors[name] = errors.get(name, np.zeros_like(sight.depth)) + values
        count += 1
        if GROWTH not in errors and "velocity_z" in errors:
            errors[GROWTH] = growth_error(sight, _of_motion(errors))
        if GROWTH in errors:
            errors[GROWTH] = errors[GROWTH] * percent_per_hour(sight.intrinsics)
        for name, values in errors.items():
            total[name] = total.get(name, np.zeros_like(sight.depth)) + values**2
    return _over({name: values / count for name, values in total.items()}, regions)


def explained(sight: Sight, propagation: Propagation, left: ErrorMaps, regions: Mapping[str, Mask]) -> Figures:
    """Return which share of what ideal images leave goes along with what the surface is said to cause.

    Maps are subtracted one after the other, each with the factor that leaves least, at most two.

    Parameters
    ----------
    sight, propagation
        The scene, and the model of the method.
    left
        The errors with ideal images.
    regions
        Where.

    Returns
    -------
    dict
        Shares of the mean square, by the cause with the quantity, ``"slope depth"``, and the region.
    """
    found: Figures = {}
    maps = {kind: dict(errors) for kind, errors in propagation.own().items()}
    for errors in maps.values():
        if GROWTH in left.errors and GROWTH not in errors and "velocity_z" in errors:
            errors[GROWTH] = growth_error(sight, _of_motion(errors)) * percent_per_hour(sight.intrinsics)
    for quantity, values in left.errors.items():
        for region, mask in regions.items():
            told = [errors[quantity] for errors in maps.values() if quantity in errors]
            inside = mask & np.isfinite([values, *told]).all(axis=0)
            rest = values[inside]
            whole = float(rest @ rest)
            for kind, errors in maps.items():
                if quantity not in errors or not whole:
                    continue
                along = errors[quantity][inside]
                square = float(along @ along)
                factor = min(max(float(rest @ along) / square, 0.0), _MOST_TIMES) if square else 0.0
                less = rest - factor * along
                found[f"{kind} {quantity}", region] = max(float(rest @ rest - less @ less), 0.0) / whole
                rest = less
    return found


# Where a prediction is too small by more, what goes along with it does so by chance.
_MOST_TIMES = 2.0


def _growth(found: list[Errors], sight: Sight) -> Map:
    """Return the mean square error of growth per frame."""
    if len(found) <= _MOST_GROWTHS:
        return np.asarray(sum(growth_error(sight, _of_motion(one)) ** 2 for one in found))
    generator = generator_for(0, "budget", "signs")
    total = np.zeros_like(sight.depth)
    for _ in range(_MOST_GROWTHS):
        signs: NDArray[np.float64] = generator.choice([-1.0, 1.0], len(found))
        both = {
            name: np.asarray(sum(sign * one[name] for sign, one in zip(signs, found, strict=True)))
            for name in _of_motion(found[0])
        }
        total += growth_error(sight, both) ** 2 / _MOST_GROWTHS
    return total


def _of_motion(errors: Errors) -> Errors:
    return {name: values for name, values in errors.items() if name == "depth" or name.startswith("velocity")}


def _over(squares: Mapping[str, Map], regions: Mapping[str, Mask]) -> Figures:
    found: Figures = {}
    for name, values in squares.items():
        for region, mask in regions.items():
            inside = values[mask]
            inside = inside[np.isfinite(inside)]
            found[name, region] = math.sqrt(inside.mean()) if inside.size else math.nan
    return found
