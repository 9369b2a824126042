"""Contributions of the sources of uncertainty: predicted, simulated, and combined."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.uncertainty.observation_model import Map, Mask, ObservationModel, compute_growth_error
from scenetruth.design.uncertainty.propagation import Errors, Propagation
from scenetruth.design.uncertainty.simulation_runs import BUDGET_QUANTITIES, GROWTH, ErrorMaps
from scenetruth.design.uncertainty.source import (
    Calibration,
    UncertaintySource,
    active_sources,
    all_sources,
    restrict_sources,
)
from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene
from scenetruth.scoring import get_units
from scenetruth.scoring.error_pairs import percent_per_hour

__all__ = [
    "BudgetTable",
    "CombinedUncertainty",
    "Contribution",
    "Figures",
    "aggregate_runs",
    "compute_contributions",
    "compute_explained_fraction",
    "predict_contributions",
    "predict_for_seeds",
    "sort_contributions",
]


@dataclass(frozen=True)
class Contribution:
    """Contribution of one source to the error of one quantity, RMS over the pixels of a region.

    ``size``: Magnitude of the source in this scene, with its unit.
    ``predicted``: By propagation of one standard deviation of the source; NaN without a model.
    ``predicted_for_seeds``: By propagation of the simulated errors; NaN if the source is not random or not simulated.
    ``simulated``: RMS change of the estimate, pixel by pixel, when the source is switched on; NaN if not simulated.
    ``valid_fraction``: Fraction of the pixels valid with ideal images that remain valid; NaN if not simulated.
    ``value``: Contribution to the budget: simulated if available, otherwise predicted; for surfaces, the part of the
      error with ideal images that correlates with the prediction. NaN if neither is available.
    """

    cause: str
    title: str
    size: str
    quantity: str
    region: str
    unit: str
    predicted: float = math.nan
    predicted_for_seeds: float = math.nan
    simulated: float = math.nan
    valid_fraction: float = math.nan
    value: float = math.nan


@dataclass(frozen=True)
class CombinedUncertainty:
    """Combined error of one quantity, RMS over the pixels of a region.

    ``root_sum_square``: Root sum of squares of all contributions, assuming independence.
    ``signed_sum``: RMS of the signed sum, pixel by pixel, of all simulated contributions, combined in quadrature with
      contributions that were only predicted. Biases may cancel; NaN if only ideal images were simulated.
    ``simulated``, ``ideal``: The error with all sources (NaN without a valid estimate), and with ideal images.
    ``signal``, ``valid_fraction``: RMS of the true value, and fraction of the pixels that are valid with all sources.
    """

    quantity: str
    region: str
    unit: str
    root_sum_square: float
    signed_sum: float
    simulated: float
    ideal: float
    signal: float
    valid_fraction: float

    @property
    def value(self) -> float:
        """Combined uncertainty: simulated, or the root sum of squares without a valid estimate."""
        return self.simulated if math.isfinite(self.simulated) else self.root_sum_square


def sort_contributions(parts: Iterable[Contribution], quantity: str, region: str) -> list[Contribution]:
    """Return the contributions to a quantity in a region in descending order; NaN last."""
    found = [one for one in parts if (one.quantity, one.region) == (quantity, region)]
    return sorted(found, key=lambda one: -one.value if math.isfinite(one.value) else math.inf)


Figures = dict[tuple[str, str], float]
"""RMS values by quantity and region."""

# Windowed growth is slow: a larger number of errors is replaced by this number of sums with random signs.
_MOST_GROWTHS = 4


def predict_contributions(
    cause: UncertaintySource,
    sight: ObservationModel,
    propagation: Propagation,
    calibration: Calibration,
    regions: Mapping[str, Mask],
) -> Figures:
    """Return the contributions of one standard deviation of a source to every quantity."""
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
    return _average_over(squares, regions)


def predict_for_seeds(
    cause: UncertaintySource,
    sight: ObservationModel,
    propagation: Propagation,
    calibration: Calibration,
    regions: Mapping[str, Mask],
    seeds: Iterable[int],
) -> Figures:
    """Return the contributions of the simulated errors of a source; empty if only their magnitude is available."""
    total: dict[str, Map] = {}
    count = 0
    for draw, seed in enumerate(seeds):
        scene = restrict_sources(sight.scene, (cause.kind,), seed)
        responses = cause.responses_drawn(sight, propagation, calibration, scene, draw)
        if responses is None:
            return {}
        errors: dict[str, Map] = {}
        for one in responses:
            for name, values in one.items():
                errors[name] = errors.get(name, np.zeros_like(sight.depth)) + values
        count += 1
        if GROWTH not in errors and "velocity_z" in errors:
            errors[GROWTH] = compute_growth_error(sight, _select_motion(errors))
        if GROWTH in errors:
            errors[GROWTH] = errors[GROWTH] * percent_per_hour(sight.intrinsics)
        for name, values in errors.items():
            total[name] = total.get(name, np.zeros_like(sight.depth)) + values**2
    return _average_over({name: values / count for name, values in total.items()}, regions)


def compute_explained_fraction(
    sight: ObservationModel, propagation: Propagation, left: ErrorMaps, regions: Mapping[str, Mask]
) -> Figures:
    """Return the fraction of the error with ideal images that is explained by the predictions for the surface.

    Predicted maps are subtracted in turn, each with its least-squares factor, limited to 2.
    """
    found: Figures = {}
    maps = {kind: dict(errors) for kind, errors in propagation.own().items()}
    for errors in maps.values():
        if GROWTH in left.errors and GROWTH not in errors and "velocity_z" in errors:
            errors[GROWTH] = compute_growth_error(sight, _select_motion(errors)) * percent_per_hour(sight.intrinsics)
    for quantity, values in left.errors.items():
        for region, mask in regions.items():
            entries = [errors[quantity] for errors in maps.values() if quantity in errors]
            inside = mask & np.isfinite([values, *entries]).all(axis=0)
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


_MOST_TIMES = 2.0  # with a larger factor, the correlation with the prediction is accidental


def _growth(found: list[Errors], sight: ObservationModel) -> Map:
    """Return the mean square error of growth, per frame."""
    if len(found) <= _MOST_GROWTHS:
        return np.asarray(sum(compute_growth_error(sight, _select_motion(one)) ** 2 for one in found))
    generator = generator_for(0, "budget", "signs")
    total = np.zeros_like(sight.depth)
    for _ in range(_MOST_GROWTHS):
        signs: NDArray[np.float64] = generator.choice([-1.0, 1.0], len(found))
        both = {
            name: np.asarray(sum(sign * one[name] for sign, one in zip(signs, found, strict=True)))
            for name in _select_motion(found[0])
        }
        total += compute_growth_error(sight, both) ** 2 / _MOST_GROWTHS
    return total


def _select_motion(errors: Errors) -> Errors:
    return {name: values for name, values in errors.items() if name == "depth" or name.startswith("velocity")}


def _average_over(squares: Mapping[str, Map], regions: Mapping[str, Mask]) -> Figures:
    found: Figures = {}
    for name, values in squares.items():
        for region, mask in regions.items():
            inside = values[mask]
            inside = inside[np.isfinite(inside)]
            found[name, region] = math.sqrt(inside.mean()) if inside.size else math.nan
    return found


Reader = Callable[[tuple[str, ...], int], ErrorMaps | None]


@dataclass(frozen=True, eq=False)
class BudgetTable:
    """Results and predictions for a budget."""

    read: Reader  # returns the errors of a run by its sources and seed; None if it failed
    seeds: Sequence[int]
    scene: Scene
    calibration: Calibration
    predicted: Mapping[str, Figures]  # by source, for one standard deviation
    places: Sequence[tuple[str, str]]
    drawn: Mapping[str, Figures] = field(default_factory=dict)  # by source, for simulated errors
    sets: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # sources switched on to simulate a source
    everything: tuple[str, ...] = ()
    explained: Figures = field(default_factory=dict)  # fractions of the error with ideal images that surfaces explain

    def predicted_square(self, kind: str, quantity: str, region: str) -> float:
        """Return the square of a prediction; NaN without a prediction."""
        return self.predicted.get(kind, {}).get((quantity, region), math.nan) ** 2

    def ideal_square(self, quantity: str, region: str) -> float:
        """Return the mean square error with ideal images."""
        return _mean_square(self._errors((), quantity, region))

    def _errors(self, kinds: tuple[str, ...], quantity: str, region: str) -> Iterator[np.ndarray]:
        for seed in self.seeds:
            maps = self.read(kinds, seed)
            if maps is not None and quantity in maps.errors:
                yield maps.errors[quantity][maps.regions[region]]


def aggregate_runs(
    read: Reader, seeds: Sequence[int], scene: Scene, calibration: Calibration, predicted: Mapping[str, Figures]
) -> BudgetTable:
    """Return the budget before sources are simulated."""
    ideal = read((), seeds[0])
    assert ideal is not None  # checked by the caller
    places = []
    for quantity in BUDGET_QUANTITIES:
        for region, mask in ideal.regions.items():
            if quantity in ideal.errors and np.isfinite(ideal.errors[quantity][mask]).any():
                places.append((quantity, region))
    return BudgetTable(read, seeds, scene, calibration, predicted, places)


def compute_contributions(found: BudgetTable) -> tuple[list[Contribution], list[CombinedUncertainty]]:
    """Return the contributions of all sources, and the combined uncertainties."""
    parts: list[Contribution] = []
    totals: list[CombinedUncertainty] = []
    for quantity, region in found.places:
        here = [*_source_contributions(found, quantity, region), *_surface_contributions(found, quantity, region)]
        parts += here
        squares = [one.value**2 for one in here if math.isfinite(one.value)]
        unsure = sum(one.predicted**2 for one in here if one.cause in _not_simulated(found) and one.predicted > 0)
        totals.append(_combine(found, quantity, region, math.sqrt(sum(squares)), unsure))
    return parts, totals


def _source_contributions(found: BudgetTable, quantity: str, region: str) -> Iterator[Contribution]:
    for cause in active_sources(found.scene, found.calibration):
        kind, key = cause.kind, (quantity, region)
        simulated, seen = math.nan, math.nan
        if kind in found.sets:
            kinds = found.sets[kind]
            simulated, seen = _difference(found, kinds, tuple(one for one in kinds if one != kind), quantity, region)
        expected = found.predicted.get(kind, {}).get(key, math.nan)
        yield Contribution(
            kind,
            cause.title,
            cause.size(found.scene, found.calibration),
            quantity,
            region,
            get_units(quantity),
            expected,
            found.drawn.get(kind, {}).get(key, math.nan),
            simulated,
            seen,
            simulated if math.isfinite(simulated) else expected,
        )


def _surface_contributions(found: BudgetTable, quantity: str, region: str) -> Iterator[Contribution]:
    """Yield slopes and curvature as far as they explain the error with ideal images, edges, and the method bias."""
    # Propagation is not valid near edges.
    inside = "interior" if region == "all" and (quantity, "interior") in found.places else region
    left = found.ideal_square(quantity, inside)
    squares = {"edges": max(found.ideal_square(quantity, region) - left, 0.0)} if inside != region else {}
    whole = left
    for kind in ("slope", "curvature"):
        share = found.explained.get((f"{kind} {quantity}", inside))
        if share is not None:
            squares[kind] = min(share * whole, left)
            left -= squares[kind]
    squares["rest"] = left
    for kind, square in squares.items():
        expected = found.predicted.get(kind, {}).get((quantity, inside), math.nan)
        entries = (all_sources()[kind].title, "", quantity, region, get_units(quantity))
        yield Contribution(kind, *entries, predicted=expected, value=math.sqrt(square))


def _difference(
    found: BudgetTable, kinds: tuple[str, ...], without: tuple[str, ...], quantity: str, region: str
) -> tuple[float, float]:
    """Return the RMS change by a source, and the fraction of pixels that remain valid."""
    squares, count, before = 0.0, 0, 0
    for seed in found.seeds:
        with_it, base = found.read(kinds, seed), found.read(without, seed)
        if base is None or quantity not in base.errors:
            continue
        mask = base.regions[region] & np.isfinite(base.errors[quantity])
        before += int(mask.sum())
        if with_it is None or quantity not in with_it.errors:
            continue
        off = (with_it.errors[quantity] - base.errors[quantity])[mask]
        off = off[np.isfinite(off)]
        squares += float(off @ off)
        count += off.size
    return (math.sqrt(squares / count) if count else math.nan), (count / before if before else math.nan)


def _not_simulated(found: BudgetTable) -> list[str]:
    return [one.kind for one in active_sources(found.scene, found.calibration) if one.kind not in found.sets]


def _signed_sum(found: BudgetTable, ideal: ErrorMaps, quantity: str, seed: int) -> np.ndarray:
    """Return the error with ideal images plus the changes by all sources, pixel by pixel."""
    total = ideal.errors[quantity].copy()
    for kind, kinds in found.sets.items():
        with_it, without = found.read(kinds, seed), found.read(tuple(one for one in kinds if one != kind), seed)
        if with_it is None or without is None or quantity not in with_it.errors or quantity not in without.errors:
            return np.full_like(total, np.nan)
        total += with_it.errors[quantity] - without.errors[quantity]
    return total


def _combine(found: BudgetTable, quantity: str, region: str, parts: float, unsure: float) -> CombinedUncertainty:
    simulated: list[np.ndarray] = []
    added: list[np.ndarray] = []
    truths: list[np.ndarray] = []
    known = wanted = 0
    for seed in found.seeds:
        ideal, maps = found.read((), seed), found.read(found.everything, seed)
        if ideal is None:
            continue
        mask: Mask = ideal.regions[region]
        truths.append(ideal.truths[quantity][mask])
        added.append(_signed_sum(found, ideal, quantity, seed)[mask])
        if maps is not None and quantity in maps.errors:
            # The pixels of the contributions.
            errors = maps.errors[quantity][mask & np.isfinite(ideal.errors[quantity])]
            simulated.append(errors)
            known += int(np.isfinite(errors).sum())
        wanted += int((mask & np.isfinite(ideal.errors[quantity])).sum())
    return CombinedUncertainty(
        quantity,
        region,
        get_units(quantity),
        parts,
        math.sqrt(_mean_square(added) + unsure) if found.sets else math.nan,
        math.sqrt(_mean_square(simulated)),
        math.sqrt(found.ideal_square(quantity, region)),
        math.sqrt(_mean_square(truths)),
        known / wanted if wanted else math.nan,
    )


def _mean_square(values: Sequence[np.ndarray] | Iterator[np.ndarray]) -> float:
    all_of_them = np.concatenate([np.zeros(0), *values])
    finite = all_of_them[np.isfinite(all_of_them)]
    return float(np.mean(np.square(finite))) if finite.size else math.nan
