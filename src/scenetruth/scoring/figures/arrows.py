"""The figure of the velocities as arrows that stand on the reconstructed surface."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.figures._common import BLUE, ORANGE, FigureInfo, new_figure, save
from scenetruth.scoring.figures._mesh import (
    Surface,
    View,
    add_polygons,
    add_surface,
    surface_axes,
    surface_of,
    texture,
)
from scenetruth.scoring.figures._views import Views

__all__ = ["arrow_factor", "draw_velocity_arrows"]

Points = NDArray[np.float64]

_VIEW = View(30.0, -70.0)
_ACROSS = 20
"""Arrows along the longer side of the image."""
_FACTOR = 5.0
"""Length of an arrow in mm for 1 mm per frame, as in the paper."""
_LONGEST = 0.4
"""Longest arrow as a part of the extent: single wrong velocities would make everything else small."""


def draw_velocity_arrows(views: Views, folder: Path) -> FigureInfo:
    """Draw the estimated velocities as arrows on the estimated surface."""
    points, velocities = views.surface_points(), views.velocities()
    surface = surface_of(points, views.map_focal_length_px)
    extent = float(np.ptp(surface.limits, axis=1).max())
    tails, vectors = _pick(points, velocities, surface)
    factor = arrow_factor(vectors, extent)
    vectors = vectors * factor
    shown = _in_front(tails, surface, extent)
    tails, vectors = tails[shown], vectors[shown]
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    cut = lengths[:, 0] > _LONGEST * extent
    vectors = np.where(cut[:, None], vectors * (_LONGEST * extent / np.where(cut[:, None], lengths, 1.0)), vectors)

    figure = new_figure(7.4, 5.8, layout=None)
    tips = tails + vectors
    limits = surface.limits
    if len(tips):
        limits = np.stack([np.minimum(limits[:, 0], tips.min(axis=0)), np.maximum(limits[:, 1], tips.max(axis=0))], -1)
    axes = surface_axes(figure, (0.0, 0.02, 0.93, 0.92), limits, _VIEW)
    grey = 0.62 + 0.33 * texture(views.image, surface)
    add_surface(axes, surface, np.repeat(grey[:, None], 3, axis=1))
    arrows = _arrows(tails, vectors, extent)
    add_polygons(axes, arrows[~cut], color=BLUE, zorder=2)
    add_polygons(axes, arrows[cut], color=ORANGE, zorder=2)
    title = f"Estimated velocities × {factor:g} on the surface, t = {views.frame}"
    figure.text(0.03, 0.95, title, fontsize="large")
    save(figure, folder / "velocity_arrows.png")
    caption = (
        f"Arrows stand on the reconstructed surface; 1 mm/frame is drawn {factor:g}\N{NO-BREAK SPACE}mm long. "
        "Only single pixels are shown, nothing is averaged, and arrows behind the surface are left out. "
        + ("Orange arrows are longer than drawn. " if cut.any() else "")
        + "Where a rigid object translates, arrows should be parallel and equally long."
    )
    return FigureInfo("velocity_arrows.png", title, caption)


def arrow_factor(vectors: Points, extent: float) -> float:
    """Return the arrows' length for 1 mm per frame: the paper's 5, or a round number if those would not be legible.

    Parameters
    ----------
    vectors
        Velocities, mm per frame, shape (n, 3).
    extent
        The largest side of the box around the surface, mm.

    Returns
    -------
    float
        5, or the number 1, 2 or 5 times a power of ten with which nine tenths of the arrows are shorter than about
        a tenth of the extent.
    """
    # Most of the picture may be at rest.
    length = float(np.percentile(np.linalg.norm(vectors, axis=1), 90)) if len(vectors) else 0.0
    # Velocities that are all but zero are noise; enlarging them would show nothing else.
    if length < 1e-6 * extent or 0.015 * extent <= _FACTOR * length <= 0.4 * extent:
        return _FACTOR
    wanted = 0.1 * extent / length
    power = 10.0 ** math.floor(math.log10(wanted))
    return power * max(step for step in (1, 2, 5) if step * power <= wanted * (1 + 1e-9))


def _pick(points: Points, velocities: Points, surface: Surface) -> tuple[Points, Points]:
    """Return positions and velocities at a coarse grid of those pixels that the surface shows."""
    height, width = points.shape[:2]
    spacing = max(1, round(max(height, width) / _ACROSS))
    grid = np.zeros((height, width), dtype=bool)
    grid[spacing // 2 :: spacing, spacing // 2 :: spacing] = True
    low, high = surface.limits.T
    with np.errstate(invalid="ignore"):
        inside = ((points >= low) & (points <= high)).all(axis=2)
    chosen = grid & inside & np.isfinite(velocities).all(axis=2)
    return points[chosen], velocities[chosen]


def _in_front(tails: Points, surface: Surface, extent: float) -> NDArray[np.bool_]:
    """Return which points are not hidden behind the surface, judged on a coarse grid of the picture."""
    axes = np.stack(_VIEW.axes())
    centres = surface.corners.mean(axis=1)
    projected = [items @ axes.T for items in (centres, tails)]
    if not len(centres):
        return np.ones(len(tails), dtype=bool)
    origin = np.min(np.concatenate(projected)[:, :2], axis=0)
    cells = [np.floor((items[:, :2] - origin) / (extent / 80)).astype(np.int64) for items in projected]
    nearest = np.full(np.max(np.concatenate(cells), axis=0) + 1, -np.inf)
    np.maximum.at(nearest, tuple(cells[0].T), projected[0][:, 2])
    return np.asarray(projected[1][:, 2] >= nearest[tuple(cells[1].T)] - 0.06 * extent)


def _arrows(tails: Points, vectors: Points, extent: float) -> Points:
    """Return flat arrows that face the viewer, as polygons of shape (n, 7, 3)."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    along = vectors / np.where(lengths > 0, lengths, 1.0)
    side = np.cross(along, _VIEW.axes()[2])
    norms = np.linalg.norm(side, axis=1, keepdims=True)
    side /= np.where(norms > 0, norms, 1.0)
    head = np.minimum(0.45 * lengths, 0.028 * extent)
    neck, tips = tails + (lengths - head) * along, tails + vectors
    shaft, barb = 0.0024 * extent * side, 0.36 * head * side
    return np.stack([tails + shaft, neck + shaft, neck + barb, tips, neck - barb, neck - shaft, tails - shaft], axis=1)
