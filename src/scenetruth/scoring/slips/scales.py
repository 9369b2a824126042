"""Slips of scale: units, steps and intervals that a value is counted in."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from scenetruth.scoring.slips.facts import Facts

__all__ = ["LEAST_RATIO", "SCALES", "Scale", "Scaled", "nearest_scale"]

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
class Scale:
    """A slip of scale.

    Parameters
    ----------
    kind
        Its name.
    quantities
        The variables that it belongs to.
    message
        What is told, with ``{quantity}``, ``{factor}`` (by how much values are too large) and ``{inverse}``.
    factors
        Gives the factors by which values with the slip are too large.
    whole
        Whether the factors are whole numbers that follow each other.
    """

    kind: str
    quantities: tuple[str, ...]
    message: str
    factors: Callable[[Facts], Sequence[float]]
    whole: bool = False

    def reach(self, factor: float) -> float:
        """Return by how much the logarithm of a measured factor may miss one of `factors`."""
        reach = min(_SHARE * abs(math.log(factor)), _LARGEST)
        if self.whole and factor <= _NAMED_APART:
            reach = min(reach, _BETWEEN * math.log1p(1 / factor))
        return reach


@dataclass(frozen=True)
class Scaled:
    """A slip of scale, and by how much values are too large."""

    scale: Scale
    factor: float

    def message(self, quantity: str) -> str:
        """Return what is told."""
        return self.scale.message.format(
            quantity=quantity, factor=f"{self.factor:.4g}", inverse=f"{1 / self.factor:.4g}"
        )


def nearest_scale(quantity: str, factor: float, facts: Facts) -> Scaled | None:
    """Return the slip of scale that a measured factor belongs to, or None.

    Parameters
    ----------
    quantity
        The variable.
    factor
        By how much the values are too large.
    facts
        Of the camera and the maps.

    Examples
    --------
    >>> facts = Facts(500.0, 5.0, 1.0, 5, 1.0, 640.0)
    >>> nearest_scale("depth", 0.00102, facts).scale.kind, nearest_scale("disparity", 3.97, facts).factor
    ('metres', 4.0)
    >>> nearest_scale("disparity", 2.5, facts) is None
    True
    """
    if not (math.isfinite(factor) and factor > 0):
        return None
    for scale in SCALES:
        if quantity not in scale.quantities:
            continue
        likely = [value for value in scale.factors(facts) if abs(math.log(value)) >= math.log(LEAST_RATIO)]
        near = [value for value in likely if abs(math.log(factor / value)) <= scale.reach(value)]
        if near:
            return Scaled(scale, min(near, key=lambda value: abs(math.log(factor / value))))
    return None


def _constant(factor: float) -> Callable[[Facts], Sequence[float]]:
    def factors(facts: Facts) -> Sequence[float]:
        return (factor,)

    return factors


def _whole_numbers(least: int, most: int) -> Callable[[Facts], Sequence[float]]:
    numbers = tuple(float(number) for number in range(least, most + 1))

    def factors(facts: Facts) -> Sequence[float]:
        return numbers

    return factors


def _whole_baseline(facts: Facts) -> Sequence[float]:
    return (float(facts.positions - 1),) if facts.positions is not None and facts.positions > 2 else ()


def _per_second(facts: Facts) -> Sequence[float]:
    return (1 / facts.frame_interval_s,)


def _metres_per_second(facts: Facts) -> Sequence[float]:
    return (1e-3 / facts.frame_interval_s,)


def _in_baselines(facts: Facts) -> Sequence[float]:
    return (1 / abs(facts.baseline_mm),) if facts.baseline_mm else ()


def _in_pixels_of_the_map(facts: Facts) -> Sequence[float]:
    return (1 / facts.step_px,)


def _in_widths(facts: Facts) -> Sequence[float]:
    return (1 / facts.width_px,)


SCALES = (
    Scale(
        "metres",
        ("depth", "velocity"),
        "{quantity} is in metres: multiply it by 1000; lengths are in mm here",
        _constant(1e-3),
    ),
    Scale(
        "centimetres",
        ("depth", "velocity"),
        "{quantity} is in centimetres: multiply it by 10; lengths are in mm here",
        _constant(0.1),
    ),
    Scale(
        "micrometres",
        ("depth", "velocity"),
        "{quantity} is in micrometres: divide it by 1000; lengths are in mm here",
        _constant(1e3),
    ),
    Scale(
        "whole_baseline",
        ("disparity",),
        "disparity is that between the outermost cameras: divide it by {factor}; it is per step of s here",
        _whole_baseline,
        whole=True,
    ),
    Scale(
        "several_steps",
        ("disparity",),
        "disparity is that over {factor} steps of the stage: divide it by {factor}; it is per step of s here",
        _whole_numbers(2, 8),
        whole=True,
    ),
    Scale(
        "per_second",
        ("flow", "velocity"),
        "{quantity} is per second: divide it by {factor}, that is, multiply it by frame_interval_s; it is per frame",
        _per_second,
    ),
    Scale(
        "metres_per_second",
        ("velocity",),
        "velocity is in metres per second: multiply it by {inverse}, that is, by 1000 and frame_interval_s; "
        "it is in mm per frame here",
        _metres_per_second,
    ),
    Scale(
        "baselines",
        ("velocity",),
        "velocity is in baselines per frame: multiply it by baseline_mm; it is in mm per frame here",
        _in_baselines,
    ),
    Scale(
        "pixels_of_the_map",
        ("disparity", "flow"),
        "{quantity} is in pixels of the thinned image: multiply it by {inverse}; it is in pixels of the camera here",
        _in_pixels_of_the_map,
    ),
    Scale(
        "image_widths",
        ("disparity", "flow"),
        "{quantity} is in widths of the image: multiply it by {inverse}; it is in pixels here",
        _in_widths,
    ),
    Scale(
        "several_frames",
        ("flow", "velocity"),
        "{quantity} is {factor} times too large, as over {factor} frames or in another unit of time: divide it by "
        "{factor}; it is per frame here",
        _whole_numbers(2, 64),
        whole=True,
    ),
)
"""All slips of scale in the order in which they are preferred; a new one is an entry here."""
