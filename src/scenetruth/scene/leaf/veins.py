"""Paths and widths of the veins of a leaf."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.leaf.leaf_model import LeafAppearance, LeafForm, LobeSide
from scenetruth.scene.leaf.margin import compute_entire_margin

__all__ = ["Vein", "make_main_veins", "make_side_veins"]

Floats = NDArray[np.float64]

# Full widths at half maximum of midrib and secondary veins at start and end, relative to the leaf length.
_MIDRIB = (0.017, 0.004)
_SIDE = (0.0090, 0.0028)
_STEPS = 400  # number of steps of a secondary vein, and step length relative to the leaf length:
_STEP = 0.0025
_NEAR = 0.22  # relative distance from margin to midrib at which they turn along the margin,
_END = 0.05  # and at which they end
_GRID = 240  # grid points of the distance map along the leaf


@dataclass(frozen=True, eq=False)
class Vein:
    """Vein as a polyline in the flat sheet, with full width at half maximum and contrast relative to the midrib."""

    points_mm: Floats
    width_mm: Floats
    strength: Floats


def make_midrib(leaf: LeafForm) -> Vein:
    """Return the midrib, including the petiole."""
    length = leaf.length_mm
    a = np.linspace(0, length, 200)
    width = length * (_MIDRIB[1] + (_MIDRIB[0] - _MIDRIB[1]) * (1 - a / length) ** 1.2)
    strength = 1 - 0.45 * (a / length) ** 1.5
    if leaf.petiole is not None:
        thick = 0.8 * leaf.petiole.diameter_mm
        width += max(thick - width[0], 0.0) * np.exp(-a / (2 * leaf.petiole.diameter_mm))
        a = np.concatenate([[-2 * leaf.petiole.length_mm], a])
        width, strength = np.concatenate([[width[0]], width]), np.concatenate([[1.0], strength])
    return Vein(np.column_stack([a, np.zeros_like(a)]), width, strength)


def make_main_veins(leaf: LeafForm) -> list[Vein]:
    """Return the midrib and, for palmate leaves, the veins to the tips of the other lobes."""
    veins = [make_midrib(leaf)]
    for side in leaf.lobe_sides:
        if side.hand > 0 and side.azimuth_rad > 0:
            share = np.linspace(0, 1, 200)
            ahead = side.in_leaf(np.column_stack([share * side.length_mm, np.zeros_like(share)]))
            width = side.length_mm * (_MIDRIB[1] + (0.85 * _MIDRIB[0] - _MIDRIB[1]) * (1 - share) ** 1.2)
            veins.extend(Vein(ahead * (1, sign), width, 0.95 - 0.45 * share**1.5) for sign in (-1, 1))
    return veins


def make_side_veins(leaf: LeafForm, texture: LeafAppearance, generator: np.random.Generator) -> list[Vein]:
    """Return the secondary veins of both sides, with individual random variation."""
    if leaf.lobe_sides:
        return _veins_of_lobes(leaf.lobe_sides, texture, generator)
    blade = _Blade(leaf.length_mm, leaf.full_width_mm, compute_entire_margin(leaf, 800))
    return _veins_of_blade(blade, texture.secondary_veins, texture, generator, leaf.outline == "cordate")


@dataclass(frozen=True, eq=False)
class _Blade:
    """Domain of secondary veins: midrib, and margin on the side b >= 0 from base to tip, shape (n, 2)."""

    length_mm: float
    width_mm: float
    margin_mm: Floats


def _veins_of_lobes(sides: tuple[LobeSide, ...], texture: LeafAppearance, generator: np.random.Generator) -> list[Vein]:
    """Return the secondary veins of a palmate leaf, whose lobe sides are limited by the line through the sinus."""
    longest = sides[-1].length_mm
    veins = []
    for side in sides:
        sinus = side.points_mm[0] * np.linspace(0, 1, 60, endpoint=False)[:, None]
        margin = np.concatenate([sinus, side.points_mm[::8], side.points_mm[-1:]])
        blade = _Blade(side.length_mm, 2 * float(margin[:, 1].max()), margin)
        count = max(round(texture.secondary_veins * side.length_mm / longest), 1)
        for vein in _veins_of_blade(blade, count, texture, generator, False):
            # Veins with b < 0 belong to the other half of the leaf.
            points, sign = vein.points_mm, np.sign(vein.points_mm[-1, 1])
            points = side.in_leaf(points * (1, sign)) * (1, sign)
            veins.append(Vein(points, vein.width_mm, vein.strength))
    return veins


def _veins_of_blade(
    blade: _Blade, count: int, texture: LeafAppearance, generator: np.random.Generator, lobed_base: bool
) -> list[Vein]:
    length = blade.length_mm
    depth = _Depth(blade)
    start, angle, side = [], [], []
    for sign in (-1, 1):
        place = (np.arange(count) + (0.35 if sign > 0 else 0.0) + 0.15 * generator.uniform(-1, 1, count)) / count
        place = 0.015 + 0.86 * np.clip(place, 0, 1) ** 0.95
        # Secondary veins near the base leave the midrib at larger angles than near the tip.
        turn = texture.secondary_angle_deg * (1.12 - 0.30 * place) + generator.normal(0, 2.0, count)
        if lobed_base:
            place = np.concatenate([[0.004, 0.008, 0.012], place])
            turn = np.concatenate([np.array([118.0, 97.0, 76.0]) + generator.normal(0, 3.0, 3), turn])
        start.append(place * length)
        angle.append(np.radians(turn))
        side.append(np.full(len(place), sign))
    here = np.column_stack([np.concatenate(start), np.zeros(sum(map(len, start)))])
    heading = np.concatenate(angle)
    direction = np.column_stack([np.cos(heading), np.sin(heading)])
    wobble = np.cumsum(generator.normal(0, 0.018, (_STEPS, len(here))), axis=0)
    wobble -= np.linspace(0, 1, _STEPS)[:, None] * wobble[-1]
    path, near_margin, inner = [here], [np.zeros(len(here))], [np.ones(len(here))]
    step, young = _STEP * length, 0.05 * blade.width_mm
    for k in range(_STEPS):
        distance, outward = depth.at(here)
        # Along the margin, towards the tip.
        along = np.column_stack([outward[:, 1], -outward[:, 0]])
        # Relative position between midrib, 1, and margin, 0.
        share = np.clip(distance / np.maximum(distance + here[:, 1], 1e-9), 0, 1)
        # Near the midrib the margin of base and tip has no effect.
        pull = np.exp(-((share / _NEAR) ** 2)) * (1 - np.exp(-((here[:, 1] / young) ** 2)))
        direction = direction + (0.16 * pull)[:, None] * (along - direction)
        # General slight bend towards the tip.
        direction = direction + 0.0035 * np.array([1.0, 0.0])
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        turn = wobble[k] * 0.25
        moving = np.column_stack(
            [
                direction[:, 0] * np.cos(turn) - direction[:, 1] * np.sin(turn),
                direction[:, 0] * np.sin(turn) + direction[:, 1] * np.cos(turn),
            ]
        )
        here = here + step * moving
        path.append(here)
        near_margin.append(near_margin[-1] + step * pull)
        inner.append(np.where(here[:, 1] > young, share, 1.0))
    tracks, travelled, depths = np.stack(path), np.stack(near_margin), np.stack(inner)
    veins = []
    spacing = 0.9 * length / count
    for index, sign in enumerate(np.concatenate(side)):
        # End near the next vein along the margin, too close to the margin, or on turning inwards.
        off = tracks[:, index, 1]
        over = (travelled[:, index] > 1.1 * spacing) | (depths[:, index] < _END)
        over |= off < 0.75 * np.maximum.accumulate(off)
        last = int(np.argmax(over)) if over.any() else _STEPS
        if last < 8:
            continue
        share = np.linspace(0, 1, last + 1)
        thick = length * (_SIDE[1] + (_SIDE[0] - _SIDE[1]) * (1 - share) ** 1.3)
        vigour = 1 - 0.35 * max(here[index, 0] / length - 0.5, 0)
        strength = vigour * (0.95 - 0.55 * share**1.5) * np.clip((1 - share) / 0.12, 0, 1)
        veins.append(Vein(tracks[: last + 1, index] * (1, sign), thick * vigour, strength))
    return veins


class _Depth:
    """Distance from the margin inside the blade, on the side b >= 0, and the direction towards it."""

    def __init__(self, blade: _Blade) -> None:
        from scipy.ndimage import distance_transform_edt, gaussian_filter

        from scenetruth.scene.leaf.leaf_kernels import inside

        margin, length, width = blade.margin_mm, blade.length_mm, blade.width_mm
        behind = -float(margin[:, 0].min())
        self._pitch = (length + behind) / _GRID
        edge = 6 * self._pitch
        self._low = np.array([-behind - edge, -width / 2 - edge])
        counts = np.ceil((np.array([length + edge, width / 2 + edge]) - self._low) / self._pitch)
        a, b = (low + self._pitch * np.arange(int(n) + 1) for low, n in zip(self._low, counts, strict=True))
        grid = np.stack(np.meshgrid(a, b), axis=-1)
        outline = np.concatenate([margin, margin[-2:0:-1] * (1, -1)])
        within = inside(grid.reshape(-1, 2), outline).reshape(grid.shape[:2])
        signed = distance_transform_edt(within) - distance_transform_edt(~within)
        self._values: Any = gaussian_filter(signed * self._pitch, 1.5)
        self._slopes: Any = np.gradient(gaussian_filter(signed * self._pitch, 4.0), self._pitch)

    def at(self, points: Floats) -> tuple[Floats, Floats]:
        """Return the distance, negative outside, shape (n,), and the unit vector towards the margin, shape (n, 2)."""
        from scipy.ndimage import map_coordinates

        place = ((points - self._low) / self._pitch).T[::-1]
        distance, down, right = (
            map_coordinates(field, place, order=1, mode="nearest") for field in (self._values, *self._slopes)
        )
        out = -np.column_stack([right, down])
        return distance, out / np.maximum(np.linalg.norm(out, axis=1), 1e-9)[:, None]
