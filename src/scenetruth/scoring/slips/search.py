"""Which slips of sign, scale, order and place an estimate has."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.slips.hypothesis import Hypothesis
from scenetruth.scoring.slips.material import Material
from scenetruth.scoring.slips.moves import MOVES, Places
from scenetruth.scoring.slips.scales import LEAST_RATIO, nearest_scale
from scenetruth.scoring.slips.turns import turns_of
from scenetruth.scoring.slips.weighing import fitted_factor, lengths, weighted_median

__all__ = ["LEAST_PIXELS", "Verdict", "likely_slips"]

Map = NDArray[np.float64]

LEAST_PIXELS = 50
"""With fewer pixels that tell of a slip, chance may name one."""

_PIXELS = 1500
"""How many pixels are looked at."""

_LEAST_EXPLAINED = 0.6
"""Least share of the misfit that undoing a slip takes away. Where an estimate is right, undoing what is not there adds
to the misfit; only errors that look like the slip itself are taken away, and of the rest there is more than of them."""

_LEAST_SHARE = 0.75
"""Least share of the change that a slip makes at pixels where the estimate is nearer to the slip than to the truth. A
tenth of outliers on each side leaves nine tenths; errors that know nothing of the slip leave less than half."""

_GLANCED = 500
_GLANCED_SHARE = 0.4
"""Of so many pixels, hypotheses with a lesser share are left out before they are looked at closely."""

_GAIN = 0.05
"""Biases of methods, as a share of the value, that say nothing for or against a slip. What a slip explains beyond a
gain in this range is counted: a surface that comes nearer by 1 % per frame is not told from a bias of 1 %."""

_LEAST_CHANGE = 1e-4
"""Least change by a slip, as a share of the values: what changes nothing but the last digits cannot be seen."""

_LARGEST_GAIN = 0.2
"""Largest logarithm of the gain that a slip may leave: if values still are far too large, the slip is another one."""

_OF_VALUES = 0.5
"""Largest misfit that a slip may leave, as a share of the values: an estimate must be more than noise."""

_TRUSTED_SCALE = (0.8, 1.25)
"""Where an estimate is so many times the truth, its unit is not in question."""

_EQUAL = 1.1
"""Up to this ratio of misfits, the explanation that is preferred is taken."""


@dataclass(frozen=True)
class Verdict:
    """Slips that are likely, and how much they explain.

    Parameters
    ----------
    hypothesis
        The slips.
    explained
        Share of the misfit that undoing them takes away.
    errors
        What is left at every pixel that was looked at, in the units of the truth; NaN where it is not known.
    """

    hypothesis: Hypothesis
    explained: float
    errors: Map = field(repr=False)


def likely_slips(material: Material) -> Verdict | None:
    """Return the slips that explain most of an estimate's misfit, or None.

    All combinations of one slip of place, one of meaning and one of scale are compared with the estimate being right,
    with weights: the change that the slips would make.

    Parameters
    ----------
    material
        The quantity.
    """
    places = material.drawn(_PIXELS)
    found, truth = material.estimate_at(places), material.truth_at(places)
    if found.shape[1] < LEAST_PIXELS:
        return None
    # The truth in whatever unit the estimate has: its size alone is no sign of anything but a scale.
    rescaled = fitted_factor(lengths(found)[np.newaxis], lengths(truth)[np.newaxis]) * truth
    right, verdicts = fitted_factor(found, truth), []
    for hypothesis, expected in _hypotheses(material, places, found, right):
        verdict = _judged(hypothesis, found, truth, expected, right)
        if verdict is not None and hypothesis.scaled is not None and hypothesis.parts > 1:
            # With maps upside down the scale that fits best may happen to be a whole number.
            verdict = verdict if _judged(hypothesis, found, rescaled, expected, 1.0) is not None else None
        if verdict is not None:
            verdicts.append(verdict)
    return _best(verdicts, truth)


def _hypotheses(material: Material, places: Places, found: Map, right: float) -> Iterator[tuple[Hypothesis, Map]]:
    """Give all hypotheses but that of no slip, and what the estimate would show of each."""
    low, high = _TRUSTED_SCALE
    suspicious = not low <= right <= high
    for move in (None, *MOVES):
        source = places if move is None else move.source(places, material.grid)
        if source is None:
            continue
        moved, rays = material.truth_at(source), material.rays[source.y, source.x]
        for turn in (None, *turns_of(material.quantity)):
            expected = moved if turn is None else turn.apply(moved, rays, material.facts)
            if move is not None or turn is not None:
                yield Hypothesis(move, turn), expected
            if suspicious:
                some = expected[:, :: _step_of(expected)]
                known = np.isfinite(some).all(axis=0)
                factor = fitted_factor(found[:, :: _step_of(expected)][:, known], some[:, known])
                scaled = nearest_scale(material.quantity, factor, material.facts)
                if scaled is not None:
                    yield Hypothesis(move, turn, scaled), scaled.factor * expected


def _judged(hypothesis: Hypothesis, found: Map, truth: Map, expected: Map, right: float) -> Verdict | None:
    """Return what a hypothesis explains, or None where that is not enough; ``right`` is the gain beside the truth."""
    if not _is_near(found, truth, expected):
        return None
    known = np.asarray(np.isfinite(expected).all(axis=0))
    errors = np.full(known.shape, np.nan)
    if not known.all():
        found, truth, expected = found[:, known], truth[:, known], expected[:, known]
    change = lengths(expected - truth)
    total = change.sum()
    if not (total > 0 and total**2 >= LEAST_PIXELS * np.square(change).sum()):
        return None
    unit = _unit(expected, truth)
    gain = fitted_factor(found, expected)
    if not (gain > 0 and abs(math.log(gain)) <= _LARGEST_GAIN):
        return None
    before = lengths(found - _bias(right) * truth)
    after = lengths(found - _bias(gain) * expected) / unit
    if change[after < before].sum() < _LEAST_SHARE * total:
        return None
    values = weighted_median(lengths(expected), change)
    left = weighted_median(after, change)
    if left * unit > _OF_VALUES * values or weighted_median(change, change) < _LEAST_CHANGE * values:
        return None
    misfit = weighted_median(before, change)
    explained = 1 - left / misfit if misfit > 0 else 0.0
    if explained < _LEAST_EXPLAINED:
        return None
    errors[known] = after
    return Verdict(hypothesis, float(explained), errors)


def _step_of(values: Map) -> int:
    return max(1, int(values.shape[1]) // _GLANCED)


def _is_near(found: Map, truth: Map, expected: Map) -> bool:
    """Return whether an estimate may be nearer to what is expected than to the truth; most hypotheses end here."""
    step = _step_of(found)
    found, truth, expected = found[:, ::step], truth[:, ::step], expected[:, ::step]
    change = lengths(expected - truth)
    if np.isnan(change).any():
        known = ~np.isnan(change)
        found, truth, expected, change = found[:, known], truth[:, known], expected[:, known], change[known]
    nearer = lengths(found - expected) < _unit(expected, truth) * lengths(found - truth)
    return bool(change @ nearer >= _GLANCED_SHARE * change.sum() > 0)


def _unit(expected: Map, truth: Map) -> float:
    """Return how large values with the slips are beside the true ones: errors are compared in the truth's units."""
    ratio = float(np.abs(expected).sum() / np.abs(truth).sum()) if truth.any() else 1.0
    # Another part of the scene may have somewhat larger values.
    return ratio if ratio > 0 and abs(math.log(ratio)) > math.log(LEAST_RATIO) else 1.0


