"""Slips of meaning: what a value stands for, its sign, and the order of components."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.slips.facts import Facts
from scenetruth.scoring.slips.scales import LEAST_RATIO

__all__ = ["TURNS", "Turn", "turns_of"]

Map = NDArray[np.float64]


@dataclass(frozen=True)
class Turn:
    """A slip of meaning.

    Parameters
    ----------
    kind
        Its name.
    quantity
        The variable that it belongs to.
    message
        What is told.
    apply
        Gives the values with the slip from the true ones, shape (component, n), and the lengths of the rays there,
        scaled to Z = 1, shape (n,).
    """

    kind: str
    quantity: str
    message: str
    apply: Callable[[Map, Map, Facts], Map]


def turns_of(quantity: str) -> tuple[Turn, ...]:
    """Return the slips of meaning that a quantity can have."""
    return tuple(turn for turn in TURNS if turn.quantity == quantity)


def _signs(*signs: int) -> Callable[[Map, Map, Facts], Map]:
    column = np.array(signs, dtype=np.float64)[:, np.newaxis]

    def apply(values: Map, rays: Map, facts: Facts) -> Map:
        return np.asarray(column * values)

    return apply


def _order(places: Sequence[int]) -> Callable[[Map, Map, Facts], Map]:
    def apply(values: Map, rays: Map, facts: Facts) -> Map:
        return np.asarray(values[list(places)])

    return apply


def _over(values: Map, factor: float) -> Map:
    # Where depth or disparity is zero, nothing is known of the other.
    return np.asarray(np.divide(factor, values, out=np.full(values.shape, np.nan), where=values != 0))


def _range(values: Map, rays: Map, facts: Facts) -> Map:
    return values * rays


def _other(values: Map, rays: Map, facts: Facts) -> Map:
    """Return the disparity of a depth, or the depth of a disparity."""
    return _over(values, facts.focal_length_px * facts.baseline_mm)


def _inverse(unit_mm: float) -> Callable[[Map, Map, Facts], Map]:
    def apply(values: Map, rays: Map, facts: Facts) -> Map:
        return _over(values, unit_mm)

    return apply


def _inverse_of_disparity(unit_mm: float) -> Callable[[Map, Map, Facts], Map]:
    def apply(values: Map, rays: Map, facts: Facts) -> Map:
        product = facts.focal_length_px * facts.baseline_mm
        ratio = unit_mm / product if product else np.nan
        # Where 1 / Z is nearly as large as disparity is, the estimate may just be biased.
        return values * (ratio if abs(np.log(abs(ratio))) >= np.log(LEAST_RATIO) else np.nan)

    return apply


def _component_signs(quantity: str, axes: str, *, right: str) -> tuple[Turn, ...]:
    """Return the slips of sign of single components, and of several but not all."""
    count = len(axes)
    found = []
    for wrong in sorted(range(1, 2**count - 1), key=int.bit_count):
        named = [axes[place] for place in range(count) if wrong >> place & 1]
        signs = [-1 if wrong >> place & 1 else 1 for place in range(count)]
        plural = f"components of {quantity} have" if len(named) > 1 else f"component of {quantity} has"
        message = f"the {' and '.join(named)} {plural} the other sign: change it; {right}"
        found.append(Turn(f"sign_{''.join(named).lower()}", quantity, message, _signs(*signs)))
    return tuple(found)


TURNS = (
    Turn("sign", "depth", "depth has the other sign: give -depth; Z is positive in front of the camera", _signs(-1)),
    Turn(
        "range",
        "depth",
        "depth is the distance along the ray: divide it by the ray's length, sqrt(1 + x'^2 + y'^2) with "
        "x' = (x - c_x) / f; depth is Z along the optical axis here",
        _range,
    ),
    Turn("disparity", "depth", "depth holds disparity: give it as disparity=, or f V_X / disparity as depth=", _other),
    Turn(
        "inverse_depth",
        "depth",
        "depth holds the inverse of depth in 1/mm: give its inverse, 1 / depth",
        _inverse(1.0),
    ),
    Turn(
        "inverse_depth_in_metres",
        "depth",
        "depth holds the inverse of depth in 1/m: give 1000 / depth, which is in mm",
        _inverse(1000.0),
    ),
    Turn(
        "sign",
        "disparity",
        "disparity has the other sign, or the cameras the opposite order: give -disparity; x_s = x_0 - disparity s",
        _signs(-1),
    ),
    Turn("depth", "disparity", "disparity holds depth: give it as depth=, or f V_X / depth as disparity=", _other),
    Turn(
        "inverse_depth",
        "disparity",
        "disparity holds the inverse of depth in 1/mm: multiply it by f V_X",
        _inverse_of_disparity(1.0),
    ),
    Turn(
        "inverse_depth_in_metres",
        "disparity",
        "disparity holds the inverse of depth in 1/m: multiply it by f V_X / 1000",
        _inverse_of_disparity(1000.0),
    ),
    Turn(
        "sign",
        "flow",
        "flow has the other sign, as if time ran backwards: give -flow; it points to where the point is at t + 1 here",
        _signs(-1, -1),
    ),
    *_component_signs("flow", "xy", right="x counts to the right and y downwards"),
    Turn(
        "components_exchanged",
        "flow",
        "the components of flow are exchanged: x comes first, then y; give array[::-1]",
        _order((1, 0)),
    ),
    Turn(
        "sign",
        "velocity",
        "velocity has the other sign, as if time ran backwards or the camera moved: give -velocity; it is that of the "
        "surface, and U_Z < 0 comes nearer",
        _signs(-1, -1, -1),
    ),
    *_component_signs("velocity", "XYZ", right="X points to the right, Y down and Z away from the camera"),
    Turn(
        "components_exchanged",
        "velocity",
        "the X and Y components of velocity are exchanged: their order is X, Y, Z; give array[[1, 0, 2]]",
        _order((1, 0, 2)),
    ),
    Turn(
        "components_reversed",
        "velocity",
        "the components of velocity are in the order Z, Y, X: their order is X, Y, Z; give array[::-1]",
        _order((2, 1, 0)),
    ),
)
"""All slips of meaning, by quantity in the order in which they are preferred; a new one is an entry here."""
