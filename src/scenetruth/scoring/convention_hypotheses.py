"""Hypotheses of convention mismatches.

Of scale (units, steps), of meaning (sign, order, inverse), and their combinations with those of position.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.convention_samples import (
    AcquisitionParameters,
    MismatchSamples,
    PositionHypothesis,
    SamplePositions,
)

__all__ = [
    "LEAST_RATIO",
    "NO_MISMATCH",
    "SCALE_HYPOTHESES",
    "ConventionMismatch",
    "MatchedScale",
    "MeaningHypothesis",
    "MismatchHypothesis",
    "ScaleHypothesis",
    "nearest_scale",
    "select_meaning_hypotheses",
]


@dataclass(frozen=True)
class ConventionMismatch:
    """A likely slip of convention in an estimate.

    ``kind``: Short and stable name, such as ``"sign"`` or ``"metres"``.
    ``quantity``: The variable of the estimate, such as ``"disparity"``.
    ``message``: One sentence: what is likely wrong, and the remedy.
    ``explained``: The share of the misfit that undoing the slip takes away, 0 to 1: of the median error, weighted by
      the change that the slip makes; of shifts by pixels, of its square away from edges. Of slips that are there
      together, each has the share of all of them.
    """

    kind: str
    quantity: str
    message: str
    explained: float


LEAST_RATIO = 1.4
"""A scale nearer to 1 than this is no slip of units; the estimate may just be biased."""

_SHARE = 0.05
"""By which share of its own logarithm a scale may be missed: a biased estimate whose unit is wrong still is named."""

_LARGEST = 0.2
"""The most that a scale may be missed by, as a logarithm: methods that are wrong by more are wrong in other ways."""

_BETWEEN = 0.35
"""By which share of the logarithmic distance to the next whole number one may be missed: 2.5 is neither 2 nor 3."""

_NAMED_APART = 10
"""Up to here whole numbers are told apart; beyond, they are closer than an estimate's bias, and are called about n."""


@dataclass(frozen=True)
class ScaleHypothesis:
    """A slip of scale.

    ``kind``: Its name.
    ``quantities``: The variables that it belongs to.
    ``message``: What is told, with ``{quantity}``, ``{factor}`` (by how much values are too large) and ``{inverse}``.
    ``factors``: Gives the factors by which values with the slip are too large.
    ``whole``: Whether the factors are whole numbers that follow each other.
    """

    kind: str
    quantities: tuple[str, ...]
    message: str
    factors: Callable[[AcquisitionParameters], Sequence[float]]
    whole: bool = False

    def reach(self, factor: float) -> float:
        """Return by how much the logarithm of a measured factor may miss one of `factors`."""
        reach = min(_SHARE * abs(math.log(factor)), _LARGEST)
        if self.whole and factor <= _NAMED_APART:
            reach = min(reach, _BETWEEN * math.log1p(1 / factor))
        return reach


@dataclass(frozen=True)
class MatchedScale:
    """A slip of scale, and by how much values are too large."""

    scale: ScaleHypothesis
    factor: float

    def message(self, quantity: str) -> str:
        """Return what is told."""
        return self.scale.message.format(
            quantity=quantity, factor=f"{self.factor:.4g}", inverse=f"{1 / self.factor:.4g}"
        )


def nearest_scale(quantity: str, factor: float, facts: AcquisitionParameters) -> MatchedScale | None:
    """Return the slip of scale that a measured factor belongs to, or None.

    >>> facts = AcquisitionParameters(500.0, 5.0, 1.0, 5, 1.0, 640.0)
    >>> nearest_scale("depth", 0.00102, facts).scale.kind, nearest_scale("disparity", 3.97, facts).factor
    ('metres', 4.0)
    >>> nearest_scale("disparity", 2.5, facts) is None
    True
    """
    if not (math.isfinite(factor) and factor > 0):
        return None
    for scale in SCALE_HYPOTHESES:
        if quantity not in scale.quantities:
            continue
        likely = [value for value in scale.factors(facts) if abs(math.log(value)) >= math.log(LEAST_RATIO)]
        near = [value for value in likely if abs(math.log(factor / value)) <= scale.reach(value)]
        if near:
            return MatchedScale(scale, min(near, key=lambda value: abs(math.log(factor / value))))
    return None


