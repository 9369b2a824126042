"""Figures of the reconstructed surface in an oblique parallel view, with the image or with velocity arrows."""

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

__all__ = [
    "QuadSurface",
    "SurfaceView",
    "arrow_factor",
    "build_surface",
    "draw_surface",
    "draw_velocity_arrows",
    "texture",
]


Points = NDArray[np.float64]
Map = NDArray[np.float64]

_STEEPEST = math.tan(math.radians(80.0))
_LIGHT = np.array([-0.35, -0.55, -0.76])
"""Direction from the surface to the light: left, above, and towards the camera."""


_PLOT_ORDER = [0, 2, 1]
"""The plot axes are X, Z and Y, so that Y is vertical and Z points away from the viewer."""


@dataclass(frozen=True)
class SurfaceView:
    """The viewing direction: angle above the X-Z plane, and around the Y axis, where -90 is the camera position."""

    elevation_deg: float
    azimuth_deg: float

    def axes(self) -> tuple[Points, Points, Points]:
        """Return the unit vectors of the drawing in X, Y and Z: right, up, and towards the viewer."""
        elevation, azimuth = math.radians(self.elevation_deg), math.radians(self.azimuth_deg)
        flat = math.cos(elevation)
        viewer = np.array([flat * math.cos(azimuth), -math.sin(elevation), flat * math.sin(azimuth)])
        right = np.array([-math.sin(azimuth), 0.0, math.cos(azimuth)])
        return right, np.cross(viewer, right), viewer


@dataclass(frozen=True)
class QuadSurface:
    """A surface of quadrilaterals that is open at depth discontinuities.

    ``corners``: Corners of every quadrilateral, in order around it, shape (n, 4, 3), mm.
    ``rows``, ``columns``: The pixel at the centre of each, shape (n,); corners are ``step_px`` apart.
    ``limits``: Minimum and maximum in X, Y and Z, mm, shape (3, 2).
    """

    corners: Points
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    step_px: int
    limits: NDArray[np.float64]


def build_surface(points: Points, focal_length_px: float, max_quads: int = 40_000) -> QuadSurface:
    """Build quadrilaterals between neighbouring points (y, x, 3), mm, of a depth map.

    A quadrilateral is omitted if a corner is missing, if its slope exceeds 80 degrees, or if it is an outlier in depth.
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
    """Return the illumination of each quadrilateral by a distant light, 0 to 1, shape (n,)."""
    corners = surface.corners
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    length = np.linalg.norm(normals, axis=1)
    cosine = np.abs(normals @ (_LIGHT / np.linalg.norm(_LIGHT))) / np.where(length > 0, length, 1.0)
    return np.asarray(0.3 + 0.7 * cosine)


def texture(image: Map, surface: QuadSurface) -> Map:
    """Return the grey value of the image at each quadrilateral, 0 to 1, shape (n,)."""
    # Corrected images have no value beyond the border of the original: only the others are averaged.
    known = np.isfinite(image)
    sums, weights = (
        ndimage.uniform_filter(part, surface.step_px)[surface.rows, surface.columns]
        for part in (np.where(known, image, 0.0), known.astype(np.float64))
    )
    averaged = np.divide(sums, weights, out=np.full(sums.shape, np.nan), where=weights > 0.5 / surface.step_px**2)
    low, high = robust_limits(averaged, percent=1.0)
    grey = np.clip((averaged - low) / (high - low), 0.0, 1.0)
    return np.asarray(np.nan_to_num(grey, nan=0.5))


def surface_axes(
    figure: Any, box: tuple[float, float, float, float], limits: NDArray[np.float64], view: SurfaceView
) -> Any:
    """Add true-to-scale axes in parallel projection, mm, with limits (3, 2), in a box (left, bottom, width, height)."""
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
    # If the surface is higher than wide, the labels at the bottom need space.
    axes.set_box_aspect((spans[0], spans[2], spans[1]), zoom=0.95 if spans[1] < max(spans[0], spans[2]) else 0.85)
    axes.tick_params(pad=1)
    axes.set_xlabel("$X$ [mm]")
    axes.set_ylabel("$Z$ [mm]")
    axes.set_zlabel("$Y$ [mm]")
    for axis, span in zip((axes.xaxis, axes.yaxis, axes.zaxis), (spans[0], spans[2], spans[1]), strict=True):
        axis.pane.set_facecolor("white")
        axis.pane.set_edgecolor(GREY)
        # Labels of a short axis would overlap.
        axis.set_major_locator(MaxNLocator(max(2, round(6 * min(1.0, 1.3 * span / max(spans))))))
    return axes


def add_surface(axes: Any, surface: QuadSurface, colours: NDArray[np.float64]) -> None:
    """Draw the quadrilaterals in RGB colours, shape (n, 3)."""
    # Without thin edges of the same colour, the background is visible between neighbours.
    add_polygons(axes, surface.corners, facecolors=colours, edgecolors=colours, linewidths=0.2, antialiaseds=False)


def add_polygons(axes: Any, corners: Points, **options: Any) -> None:
    """Draw polygons, shape (n, corners, 3) in X, Y and Z."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    if len(corners):
        # Rasterised in vector files: 100,000 facets would take minutes to display.
        axes.add_collection3d(Poly3DCollection(corners[..., _PLOT_ORDER], rasterized=True, **options))


