"""Figures of a budget from the errors of all runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import all_causes, present
from scenetruth.design.budget.confirm.errors import QUANTITIES_TOLD, ErrorMaps
from scenetruth.design.budget.parts import Part, Total
from scenetruth.design.budget.predicting import Figures
from scenetruth.design.budget.sight import Mask
from scenetruth.scene import Scene
from scenetruth.scoring import units_of

__all__ = ["Gathered", "gather", "parts_and_totals"]

Reader = Callable[[tuple[str, ...], int], ErrorMaps | None]


@dataclass(frozen=True, eq=False)
class Gathered:
    """What is known of a budget.

    Parameters
    ----------
    read
        Gives the errors of a run by its causes and seed; None if it failed.
    seeds
        The seeds.
    scene, calibration
        With all causes.
    predicted, drawn
        Predictions by cause: for one standard deviation, and for the errors that were drawn.
    places
        Quantities and regions.
    sets
        Which causes are on where one is looked at, by this one.
    everything
        The causes that are on where all are.
    explained
        Shares of what ideal images leave that surfaces explain.
    """

    read: Reader
    seeds: Sequence[int]
    scene: Scene
    calibration: Calibration
    predicted: Mapping[str, Figures]
    places: Sequence[tuple[str, str]]
    drawn: Mapping[str, Figures] = field(default_factory=dict)
    sets: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    everything: tuple[str, ...] = ()
    explained: Figures = field(default_factory=dict)

    def predicted_square(self, kind: str, quantity: str, region: str) -> float:
        """Return the square of a prediction; NaN if there is none."""
        return self.predicted.get(kind, {}).get((quantity, region), math.nan) ** 2

    def ideal_square(self, quantity: str, region: str) -> float:
        """Return the mean square of what ideal images leave."""
        return _mean_square(self._errors((), quantity, region))

    def _errors(self, kinds: tuple[str, ...], quantity: str, region: str) -> Iterator[np.ndarray]:
        for seed in self.seeds:
            maps = self.read(kinds, seed)
            if maps is not None and quantity in maps.errors:
                yield maps.errors[quantity][maps.regions[region]]


def gather(
    read: Reader, seeds: Sequence[int], scene: Scene, calibration: Calibration, predicted: Mapping[str, Figures]
) -> Gathered:
    """Return what is known before causes are simulated.

    Parameters
    ----------
    read, seeds, scene, calibration, predicted
        As of `Gathered`.
    """
    ideal = read((), seeds[0])
    assert ideal is not None  # whoever calls has seen that it did not fail
    places = []
    for quantity in QUANTITIES_TOLD:
        for region, mask in ideal.regions.items():
            if quantity in ideal.errors and np.isfinite(ideal.errors[quantity][mask]).any():
                places.append((quantity, region))
    return Gathered(read, seeds, scene, calibration, predicted, places)


def parts_and_totals(found: Gathered) -> tuple[list[Part], list[Total]]:
    """Return the parts of all causes, and their sums.

    Parameters
    ----------
    found
        What is known when all is simulated.
    """
    parts: list[Part] = []
    totals: list[Total] = []
    for quantity, region in found.places:
        here = [*_parts_of_causes(found, quantity, region), *_parts_of_surfaces(found, quantity, region)]
        parts += here
        squares = [one.figure**2 for one in here if math.isfinite(one.figure)]
        unsure = sum(one.predicted**2 for one in here if one.cause in _not_simulated(found) and one.predicted > 0)
        totals.append(_total(found, quantity, region, math.sqrt(sum(squares)), unsure))
    return parts, totals


def _parts_of_causes(found: Gathered, quantity: str, region: str) -> Iterator[Part]:
    for cause in present(found.scene, found.calibration):
        kind, key = cause.kind, (quantity, region)
        simulated, seen = math.nan, math.nan
        if kind in found.sets:
            kinds = found.sets[kind]
            simulated, seen = _difference(found, kinds, tuple(one for one in kinds if one != kind), quantity, region)
        expected = found.predicted.get(kind, {}).get(key, math.nan)
        yield Part(
            kind,
            cause.title,
            cause.size(found.scene, found.calibration),
            quantity,
            region,
            units_of(quantity),
            expected,
            found.drawn.get(kind, {}).get(key, math.nan),
            simulated,
            seen,
            simulated if math.isfinite(simulated) else expected,
        )


def _parts_of_surfaces(found: Gathered, quantity: str, region: str) -> Iterator[Part]:
    """Give slopes and curvature as far as they explain what ideal images leave, edges, and the rest."""
    # Near edges, propagation knows nothing.
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
        told = (all_causes()[kind].title, "", quantity, region, units_of(quantity))
        yield Part(kind, *told, predicted=expected, figure=math.sqrt(square))


def _difference(
    found: Gathered, kinds: tuple[str, ...], without: tuple[str, ...], quantity: str, region: str
) -> tuple[float, float]:
    """Return the root of the mean square of what a cause changes, and the share of pixels that are left."""
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


def _not_simulated(found: Gathered) -> list[str]:
    return [one.kind for one in present(found.scene, found.calibration) if one.kind not in found.sets]


def _added(found: Gathered, ideal: ErrorMaps, quantity: str, seed: int) -> np.ndarray:
    """Return the error with ideal images and all that causes change it by, pixel by pixel."""
    total = ideal.errors[quantity].copy()
    for kind, kinds in found.sets.items():
        with_it, without = found.read(kinds, seed), found.read(tuple(one for one in kinds if one != kind), seed)
        if with_it is None or without is None or quantity not in with_it.errors or quantity not in without.errors:
            return np.full_like(total, np.nan)
        total += with_it.errors[quantity] - without.errors[quantity]
    return total


def _total(found: Gathered, quantity: str, region: str, parts: float, unsure: float) -> Total:
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
        added.append(_added(found, ideal, quantity, seed)[mask])
        if maps is not None and quantity in maps.errors:
            # The same pixels as those of the parts.
            errors = maps.errors[quantity][mask & np.isfinite(ideal.errors[quantity])]
            simulated.append(errors)
            known += int(np.isfinite(errors).sum())
        wanted += int((mask & np.isfinite(ideal.errors[quantity])).sum())
    return Total(
        quantity,
        region,
        units_of(quantity),
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