def _constant(factor: float) -> Callable[[AcquisitionParameters], Sequence[float]]:
    def factors(facts: AcquisitionParameters) -> Sequence[float]:
        return (factor,)

    return factors


def _integers(least: int, most: int) -> Callable[[AcquisitionParameters], Sequence[float]]:
    numbers = tuple(float(number) for number in range(least, most + 1))

    def factors(facts: AcquisitionParameters) -> Sequence[float]:
        return numbers

    return factors


def _full_baseline(facts: AcquisitionParameters) -> Sequence[float]:
    return (float(facts.positions - 1),) if facts.positions is not None and facts.positions > 2 else ()


def _per_second(facts: AcquisitionParameters) -> Sequence[float]:
    return (1 / facts.frame_interval_s,)


def _metres_per_second(facts: AcquisitionParameters) -> Sequence[float]:
    return (1e-3 / facts.frame_interval_s,)


def _in_baselines(facts: AcquisitionParameters) -> Sequence[float]:
    return (1 / abs(facts.baseline_mm),) if facts.baseline_mm else ()


def _in_pixels_of_the_map(facts: AcquisitionParameters) -> Sequence[float]:
    return (1 / facts.step_px,)


def _in_widths(facts: AcquisitionParameters) -> Sequence[float]:
    return (1 / facts.width_px,)


SCALE_HYPOTHESES = (
    ScaleHypothesis(
        "metres",
        ("depth", "velocity"),
        "{quantity} is in metres: multiply it by 1000; lengths are in mm here",
        _constant(1e-3),
    ),
    ScaleHypothesis(
        "centimetres",
        ("depth", "velocity"),
        "{quantity} is in centimetres: multiply it by 10; lengths are in mm here",
        _constant(0.1),
    ),
    ScaleHypothesis(
        "micrometres",
        ("depth", "velocity"),
        "{quantity} is in micrometres: divide it by 1000; lengths are in mm here",
        _constant(1e3),
    ),
    ScaleHypothesis(
        "whole_baseline",
        ("disparity",),
        "disparity is that between the outermost cameras: divide it by {factor}; it is per step of s here",
        _full_baseline,
        whole=True,
    ),
    ScaleHypothesis(
        "several_steps",
        ("disparity",),
        "disparity is that over {factor} steps of the stage: divide it by {factor}; it is per step of s here",
        _integers(2, 8),
        whole=True,
    ),
    ScaleHypothesis(
        "per_second",
        ("flow", "velocity"),
        "{quantity} is per second: divide it by {factor}, that is, multiply it by frame_interval_s; it is per frame",
        _per_second,
    ),
    ScaleHypothesis(
        "metres_per_second",
        ("velocity",),
        "velocity is in metres per second: multiply it by {inverse}, that is, by 1000 and frame_interval_s; "
        "it is in mm per frame here",
        _metres_per_second,
    ),
    ScaleHypothesis(
        "baselines",
        ("velocity",),
        "velocity is in baselines per frame: multiply it by baseline_mm; it is in mm per frame here",
        _in_baselines,
    ),
    ScaleHypothesis(
        "pixels_of_the_map",
        ("disparity", "flow"),
        "{quantity} is in pixels of the thinned image: multiply it by {inverse}; it is in pixels of the camera here",
        _in_pixels_of_the_map,
    ),
    ScaleHypothesis(
        "image_widths",
        ("disparity", "flow"),
        "{quantity} is in widths of the image: multiply it by {inverse}; it is in pixels here",
        _in_widths,
    ),
    ScaleHypothesis(
        "several_frames",
        ("flow", "velocity"),
        "{quantity} is {factor} times too large, as over {factor} frames or in another unit of time: divide it by "
        "{factor}; it is per frame here",
        _integers(2, 64),
        whole=True,
    ),
)
"""All slips of scale in the order in which they are preferred; a new one is an entry here."""


Map = NDArray[np.float64]


