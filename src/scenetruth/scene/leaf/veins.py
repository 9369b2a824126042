"""Paths and widths of the veins of a leaf."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.leaf.leaf_model import LeafAppearance, LeafForm
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
    if not leaf.lobe_sides:
        blade = _Blade(leaf.length_mm, leaf.full_width_mm, compute_entire_margin(leaf, 800))
        plan = _plan_veins(blade, texture.secondary_veins, texture, generator, leaf.outline == "cordate")
        return _walk_veins([plan])[0]
    longest = leaf.lobe_sides[-1].length_mm
    plans = []
    for side in leaf.lobe_sides:
        # The sides of lobes are limited by the line through the sinus.
        sinus = side.points_mm[0] * np.linspace(0, 1, 60, endpoint=False)[:, None]
        margin = np.concatenate([sinus, side.points_mm[::8], side.points_mm[-1:]])
        blade = _Blade(side.length_mm, 2 * float(margin[:, 1].max()), margin)
        count = max(round(texture.secondary_veins * side.length_mm / longest), 1)
        plans.append(_plan_veins(blade, count, texture, generator, False))
    veins = []
    for side, of_side in zip(leaf.lobe_sides, _walk_veins(plans), strict=True):
        for vein in of_side:
            # Veins with b < 0 belong to the other half of the leaf.
            points, sign = vein.points_mm, np.sign(vein.points_mm[-1, 1])
            points = side.in_leaf(points * (1, sign)) * (1, sign)
            veins.append(Vein(points, vein.width_mm, vein.strength))
    return veins


@dataclass(frozen=True, eq=False)
class _Blade:
    """Domain of secondary veins: midrib, and margin on the side b >= 0 from base to tip, shape (n, 2)."""

    length_mm: float
    width_mm: float
    margin_mm: Floats


@dataclass(frozen=True, eq=False)
class _Plan:
    """Where the secondary veins of a blade start, at which angles to the midrib, on which side, and how they wander.

    ``start_mm``, ``angle_rad``, ``side``: Shape (n,); ``wander_rad``: Turns in each step, shape (steps, n).
    """

    blade: _Blade
    spacing_mm: float
    start_mm: Floats
    angle_rad: Floats
    side: NDArray[np.int64]
    wander_rad: Floats


def _plan_veins(
    blade: _Blade, count: int, texture: LeafAppearance, generator: np.random.Generator, lobed_base: bool
) -> _Plan:
    start, angle, side = [], [], []
    for sign in (-1, 1):
        place = (np.arange(count) + (0.35 if sign > 0 else 0.0) + 0.15 * generator.uniform(-1, 1, count)) / count
        place = 0.015 + 0.86 * np.clip(place, 0, 1) ** 0.95
        # Secondary veins near the base leave the midrib at larger angles than near the tip.
        turn = texture.secondary_angle_deg * (1.12 - 0.30 * place) + generator.normal(0, 2.0, count)
        if lobed_base:
            place = np.concatenate([[0.004, 0.008, 0.012], place])
            turn = np.concatenate([np.array([118.0, 97.0, 76.0]) + generator.normal(0, 3.0, 3), turn])
        start.append(place * blade.length_mm)
        angle.append(np.radians(turn))
        side.append(np.full(len(place), sign))
    number = sum(map(len, start))
    wobble = np.cumsum(generator.normal(0, 0.018, (_STEPS, number)), axis=0)
    wobble -= np.linspace(0, 1, _STEPS)[:, None] * wobble[-1]
    spacing = 0.9 * blade.length_mm / count
    return _Plan(blade, spacing, np.concatenate(start), np.concatenate(angle), np.concatenate(side), wobble * 0.25)


def _walk_veins(plans: list[_Plan]) -> list[list[Vein]]:
    """Return the secondary veins of each blade; those of all blades advance together, step by step."""
    from scenetruth.scene.leaf.leaf_kernels import look_up_linearly

    counts = [len(plan.start_mm) for plan in plans]
    depths = [_Depth(plan.blade) for plan in plans]
    bounds = [slice(end - count, end) for count, end in zip(counts, np.cumsum(counts), strict=True)]
    of_each = np.repeat(np.arange(len(plans)), counts)
    fields = np.concatenate([depth.fields.reshape(3, -1) for depth in depths], axis=1)
    sizes = np.array([depth.fields.shape[1:] for depth in depths], dtype=np.int64)
    first = np.cumsum([0, *(depth.fields[0].size for depth in depths[:-1])])
    low_a, low_b = np.array([depth.low_mm for depth in depths])[of_each].T.copy()
    pitch = np.array([depth.pitch_mm for depth in depths])[of_each]
    step = _STEP * np.array([plan.blade.length_mm for plan in plans])[of_each]
    young = 0.05 * np.array([plan.blade.width_mm for plan in plans])[of_each]

    a, b = np.concatenate([plan.start_mm for plan in plans]), np.zeros(len(of_each))
    heading = np.concatenate([plan.angle_rad for plan in plans])
    ahead, out = np.cos(heading), np.sin(heading)
    turn = np.concatenate([plan.wander_rad for plan in plans], axis=1)
    cosine, sine = np.cos(turn), np.sin(turn)
    # Places, distances travelled along the margin, and relative depths after every step.
    tracks, travelled = np.empty((_STEPS + 1, len(a), 2)), np.zeros((_STEPS + 1, len(a)))
    inner = np.ones((_STEPS + 1, len(a)))
    tracks[0] = np.column_stack([a, b])
    distance, along_a, along_b = np.empty((3, len(a)))
    for k in range(_STEPS):
        look_up_linearly(
            fields, sizes, first, of_each, (b - low_b) / pitch, (a - low_a) / pitch, (distance, along_b, along_a)
        )
        # Outwards is down the slope of the distance; along the margin, towards the tip, is a right angle to it.
        slope = np.maximum(np.sqrt(along_a * along_a + along_b * along_b), 1e-9)
        margin_a, margin_b = -along_b / slope, along_a / slope
        # Relative position between midrib, 1, and margin, 0.
        share = np.clip(distance / np.maximum(distance + b, 1e-9), 0, 1)
        # Near the midrib the margin of base and tip has no effect.
        pull = np.exp(-((share / _NEAR) ** 2)) * (1 - np.exp(-((b / young) ** 2)))
        # And a general slight bend towards the tip.
        ahead = ahead + 0.16 * pull * (margin_a - ahead) + 0.0035
        out = out + 0.16 * pull * (margin_b - out)
        norm = np.sqrt(ahead * ahead + out * out)
        ahead, out = ahead / norm, out / norm
        a = a + step * (ahead * cosine[k] - out * sine[k])
        b = b + step * (ahead * sine[k] + out * cosine[k])
        tracks[k + 1, :, 0], tracks[k + 1, :, 1] = a, b
        travelled[k + 1] = travelled[k] + step * pull
        inner[k + 1] = np.where(b > young, share, 1.0)
    return [
        _end_veins(plan, tracks[:, part], travelled[:, part], inner[:, part])
        for plan, part in zip(plans, bounds, strict=True)
    ]


def _end_veins(plan: _Plan, tracks: Floats, travelled: Floats, depths: Floats) -> list[Vein]:
    """Return the veins up to their ends, with their widths and contrasts."""
    length, veins = plan.blade.length_mm, []
    for index, sign in enumerate(plan.side):
        # End near the next vein along the margin, too close to the margin, or on turning inwards.
        off = tracks[:, index, 1]
        over = (travelled[:, index] > 1.1 * plan.spacing_mm) | (depths[:, index] < _END)
        over |= off < 0.75 * np.maximum.accumulate(off)
        last = int(np.argmax(over)) if over.any() else _STEPS
        if last < 8:
            continue
        share = np.linspace(0, 1, last + 1)
        thick = length * (_SIDE[1] + (_SIDE[0] - _SIDE[1]) * (1 - share) ** 1.3)
        vigour = 1 - 0.35 * max(tracks[-1, index, 0] / length - 0.5, 0)
        strength = vigour * (0.95 - 0.55 * share**1.5) * np.clip((1 - share) / 0.12, 0, 1)
        veins.append(Vein(tracks[: last + 1, index] * (1, sign), thick * vigour, strength))
    return veins


class _Depth:
    """Distance from the margin inside the blade, negative outside, and its slopes along b and a, on a grid.

    ``fields``: Shape (3, rows along b, columns along a), the first point at ``low_mm``, in steps of ``pitch_mm``.
    """

    def __init__(self, blade: _Blade) -> None:
        from scipy.ndimage import distance_transform_edt, gaussian_filter

        from scenetruth.scene.leaf.leaf_kernels import inside

        margin, length, width = blade.margin_mm, blade.length_mm, blade.width_mm
        behind = -float(margin[:, 0].min())
        self.pitch_mm = (length + behind) / _GRID
        edge = 6 * self.pitch_mm
        self.low_mm = np.array([-behind - edge, -width / 2 - edge])
        counts = np.ceil((np.array([length + edge, width / 2 + edge]) - self.low_mm) / self.pitch_mm)
        a, b = (low + self.pitch_mm * np.arange(int(n) + 1) for low, n in zip(self.low_mm, counts, strict=True))
        grid = np.stack(np.meshgrid(a, b), axis=-1)
        outline = np.concatenate([margin, margin[-2:0:-1] * (1, -1)])
        within = inside(grid.reshape(-1, 2), outline).reshape(grid.shape[:2])
        signed = distance_transform_edt(within) - distance_transform_edt(~within)
        values: Floats = gaussian_filter(signed * self.pitch_mm, 1.5)
        slopes = np.gradient(gaussian_filter(signed * self.pitch_mm, 4.0), self.pitch_mm)
        self.fields = np.stack([values, *slopes])
