"""The lobes of a palmate leaf: their directions and lengths, and a smooth curve for each of their sides."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["LobeSide", "lobe_sides", "narrowest_lobe_mm"]

Floats = NDArray[np.float64]

_HINDMOST_DEG = 144.0  # direction of the hindmost lobe before the width is given,
_SHORTER = 0.44  # and by how much it is shorter than the middle one, as a part
_TIP_DEG = {"acuminate": 20.0, "acute": 30.0}  # half the angle at the tips
_FULL_FORM = 0.3  # from this cut on lobes have their full form; without a cut the tips are joined by straight lines
_ROUND = 0.4  # how far the sinus is rounded, as a part of half the lobe's width there
_STEPS = 1200


@dataclass(frozen=True, eq=False)
class LobeSide:
    """One side of a lobe whose tip has b >= 0.

    Parameters
    ----------
    azimuth_rad
        Direction of the lobe, from a towards b.
    length_mm
        Its length from the insertion of the petiole to its tip.
    hand
        1: the side that looks backwards, -1: the one that looks forwards. The middle lobe has only the first.
    points_mm
        Margin in the lobe's own frame (x along its axis, y >= 0 away from it) from the sinus, or from the insertion, to
        the tip; shape (n, 2).
    """

    azimuth_rad: float
    length_mm: float
    hand: int
    points_mm: Floats

    @property
    def margin_mm(self) -> float:
        """Length of the margin."""
        return float(np.hypot(*np.diff(self.points_mm, axis=0).T).sum())

    def in_leaf(self, points_mm: Floats) -> Floats:
        """Return points (x, y) of the lobe's frame as (a, b), shape (n, 2)."""
        x, y = points_mm[:, 0], self.hand * points_mm[:, 1]
        c, s = np.cos(self.azimuth_rad), np.sin(self.azimuth_rad)
        return np.column_stack([c * x - s * y, s * x + c * y])


@functools.lru_cache(maxsize=64)
def lobe_sides(lobes: int, cut: float, tip: str, length_mm: float, width_mm: float) -> tuple[LobeSide, ...]:
    """Return the sides of the lobes of the half with b >= 0, from the rear of the leaf to its tip.

    Parameters
    ----------
    lobes
        Number of lobes of the whole leaf, odd.
    cut
        How far the sinuses reach from the line between two tips, 0, to the insertion, 1.
    tip
        ``acuminate`` or ``acute``.
    length_mm, width_mm
        Length of the middle lobe from the insertion, and largest width of the leaf.
    """
    turn = np.linspace(0, np.radians(_HINDMOST_DEG), (lobes + 1) // 2)
    reach = length_mm * (1 - _SHORTER * (turn / turn[-1]) ** 1.6)
    tips = reach[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    stretch = width_mm / 2 / tips[:, 1].max()
    # The widest place is a tip, or very nearly: this converges at once.
    for _ in range(50):
        sides = _sides(tips * (1, stretch), cut, np.radians(_TIP_DEG[tip]))
        half = max(float(side.in_leaf(side.points_mm)[:, 1].max()) for side in sides)
        if abs(half / (width_mm / 2) - 1) < 1e-12:
            break
        stretch *= width_mm / 2 / half
    return tuple(sides)


def narrowest_lobe_mm(sides: tuple[LobeSide, ...]) -> float:
    """Return the width of the narrowest lobe."""
    off = [float(side.points_mm[:, 1].max()) for side in sides]
    return min([2 * off[-1], *(one + other for one, other in zip(off[:-1:2], off[1::2], strict=True))])


def _sides(tips: Floats, cut: float, sharp: float) -> list[LobeSide]:
    azimuth, length = np.arctan2(tips[:, 1], tips[:, 0]), np.hypot(*tips.T)
    last = len(tips) - 1
    sides = [LobeSide(float(azimuth[last]), float(length[last]), 1, _rear(length[last], np.pi - azimuth[last], sharp))]
    for outer in range(last, 0, -1):
        inner = outer - 1
        half = (azimuth[outer] - azimuth[inner]) / 2
        # Where the line between both tips crosses the line half-way between both lobes.
        crossing = 2 * length[inner] * length[outer] * np.cos(half) / (length[inner] + length[outer])
        for index, hand in ((outer, -1), (inner, 1)):
            points = _side(length[index], (1 - cut) * crossing, half, min(cut / _FULL_FORM, 1.0), sharp)
            sides.append(LobeSide(float(azimuth[index]), float(length[index]), hand, points))
    return sides


def _side(length: float, sinus: float, half: float, form: float, sharp: float) -> Floats:
    """Return a side from the sinus, at a distance and an angle from the lobe's axis, to the tip.

    All control points lie between the axis and the line through the sinus: neighbours never meet.
    """
    start = sinus * np.array([np.cos(half), np.sin(half)])
    free, off = length - start[0], start[1]
    straight = start + np.linspace(0, 1, 5)[:, None] * ((length, 0.0) - start)
    lobed = np.array(
        [
            start,
            # Across the sinus, so that both sides of it are one smooth curve.
            start + _ROUND * off * np.array([np.sin(half), -np.cos(half)]),
            # The lobe is widest beyond the sinus; at 1 + 0.42 free / start it would be on the line through the sinus.
            (start[0] + 0.42 * free, off * (1 + min(0.45, 0.35 * free / start[0]))),
            (length - 0.34 * free, 0.34 * free * np.tan(sharp)),
            (length, 0.0),
        ]
    )
    return _bezier(straight + form * (lobed - straight))


def _rear(length: float, gap: float, sharp: float) -> Floats:
    """Return the rear side of the hindmost lobe, from the insertion; the gap is its angle with the petiole."""
    control = [
        (0.0, 0.0),
        (0.22 * length, 0.22 * length * np.tan(0.1 * gap)),
        (0.48 * length, 0.48 * length * min(0.7, np.tan(0.88 * gap))),
        (0.78 * length, 0.22 * length * np.tan(sharp)),
        (length, 0.0),
    ]
    return _bezier(np.array(control))


def _bezier(control: Floats) -> Floats:
    """Return points of the curve of fourth order."""
    t = np.linspace(0, 1, _STEPS)[:, None]
    points: Floats = control[None, :, :].repeat(_STEPS, axis=0)
    while points.shape[1] > 1:
        points = points[:, :-1] + t[:, None] * (points[:, 1:] - points[:, :-1])
    return points[:, 0]