@dataclass(frozen=True)
class MeaningHypothesis:
    """A slip of meaning.

    ``kind``: Its name.
    ``quantity``: The variable that it belongs to.
    ``message``: What is told.
    ``apply``: Gives the values with the slip from the true ones, shape (component, n), and the lengths of the rays
      there, scaled to Z = 1, shape (n,).
    """

    kind: str
    quantity: str
    message: str
    apply: Callable[[Map, Map, AcquisitionParameters], Map]


def select_meaning_hypotheses(quantity: str) -> tuple[MeaningHypothesis, ...]:
    """Return the slips of meaning that a quantity can have."""
    return tuple(turn for turn in MEANING_HYPOTHESES if turn.quantity == quantity)


def _signs(*signs: int) -> Callable[[Map, Map, AcquisitionParameters], Map]:
    column = np.array(signs, dtype=np.float64)[:, np.newaxis]

    def apply(values: Map, rays: Map, facts: AcquisitionParameters) -> Map:
        return np.asarray(column * values)

    return apply


def _order(places: Sequence[int]) -> Callable[[Map, Map, AcquisitionParameters], Map]:
    def apply(values: Map, rays: Map, facts: AcquisitionParameters) -> Map:
        return np.asarray(values[list(places)])

    return apply


def _over(values: Map, factor: float) -> Map:
    # Where depth or disparity is zero, nothing is known of the other.
    return np.asarray(np.divide(factor, values, out=np.full(values.shape, np.nan), where=values != 0))


def _range(values: Map, rays: Map, facts: AcquisitionParameters) -> Map:
    return values * rays


def _other(values: Map, rays: Map, facts: AcquisitionParameters) -> Map:
    """Return the disparity of a depth, or the depth of a disparity."""
    return _over(values, facts.focal_length_px * facts.baseline_mm)


def _inverse(unit_mm: float) -> Callable[[Map, Map, AcquisitionParameters], Map]:
    def apply(values: Map, rays: Map, facts: AcquisitionParameters) -> Map:
        return _over(values, unit_mm)

    return apply


def _inverse_of_disparity(unit_mm: float) -> Callable[[Map, Map, AcquisitionParameters], Map]:
    def apply(values: Map, rays: Map, facts: AcquisitionParameters) -> Map:
        product = facts.focal_length_px * facts.baseline_mm
        ratio = unit_mm / product if product else np.nan
        # Where 1 / Z is nearly as large as disparity is, the estimate may just be biased.
        return values * (ratio if abs(np.log(abs(ratio))) >= np.log(LEAST_RATIO) else np.nan)

    return apply


def _component_signs(quantity: str, axes: str, *, right: str) -> tuple[MeaningHypothesis, ...]:
    """Return the slips of sign of single components, and of several but not all."""
    count = len(axes)
    found = []
    for wrong in sorted(range(1, 2**count - 1), key=int.bit_count):
        named = [axes[place] for place in range(count) if wrong >> place & 1]
        signs = [-1 if wrong >> place & 1 else 1 for place in range(count)]
        plural = f"components of {quantity} have" if len(named) > 1 else f"component of {quantity} has"
        message = f"the {' and '.join(named)} {plural} the other sign: change it; {right}"
        found.append(MeaningHypothesis(f"sign_{''.join(named).lower()}", quantity, message, _signs(*signs)))
    return tuple(found)


