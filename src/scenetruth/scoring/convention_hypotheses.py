"""Hypotheses of convention mismatches: scale (units, steps), meaning (sign, order, inverse), and combinations."""

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
    """A likely convention mismatch of an estimate.

    ``kind``: Short, stable name, such as ``"sign"`` or ``"metres"``. ``message``: Likely cause and its correction.
    ``explained``: Fraction of the residual that is removed by undoing it and all simultaneous mismatches, 0 to 1: of
      the weighted median error; for pixel shifts, of the squared error in the interior.
    """

    kind: str
    quantity: str
    message: str
    explained: float


LEAST_RATIO = 1.4
"""A scale closer to 1 than this is attributed to bias, not to a unit."""
_SHARE = 0.05
"""Tolerance of a scale, as a fraction of its logarithm: the wrong unit of a biased estimate is still identified."""
_LARGEST = 0.2
"""Largest tolerance of a scale, as a logarithm; larger deviations have other causes."""
_BETWEEN = 0.35
"""Tolerance of an integer scale, as a fraction of the logarithmic distance to the next: 2.5 is neither 2 nor 3."""
_NAMED_APART = 10
"""Largest integer that is distinguished from its neighbours; larger integers differ by less than typical bias."""


@dataclass(frozen=True)
class ScaleHypothesis:
    """A scale mismatch; ``whole``: whether its factors are consecutive integers.

    ``message``: With ``{quantity}``, ``{factor}`` (ratio of estimate to truth) and ``{inverse}``.
    ``factors``: Returns the possible ratios of estimate to truth.
    """

    kind: str
    quantities: tuple[str, ...]
    message: str
    factors: Callable[[AcquisitionParameters], Sequence[float]]
    whole: bool = False

    def reach(self, factor: float) -> float:
        """Return the tolerance of the logarithm of a measured factor."""
        reach = min(_SHARE * abs(math.log(factor)), _LARGEST)
        if self.whole and factor <= _NAMED_APART:
            reach = min(reach, _BETWEEN * math.log1p(1 / factor))
        return reach


@dataclass(frozen=True)
class MatchedScale:
    """A scale mismatch and its ratio of estimate to truth."""

    scale: ScaleHypothesis
    factor: float

    def message(self, quantity: str) -> str:
        """Return the message."""
        return self.scale.message.format(
            quantity=quantity, factor=f"{self.factor:.4g}", inverse=f"{1 / self.factor:.4g}"
        )


