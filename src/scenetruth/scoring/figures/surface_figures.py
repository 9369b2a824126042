"""Figures of the reconstructed surface in an oblique parallel view, with texture or with velocities as arrows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from scenetruth.scoring.figures.figure_arrays import FigureArrays
from scenetruth.scoring.figures.figure_style import BLUE, GREY, ORANGE, FigureInfo, new_figure, robust_limits, save

__all__ = ["QuadSurface", "SurfaceView", "arrow_factor", "build_surface", "draw_surface", "draw_velocity_arrows"]


Points = NDArray[np.float64]
Map = NDArray[np.float64]

_STEEPEST = math.tan(math.radians(80.0))
_LIGHT = np.array([-0.35, -0.55, -0.76])
"""Direction from the surface to the light: left, above, and from the camera."""


_PLOT_ORDER = [0, 2, 1]
"""The plot's axes are X, Z and Y, so that Y is upright and Z leads away."""


@dataclass(frozen=True)
class SurfaceView:
    """From where a surface is seen.

    ``elevation_deg``: Angle above the X-Z plane.
    ``azimuth_deg``: Angle around the Y axis; at -90 the viewer stands where the camera stands.
    """

    elevation_deg: float
    azimuth_deg: float

    def axes(self) -> tuple[Points, Points, Points]:
        """Return the picture's unit vectors in X, Y and Z: to its right, upwards, and towards the viewer."""
        elevation, azimuth = math.radians(self.elevation_deg), math.radians(self.azimuth_deg)
        flat = math.cos(elevation)
        viewer = np.array([flat * math.cos(azimuth), -math.sin(elevation), flat * math.sin(azimuth)])
        right = np.array([-math.sin(azimuth), 0.0, math.cos(azimuth)])
        return right, np.cross(viewer, right), viewer


@dataclass(frozen=True)
class QuadSurface:
    """A surface without a skin across depth jumps.

    ``corners``: Of every quadrilateral, in order around it, shape (n, 4, 3), mm.
    ``rows``, ``columns``: The pixel at the centre of each, shape (n,).
    ``step_px``: The pixels between neighbouring corners.
    ``limits``: Low and high in X, Y and Z, mm, shape (3, 2).
    """

    corners: Points
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    step_px: int
    limits: NDArray[np.float64]


