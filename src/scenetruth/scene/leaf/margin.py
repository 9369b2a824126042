"""Margin of a flat leaf: closed formula from base to tip, with lobes, teeth and petiole."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.leaf.leaf_model import LeafForm

__all__ = ["Margin", "compute_entire_margin", "compute_half_width_mm", "compute_margin"]

Floats = NDArray[np.float64]

# The width is xi^base (1 - xi^m)^tip, with m from the position of the maximum, minus the reduction at the tip.
_BASE = {"ovate": 0.55, "lanceolate": 0.6, "cordate": 0.5, "elliptic": 0.5}
_WIDEST = {"ovate": 0.36, "lanceolate": 0.38, "cordate": 0.36, "elliptic": 0.5}
_TIP = {"acuminate": 1.0, "acute": 0.9, "round": 0.5}
_DRAWN_OUT = 0.7  # relative reduction of the width at the end of an acuminate tip,
_DRAWN_LENGTH = 0.13  # and its 1/e length relative to the leaf length

_GAP = 1.5  # gap in edges between the petiole and adjacent lobes at their separation
_FINE = 4000  # number of points for arc lengths
_WEDGE_DEG = 26.0  # half the angle at the end of a pointed tip, which keeps triangles regular,
_WEDGE = 15  # and its exponent in the position along the midrib


@dataclass(frozen=True, eq=False)
class Margin:
    """One side of the outline, as a polygon from its rear end on the axis to the tip.

    ``points_mm``: Points (a, b) with b >= 0, shape (n, 2); the first and last are on the axis b = 0.
    ``corners``: Indices of points to keep in a coarser polygon: ends, corners, and tips and notches of teeth.
    """

    points_mm: Floats
    corners: NDArray[np.intp]


def _get_tip_type(leaf: LeafForm) -> str:
    return leaf.tip or ("round" if leaf.outline == "elliptic" else "acuminate")


# Precomputed results of `solve_shift`, because the import of `brentq` takes 0.1 s.
SHIFTS = {
    (0.55, 0.36, 1.0): 1.0375875136128374,
    (0.55, 0.36, 0.9): 0.8596324995319141,
    (0.6, 0.38, 1.0): 1.03785825774929,
    (0.6, 0.38, 0.9): 0.848485388665106,
    (0.5, 0.36, 1.0): 1.1948996453714946,
    (0.5, 0.36, 0.9): 1.0208016621926106,
    (0.5, 0.5, 1.0): 2.6598611779191406,
    (0.5, 0.5, 0.9): 2.4222431303820606,
    (0.5, 0.5, 0.5): 1.0000000000000007,
}


def _shift(base: float, widest: float, tip: float) -> float:
    known = SHIFTS.get((base, widest, tip))
    return solve_shift(base, widest, tip) if known is None else known


@functools.cache
def solve_shift(base: float, widest: float, tip: float) -> float:
    """Return the exponent m that places the maximum of xi^base (1 - xi^m)^tip at a given position."""
    from scipy.optimize import brentq

    # The derivative vanishes where xi^m = base / (base + tip m).
    return float(brentq(lambda m: m * np.log(widest) - np.log(base / (base + tip * m)), 1e-3, 50.0))


def _relative_width(leaf: LeafForm, xi: Any) -> Any:
    tip, widest = _TIP[_get_tip_type(leaf)], _WIDEST[leaf.outline]
    # A round leaf that is widest far from its middle requires a blunt base.
    base = min(_BASE[leaf.outline], -0.8 * tip / np.log(widest))
    plain = xi**base * (1 - xi ** _shift(base, widest, tip)) ** tip
    if _get_tip_type(leaf) == "acuminate":
        plain *= 1 - _DRAWN_OUT * np.exp((xi - 1) / _DRAWN_LENGTH)
    return plain


@functools.lru_cache(maxsize=64)
def _largest(leaf: LeafForm) -> float:
    return float(_relative_width(leaf, np.linspace(0, 1, 4001)).max())


def compute_half_width_mm(leaf: LeafForm, a_mm: Floats) -> Floats:
    """Return the distance of the margin (without teeth, lobes or petiole) from the midrib."""
    if leaf.outline == "palmate":
        msg = "the margin of a palmate leaf is not a function of the position along the midrib"
        raise ValueError(msg)
    xi = np.clip(np.asarray(a_mm, dtype=np.float64) / leaf.length_mm, 0, 1)
    width: Floats = leaf.full_width_mm / 2 * _relative_width(leaf, xi) / _largest(leaf)
    if _get_tip_type(leaf) == "round":
        return width
    # The wedge avoids degenerate triangles at a slender end and is negligible elsewhere.
    wedge = np.tan(np.radians(_WEDGE_DEG)) * leaf.length_mm * (1 - xi) * xi**_WEDGE
    pointed: Floats = np.hypot(width, wedge)
    return pointed


def compute_entire_margin(leaf: LeafForm, count: int = _FINE) -> Floats:
    """Return the margin without teeth and petiole from base to tip, shape (count, 2)."""
    if leaf.lobe_sides:
        points = _palmate(leaf, toothed=False)[0]
        place = np.linspace(0, len(points) - 1, count)
        return np.column_stack([np.interp(place, np.arange(len(points)), column) for column in points.T])
    angle = np.linspace(0, np.pi, count)
    xi = np.sin(angle / 2) ** 2
    b = compute_half_width_mm(leaf, xi * leaf.length_mm)
    a = xi * leaf.length_mm - _shear_mm(leaf) * _lobe(angle)
    a[0], b[0], a[-1], b[-1] = 0.0, 0.0, leaf.length_mm, 0.0
    return np.column_stack([a, b])


def _lobe(angle: Floats) -> Floats:
    """Return the relative backward shift of the margin: zero at base and tip, largest near the base."""
    drawn: Floats = np.sin(angle) * np.cos(angle / 2) ** 9
    return drawn


@functools.lru_cache(maxsize=64)
def _shear_mm(leaf: LeafForm) -> float:
    """Return the shear for a given backward extent of the lobes."""
    if leaf.lobe_mm == 0:
        return 0.0
    from scipy.optimize import brentq

    angle = np.linspace(0, np.pi, 2001)

    def reach(shear: float) -> float:
        return float(-(np.sin(angle / 2) ** 2 - shear * _lobe(angle)).min()) * leaf.length_mm - leaf.lobe_mm

    return float(brentq(reach, 0.0, 3.0)) * leaf.length_mm


def compute_margin(leaf: LeafForm) -> Margin:
    """Return the margin with teeth and, if present, the petiole."""
    if leaf.lobe_sides:
        points, corners = _palmate(leaf)
        if leaf.petiole is not None:
            # The rearmost lobes point backwards along the petiole, and triangles need a gap in between.
            radius = leaf.petiole.diameter_mm / 2
            leaves = max(1.6 * radius, radius + _GAP * leaf.resolution_mm)
            points, corners = _stalked(points, corners, leaf.petiole.length_mm, radius, leaves)
        return Margin(points, corners)
    teeth = 0 if leaf.serration is None else leaf.serration.count_per_side
    points = compute_entire_margin(leaf, max(_FINE, 120 * teeth))
    corners = np.array([0, len(points) - 1])
    if leaf.serration is not None:
        points, corners = _serrated(points, leaf.serration.count_per_side, leaf.serration.depth_mm)
    if leaf.petiole is not None:
        radius = leaf.petiole.diameter_mm / 2
        points, corners = _stalked(points, corners, leaf.petiole.length_mm, radius, 1.6 * radius)
    return Margin(points, corners)


def _palmate(leaf: LeafForm, toothed: bool = True) -> tuple[Floats, NDArray[np.intp]]:
    """Return the margin of a palmate leaf from the insertion to the tip of the middle lobe."""
    sides = leaf.lobe_sides
    teeth = leaf.serration if toothed else None
    pieces, corners, used = [], [], 0
    for side in sides:
        points, kept = side.points_mm, np.array([0, len(side.points_mm) - 1])
        if teeth is not None:
            # Equal tooth spacing on all lobes, up to integer rounding.
            share = side.margin_mm / sides[-1].margin_mm
            count = max(round(teeth.count_per_side * share), 1)
            fine = np.linspace(0, len(points) - 1, max(len(points), 120 * count))
            points = np.column_stack([np.interp(fine, np.arange(len(points)), column) for column in points.T])
            points, kept = _serrated(points, count, teeth.depth_mm * min(1.0, share))
        points = side.in_leaf(points)
        if side.hand < 0:
            points, kept = points[::-1], len(points) - 1 - kept[::-1]
        # The end of each piece is the start of the next.
        pieces.append(points[:-1])
        corners.append(used + kept[:-1])
        used += len(points) - 1
    end = np.array([[leaf.length_mm, 0.0]])
    margin = np.concatenate([*pieces, end])
    margin[0] = 0.0
    return margin, np.concatenate([*corners, [used]])


def _arc_length(points: Floats) -> Floats:
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def _serrated(points: Floats, count: int, depth: float) -> tuple[Floats, NDArray[np.intp]]:
    """Cut notches into a margin; the teeth point forward along it."""
    arc = _arc_length(points) / _arc_length(points)[-1]
    tangent = np.gradient(points, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    outward = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    # Teeth between 6 % and 96 % of the margin, with smooth onset and end.
    span = np.clip((arc - 0.06) / 0.90, 0, 1)
    gentle = np.sin(np.pi * span) ** 0.5 * np.clip(np.sin(np.pi * span) * 4, 0, 1) ** 1.5
    phase = 2 * np.pi * count * span
    skew = 0.7
    # Smooth sawtooth, -1 to 1, with slow rise and fast fall behind the tip of the tooth.
    tooth = np.arctan2(skew * np.sin(phase), 1 + skew * np.cos(phase)) / np.arcsin(skew)
    cut = depth * gentle * (1 - tooth) / 2
    cut[(span <= 0) | (span >= 1)] = 0
    toothed = points - outward * cut[:, None]
    peak, notch = np.arccos(-skew), 2 * np.pi - np.arccos(-skew)
    turns = 2 * np.pi * np.arange(count)[:, None] + np.array([peak, notch])
    corners = np.searchsorted(phase, turns.ravel())
    return toothed, np.unique(np.concatenate([[0], corners, [len(points) - 1]]))


def _stalked(
    points: Floats, corners: NDArray[np.intp], length: float, radius: float, leaves: float
) -> tuple[Floats, NDArray[np.intp]]:
    """Prepend a petiole to a margin, blended by a quarter wave."""
    step = np.hypot(*np.diff(points[:2], axis=0)[0])
    # The margin separates from the petiole where it first exceeds this distance from the axis.
    join = int(np.argmax(points[:, 1] > leaves))
    start = points[join]
    reach = min(3 * radius, 0.8 * length, 0.5 * max(length + min(start[0], 0.0), 0.0))
    ahead = points[join + 1] - points[join]
    ahead /= np.linalg.norm(ahead)
    # A cubic from the edge of the petiole to the margin, tangent to both.
    foot = np.array([min(0.0, start[0]) - reach, radius]) if reach > 0 else start
    pull = np.linalg.norm(start - foot) * 0.9
    t = np.linspace(0, 1, 60)[:-1, None]
    blend = (
        (1 + 2 * t) * (1 - t) ** 2 * foot
        + t * (1 - t) ** 2 * pull * np.array([1.0, 0.0])
        + t**2 * (3 - 2 * t) * start
        + t**2 * (t - 1) * pull * ahead
    )
    count = max(int((length + foot[0]) / max(step, radius / 20)), 2)
    side = np.column_stack([np.linspace(-length, foot[0], count, endpoint=False), np.full(count, radius)])
    end = np.column_stack([np.full(10, -length), np.linspace(0, radius, 10, endpoint=False)])
    before = np.concatenate([end, side, blend])
    kept = corners[corners > join] - join + len(before)
    return np.concatenate([before, points[join:]]), np.concatenate([[0, len(end), len(end) + len(side)], kept])