def nearest_scale(quantity: str, factor: float, facts: AcquisitionParameters) -> MatchedScale | None:
    """Return the scale mismatch that matches a measured factor, or None.

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
        "{quantity} is in metres: multiply it by 1000; lengths are in mm",
        _constant(1e-3),
    ),
    ScaleHypothesis(
        "centimetres",
        ("depth", "velocity"),
        "{quantity} is in centimetres: multiply it by 10; lengths are in mm",
        _constant(0.1),
    ),
    ScaleHypothesis(
        "micrometres",
        ("depth", "velocity"),
        "{quantity} is in micrometres: divide it by 1000; lengths are in mm",
        _constant(1e3),
    ),
    ScaleHypothesis(
        "whole_baseline",
        ("disparity",),
        "disparity is between the outermost cameras: divide it by {factor}; it is specified per step of s",
        _full_baseline,
        whole=True,
    ),
    ScaleHypothesis(
        "several_steps",
        ("disparity",),
        "disparity is over {factor} steps of the stage: divide it by {factor}; it is specified per step of s",
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
        "it is specified in mm per frame",
        _metres_per_second,
    ),
    ScaleHypothesis(
        "baselines",
        ("velocity",),
        "velocity is in baselines per frame: multiply it by baseline_mm; it is specified in mm per frame",
        _in_baselines,
    ),
    ScaleHypothesis(
        "pixels_of_the_map",
        ("disparity", "flow"),
        "{quantity} is in pixels of the subsampled image: multiply it by {inverse}; it is specified in camera pixels",
        _in_pixels_of_the_map,
    ),
    ScaleHypothesis(
        "image_widths",
        ("disparity", "flow"),
        "{quantity} is in image widths: multiply it by {inverse}; it is specified in pixels",
        _in_widths,
    ),
    ScaleHypothesis(
        "several_frames",
        ("flow", "velocity"),
        "{quantity} is {factor} times too large, as over {factor} frames or in another unit of time: divide it by "
        "{factor}; it is specified per frame",
        _integers(2, 64),
        whole=True,
    ),
)
"""All scale mismatches in order of preference."""


Map = NDArray[np.float64]


@dataclass(frozen=True)
class MeaningHypothesis:
    """A mismatch of meaning; ``apply`` maps true values (component, n) and ray lengths (n,) at Z = 1 to its values."""

    kind: str
    quantity: str
    message: str
    apply: Callable[[Map, Map, AcquisitionParameters], Map]


def select_meaning_hypotheses(quantity: str) -> tuple[MeaningHypothesis, ...]:
    """Return the mismatches of meaning that apply to a quantity."""
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
    # Zero depth or disparity leaves the other undefined.
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
        # If 1 / Z is nearly equal to the disparity, the estimate may only be biased.
        return values * (ratio if abs(np.log(abs(ratio))) >= np.log(LEAST_RATIO) else np.nan)

    return apply


def _component_signs(quantity: str, axes: str, *, right: str) -> tuple[MeaningHypothesis, ...]:
    """Return the sign mismatches of every proper subset of components."""
    count = len(axes)
    found = []
    for wrong in sorted(range(1, 2**count - 1), key=int.bit_count):
        named = [axes[place] for place in range(count) if wrong >> place & 1]
        signs = [-1 if wrong >> place & 1 else 1 for place in range(count)]
        plural = f"components of {quantity} have" if len(named) > 1 else f"component of {quantity} has"
        message = f"the {' and '.join(named)} {plural} the opposite sign: change it; {right}"
        found.append(MeaningHypothesis(f"sign_{''.join(named).lower()}", quantity, message, _signs(*signs)))
    return tuple(found)


MEANING_HYPOTHESES = (
    MeaningHypothesis(
        "sign", "depth", "depth has the opposite sign: use -depth; Z is positive in front of the camera", _signs(-1)
    ),
    MeaningHypothesis(
        "range",
        "depth",
        "depth is the distance along the ray: divide it by the ray's length, sqrt(1 + x'^2 + y'^2) with "
        "x' = (x - c_x) / f; depth is Z along the optical axis",
        _range,
    ),
    MeaningHypothesis(
        "disparity", "depth", "depth holds disparity: pass it as disparity=, or f V_X / disparity as depth=", _other
    ),
    MeaningHypothesis(
        "inverse_depth",
        "depth",
        "depth holds the inverse of depth in 1/mm: use 1 / depth",
        _inverse(1.0),
    ),
    MeaningHypothesis(
        "inverse_depth_in_metres",
        "depth",
        "depth holds the inverse of depth in 1/m: use 1000 / depth, in mm",
        _inverse(1000.0),
    ),
    MeaningHypothesis(
        "sign",
        "disparity",
        "disparity has the opposite sign, or the camera order is reversed: use -disparity; x_s = x_0 - disparity s",
        _signs(-1),
    ),
    MeaningHypothesis(
        "depth", "disparity", "disparity holds depth: pass it as depth=, or f V_X / depth as disparity=", _other
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
        "flow has the opposite sign, as with reversed time: use -flow; it points to the position of the point at t + 1",
        _signs(-1, -1),
    ),
    *_component_signs("flow", "xy", right="x points to the right and y downwards"),
    MeaningHypothesis(
        "components_exchanged",
        "flow",
        "the components of flow are exchanged: x comes first, then y; use array[::-1]",
        _order((1, 0)),
    ),
    MeaningHypothesis(
        "sign",
        "velocity",
        "velocity has the opposite sign, as with reversed time or of the camera: use -velocity; it is the velocity of "
        "the surface, and U_Z < 0 approaches the camera",
        _signs(-1, -1, -1),
    ),
    *_component_signs("velocity", "XYZ", right="X points to the right, Y down and Z away from the camera"),
    MeaningHypothesis(
        "components_exchanged",
        "velocity",
        "the X and Y components of velocity are exchanged: their order is X, Y, Z; use array[[1, 0, 2]]",
        _order((1, 0, 2)),
    ),
    MeaningHypothesis(
        "components_reversed",
        "velocity",
        "the components of velocity are in the order Z, Y, X: their order is X, Y, Z; use array[::-1]",
        _order((2, 1, 0)),
    ),
)
"""All mismatches of meaning, by quantity in order of preference."""


@dataclass(frozen=True)
class MismatchHypothesis:
    """At most one mismatch of position (``move``), of meaning (``turn``) and of scale (``scaled``) each."""

    move: PositionHypothesis | None = None
    turn: MeaningHypothesis | None = None
    scaled: MatchedScale | None = None

    @property
    def parts(self) -> int:
        """The number of mismatches."""
        return sum(part is not None for part in (self.move, self.turn, self.scaled))

    @property
    def factor(self) -> float:
        """The ratio of estimate to truth."""
        return 1.0 if self.scaled is None else self.scaled.factor

    def predicted(self, material: MismatchSamples, places: SamplePositions) -> Map:
        """Return the values that an estimate would have, shape (component, n); NaN where undefined."""
        source = places if self.move is None else self.move.source(places, material.grid)
        if source is None:
            return np.full((len(material.truth), len(places.y)), np.nan)
        values = material.truth_at(source)
        if self.turn is not None:
            values = self.turn.apply(values, material.rays[source.y, source.x], material.facts)
        return self.factor * values

    def mismatches(self, quantity: str, explained: float) -> list[ConventionMismatch]:
        """Return the mismatches of a quantity."""
        entries = []
        if self.turn is not None:
            entries.append((self.turn.kind, self.turn.message))
        if self.scaled is not None:
            entries.append((self.scaled.scale.kind, self.scaled.message(quantity)))
        if self.move is not None:
            entries.append((self.move.kind, self.move.message.format(quantity=quantity)))
        return [ConventionMismatch(kind, quantity, message, explained) for kind, message in entries]


NO_MISMATCH = MismatchHypothesis()