def build_surface(points: Points, focal_length_px: float, max_quads: int = 40_000) -> QuadSurface:
    """Span quadrilaterals between neighbouring points of a depth map.

    A quadrilateral is left out where a corner is missing, where the depth across it changes as on a surface that is
    more than 80 degrees oblique, and where it lies far outside the depths of nearly all others.

    ``points``: X, Y and Z of every pixel in mm, shape (y, x, 3); NaN where there is none.
    """
    step = max(1, math.ceil(math.sqrt(points.shape[0] * points.shape[1] / max_quads)))
    grid = points[::step, ::step]
    corners = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2)
    depth = corners[..., 2]
    low, high = robust_limits(points[..., 2])
    pad = 0.25 * (high - low)
    whole = np.isfinite(depth).all(axis=2)
    with np.errstate(invalid="ignore"):
        jump = depth.max(axis=2) - depth.min(axis=2)
        whole &= jump <= _STEEPEST * step * depth.mean(axis=2) / focal_length_px
        whole &= (depth.min(axis=2) >= low - pad) & (depth.max(axis=2) <= high + pad)
    rows, columns = np.nonzero(whole)
    kept = corners[whole]
    limits = (
        np.stack([kept.min(axis=(0, 1)), kept.max(axis=(0, 1))], axis=-1) if len(kept) else np.tile([0.0, 1.0], (3, 1))
    )
    return QuadSurface(kept, rows * step + step // 2, columns * step + step // 2, step, limits)


def shade(surface: QuadSurface) -> Map:
    """Return how brightly a distant light shines on each quadrilateral, 0 to 1, shape (n,)."""
    corners = surface.corners
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    length = np.linalg.norm(normals, axis=1)
    cosine = np.abs(normals @ (_LIGHT / np.linalg.norm(_LIGHT))) / np.where(length > 0, length, 1.0)
    return np.asarray(0.3 + 0.7 * cosine)


def texture(image: Map, surface: QuadSurface) -> Map:
    """Return the image's grey value at each quadrilateral, 0 to 1, shape (n,)."""
    averaged = ndimage.uniform_filter(image, surface.step_px)
    low, high = robust_limits(averaged[surface.rows, surface.columns], percent=1.0)
    grey = (averaged[surface.rows, surface.columns] - low) / (high - low)
    return np.asarray(np.clip(grey, 0.0, 1.0))


def surface_axes(
    figure: Any, box: tuple[float, float, float, float], limits: NDArray[np.float64], view: SurfaceView
) -> Any:
    """Add axes in parallel projection, true to scale, in mm, around the limits in X, Y and Z, shape (3, 2).

    The box is the place (left, bottom, width, height) in the figure, as fractions of it.
    """
    from matplotlib.ticker import MaxNLocator

    axes = figure.add_axes(box, projection="3d", computed_zorder=False)
    axes.set_proj_type("ortho")
    axes.view_init(elev=view.elevation_deg, azim=view.azimuth_deg)
    spans = []
    for name, (low, high) in zip("xzy", limits, strict=True):
        pad = 0.02 * (high - low) or 1.0
        ends = (low - pad, high + pad)
        spans.append(ends[1] - ends[0])
        getattr(axes, f"set_{name}lim")(*(ends if name != "z" else ends[::-1]))
    # Where the surface is higher than wide, the labels at the bottom need room.
    axes.set_box_aspect((spans[0], spans[2], spans[1]), zoom=0.95 if spans[1] < max(spans[0], spans[2]) else 0.85)
    axes.tick_params(pad=1)
    axes.set_xlabel("$X$ [mm]")
    axes.set_ylabel("$Z$ [mm]")
    axes.set_zlabel("$Y$ [mm]")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.pane.set_facecolor("white")
        axis.pane.set_edgecolor(GREY)
        axis.set_major_locator(MaxNLocator(6))
    return axes


def add_surface(axes: Any, surface: QuadSurface, colours: NDArray[np.float64]) -> None:
    """Draw the quadrilaterals in RGB colours, shape (n, 3)."""
    # Without thin edges of the same colour, the background shines through between neighbours.
    add_polygons(axes, surface.corners, facecolors=colours, edgecolors=colours, linewidths=0.2, antialiaseds=False)


def add_polygons(axes: Any, corners: Points, **options: Any) -> None:
    """Draw polygons, shape (n, corners, 3) in X, Y and Z."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    if len(corners):
        # In files of vectors they are pixels all the same: a hundred thousand facets would take minutes to show.
        axes.add_collection3d(Poly3DCollection(corners[..., _PLOT_ORDER], rasterized=True, **options))


_PANELS = (("with the image on it", SurfaceView(28.0, -70.0)), ("shaded", SurfaceView(52.0, -80.0)))


def draw_surface(views: FigureArrays, folder: Path) -> FigureInfo:
    """Draw the estimated surface twice: with the image on it, and shaded from higher above."""
    title = f"Reconstructed surface, t = {views.frame}"
    points = views.surface_points()
    figure = new_figure(10.0, 4.6, layout=None)
    for at, (name, view) in enumerate(_PANELS, start=1):
        # The texture needs a finer mesh than the shape.
        surface = build_surface(points, views.map_focal_length_px, max_quads=80_000 if at == 1 else 40_000)
        axes = surface_axes(figure, (0.5 * at - 0.5, 0.02, 0.46, 0.9), surface.limits, view)
        grey = texture(views.image, surface) if at == 1 else shade(surface)
        add_surface(axes, surface, np.repeat(grey[:, None], 3, axis=1))
        figure.text(0.5 * at - 0.48, 0.94, f"Reconstructed surface, {name}", fontsize="large")
    save(figure, folder / "surface.png")
    above = " and ".join(f"{view.elevation_deg:.0f}°" for _, view in _PANELS)
    caption = (
        f"The estimated depth as a surface in parallel projection, true to scale, from {above} above the optical axis; "
        "the camera stands in front, Y points down. Nothing is smoothed. There is no surface where there is no full "
        "estimate, nor across jumps of the depth."
    )
    return FigureInfo("surface.png", title, caption)


_VIEW = SurfaceView(30.0, -70.0)
_ACROSS = 20
"""Arrows along the longer side of the image."""
_FACTOR = 5.0
"""Length of an arrow in mm for 1 mm per frame, as in the paper."""
_LONGEST = 0.4
"""Longest arrow as a part of the extent: single wrong velocities would make everything else small."""


def draw_velocity_arrows(views: FigureArrays, folder: Path) -> FigureInfo:
    """Draw the estimated velocities as arrows on the estimated surface."""
    points, velocities = views.surface_points(), views.velocities()
    surface = build_surface(points, views.map_focal_length_px)
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

    ``vectors``: Velocities, mm per frame, shape (n, 3).
    ``extent``: The largest side of the box around the surface, mm.
    """
    # Most of the picture may be at rest.
    length = float(np.percentile(np.linalg.norm(vectors, axis=1), 90)) if len(vectors) else 0.0
    # Velocities that are all but zero are noise; enlarging them would show nothing else.
    if length < 1e-6 * extent or 0.015 * extent <= _FACTOR * length <= 0.4 * extent:
        return _FACTOR
    wanted = 0.1 * extent / length
    power = 10.0 ** math.floor(math.log10(wanted))
    return power * max(step for step in (1, 2, 5) if step * power <= wanted * (1 + 1e-9))


def _pick(points: Points, velocities: Points, surface: QuadSurface) -> tuple[Points, Points]:
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


def _in_front(tails: Points, surface: QuadSurface, extent: float) -> NDArray[np.bool_]:
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