_PANELS = (("textured with the image", SurfaceView(28.0, -70.0)), ("shaded", SurfaceView(52.0, -80.0)))


def draw_surface(views: FigureArrays, folder: Path) -> FigureInfo:
    """Draw the estimated surface twice: textured with the image, and shaded from a higher viewpoint."""
    title = f"Reconstructed surface, t = {views.frame}"
    points = views.surface_points()
    figure = new_figure(10.0, 4.6, layout=None)
    for at, (name, view) in enumerate(_PANELS, start=1):
        # The texture requires a finer mesh than the shape.
        surface = build_surface(points, views.map_focal_length_px, max_quads=80_000 if at == 1 else 40_000)
        axes = surface_axes(figure, (0.5 * at - 0.5, 0.02, 0.46, 0.9), surface.limits, view)
        grey = texture(views.image, surface) if at == 1 else shade(surface)
        add_surface(axes, surface, np.repeat(grey[:, None], 3, axis=1))
        figure.text(0.5 * at - 0.48, 0.94, f"Reconstructed surface, {name}", fontsize="large")
    save(figure, folder / "surface.png")
    above = " and ".join(f"{view.elevation_deg:.0f}°" for _, view in _PANELS)
    caption = (
        f"The estimated depth as a surface in parallel projection, true to scale, from {above} above the optical axis; "
        "the camera is in front, Y points down. Nothing is smoothed. The surface is open where there is no valid "
        "estimate and at depth discontinuities."
    )
    return FigureInfo("surface.png", title, caption)


_VIEW = SurfaceView(30.0, -70.0)
_ACROSS = 20
"""Number of arrows along the longer side of the image."""
_FACTOR = 5.0
"""Length of an arrow in mm for 1 mm/frame, as in the paper."""
_LONGEST = 0.4
"""Longest arrow as a fraction of the extent: single outliers would otherwise set the scale."""


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
        f"Arrows on the reconstructed surface; 1 mm/frame is drawn {factor:g}\N{NO-BREAK SPACE}mm long. "
        "Arrows show single pixels without averaging; arrows behind the surface are omitted. "
        + ("Orange arrows are truncated. " if cut.any() else "")
        + "Only where an object translates without rotating or deforming are its arrows parallel and of equal length."
    )
    return FigureInfo("velocity_arrows.png", title, caption)


def arrow_factor(vectors: Points, extent: float) -> float:
    """Return the arrow length for 1 mm/frame: the paper's value of 5, or a round number if that is not legible."""
    # The majority of the pixels may be at rest.
    length = float(np.percentile(np.linalg.norm(vectors, axis=1), 90)) if len(vectors) else 0.0
    # Velocities of nearly zero are noise, which should not be magnified.
    if length < 1e-6 * extent or 0.015 * extent <= _FACTOR * length <= 0.4 * extent:
        return _FACTOR
    wanted = 0.1 * extent / length
    power = 10.0 ** math.floor(math.log10(wanted))
    return power * max(step for step in (1, 2, 5) if step * power <= wanted * (1 + 1e-9))


def _pick(points: Points, velocities: Points, surface: QuadSurface) -> tuple[Points, Points]:
    """Return positions and velocities on a coarse grid of the pixels of the surface."""
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
    """Return which points are not hidden by the surface, evaluated on a coarse grid of the drawing."""
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
    """Return flat arrows facing the viewer, as polygons of shape (n, 7, 3)."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    along = vectors / np.where(lengths > 0, lengths, 1.0)
    side = np.cross(along, _VIEW.axes()[2])
    norms = np.linalg.norm(side, axis=1, keepdims=True)
    side /= np.where(norms > 0, norms, 1.0)
    head = np.minimum(0.45 * lengths, 0.028 * extent)
    neck, tips = tails + (lengths - head) * along, tails + vectors
    shaft, barb = 0.0024 * extent * side, 0.36 * head * side
    return np.stack([tails + shaft, neck + shaft, neck + barb, tips, neck - barb, neck - shaft, tails - shaft], axis=1)