MEANING_HYPOTHESES = (
    MeaningHypothesis(
        "sign", "depth", "depth has the other sign: give -depth; Z is positive in front of the camera", _signs(-1)
    ),
    MeaningHypothesis(
        "range",
        "depth",
        "depth is the distance along the ray: divide it by the ray's length, sqrt(1 + x'^2 + y'^2) with "
        "x' = (x - c_x) / f; depth is Z along the optical axis here",
        _range,
    ),
    MeaningHypothesis(
        "disparity", "depth", "depth holds disparity: give it as disparity=, or f V_X / disparity as depth=", _other
    ),
    MeaningHypothesis(
        "inverse_depth",
        "depth",
        "depth holds the inverse of depth in 1/mm: give its inverse, 1 / depth",
        _inverse(1.0),
    ),
    MeaningHypothesis(
        "inverse_depth_in_metres",
        "depth",
        "depth holds the inverse of depth in 1/m: give 1000 / depth, which is in mm",
        _inverse(1000.0),
    ),
    MeaningHypothesis(
        "sign",
        "disparity",
        "disparity has the other sign, or the cameras the opposite order: give -disparity; x_s = x_0 - disparity s",
        _signs(-1),
    ),
    MeaningHypothesis(
        "depth", "disparity", "disparity holds depth: give it as depth=, or f V_X / depth as disparity=", _other
    ),
    MeaningHypothesis(
        "inverse_depth",
        "disparity",
        "disparity holds the inverse of depth in 1/mm: multiply it by f V_X",
        _inverse_of_disparity(1.0),
    ),
    MeaningHypothesis(
        "inverse_depth_in_metres",
        "disparity",
        "disparity holds the inverse of depth in 1/m: multiply it by f V_X / 1000",
        _inverse_of_disparity(1000.0),
    ),
    MeaningHypothesis(
        "sign",
        "flow",
        "flow has the other sign, as if time ran backwards: give -flow; it points to where the point is at t + 1 here",
        _signs(-1, -1),
    ),
    *_component_signs("flow", "xy", right="x counts to the right and y downwards"),
    MeaningHypothesis(
        "components_exchanged",
        "flow",
        "the components of flow are exchanged: x comes first, then y; give array[::-1]",
        _order((1, 0)),
    ),
    MeaningHypothesis(
        "sign",
        "velocity",
        "velocity has the other sign, as if time ran backwards or the camera moved: give -velocity; it is that of the "
        "surface, and U_Z < 0 comes nearer",
        _signs(-1, -1, -1),
    ),
    *_component_signs("velocity", "XYZ", right="X points to the right, Y down and Z away from the camera"),
    MeaningHypothesis(
        "components_exchanged",
        "velocity",
        "the X and Y components of velocity are exchanged: their order is X, Y, Z; give array[[1, 0, 2]]",
        _order((1, 0, 2)),
    ),
    MeaningHypothesis(
        "components_reversed",
        "velocity",
        "the components of velocity are in the order Z, Y, X: their order is X, Y, Z; give array[::-1]",
        _order((2, 1, 0)),
    ),
)
"""All slips of meaning, by quantity in the order in which they are preferred; a new one is an entry here."""


@dataclass(frozen=True)
class MismatchHypothesis:
    """Up to one slip of place, of meaning and of scale each.

    ``move``, ``turn``, ``scaled``: The slips, or None.
    """

    move: PositionHypothesis | None = None
    turn: MeaningHypothesis | None = None
    scaled: MatchedScale | None = None

    @property
    def parts(self) -> int:
        """How many slips there are."""
        return sum(part is not None for part in (self.move, self.turn, self.scaled))

    @property
    def factor(self) -> float:
        """By how much values are too large."""
        return 1.0 if self.scaled is None else self.scaled.factor

    def predicted(self, material: MismatchSamples, places: SamplePositions) -> Map:
        """Return what the estimate would show at some places, shape (component, n); NaN where that is not known."""
        source = places if self.move is None else self.move.source(places, material.grid)
        if source is None:
            return np.full((len(material.truth), len(places.y)), np.nan)
        values = material.truth_at(source)
        if self.turn is not None:
            values = self.turn.apply(values, material.rays[source.y, source.x], material.facts)
        return self.factor * values

    def slips(self, quantity: str, explained: float) -> list[ConventionMismatch]:
        """Return what is told of a quantity."""
        told = []
        if self.turn is not None:
            told.append((self.turn.kind, self.turn.message))
        if self.scaled is not None:
            told.append((self.scaled.scale.kind, self.scaled.message(quantity)))
        if self.move is not None:
            told.append((self.move.kind, self.move.message.format(quantity=quantity)))
        return [ConventionMismatch(kind, quantity, message, explained) for kind, message in told]


NO_MISMATCH = MismatchHypothesis()
"""No slip."""