def _bias(gain: float) -> float:
    """Return the part of a gain that may be a method's bias."""
    return min(max(gain, 1 - _GAIN), 1 + _GAIN) if math.isfinite(gain) else 1.0


def _best(verdicts: Sequence[Verdict], truth: Map) -> Verdict | None:
    """Return the one that leaves the least misfit where they differ; a further slip must explain most of the rest."""
    if len(verdicts) < 2:
        return verdicts[0] if verdicts else None
    errors = np.stack([verdict.errors for verdict in verdicts])
    errors = errors[:, np.isfinite(errors).all(axis=0)]
    if errors.shape[1] < LEAST_PIXELS:
        return max(verdicts, key=lambda verdict: verdict.explained)
    values = lengths(truth)
    # Outliers count alike for all.
    errors = np.minimum(errors, 3 * np.median(values[values > 0])) if (values > 0).any() else errors
    apart = np.ptp(errors, axis=0)
    left = errors @ apart / apart.sum() if apart.any() else np.zeros(len(errors))
    rounding = _LEAST_CHANGE * np.median(values)
    best: int | None = None
    for parts in sorted({verdict.hypothesis.parts for verdict in verdicts}):
        level = [place for place, verdict in enumerate(verdicts) if verdict.hypothesis.parts == parts]
        least = min(left[place] for place in level)
        if best is None or least + rounding < (1 - _LEAST_EXPLAINED) * left[best]:
            best = next(place for place in level if left[place] <= _EQUAL * least + rounding)
    return None if best is None else verdicts[best]
