"""The estimated surface as quadrilaterals in an oblique parallel view."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from scenetruth.scoring.figures._common import GREY, robust_limits

__all__ = ["Surface", "View", "add_polygons", "add_surface", "shade", "surface_axes", "surface_of", "texture"]

Points = NDArray[np.float64]
Map = NDArray[np.float64]

_STEEPEST = math.tan(math.radians(80.0))
_LIGHT = np.array([-0.35, -0.55, -0.76])
"""Direction from the surface to the light: left, above, and from the camera."""


_PLOT_ORDER = [0, 2, 1]
"""The plot's axes are X, Z and Y, so that Y is upright and Z leads away."""


@dataclass(frozen=True)
class View:
    """From where a surface is seen.

    Parameters
    ----------
    elevation_deg
        Angle above the X-Z plane.
    azimuth_deg
        Angle around the Y axis; at -90 the viewer stands where the camera stands.
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
class Surface:
    """A surface without a skin across depth jumps.

    Parameters
    ----------
    corners
        Of every quadrilateral, in order around it, shape (n, 4, 3), mm.
    rows, columns
        The pixel at the centre of each, shape (n,).
    step_px
        The pixels between neighbouring corners.
    limits
        Low and high in X, Y and Z, mm, shape (3, 2).
    """

    corners: Points
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    step_px: int
    limits: NDArray[np.float64]


def surface_of(points: Points, focal_length_px: float, max_quads: int = 40_000) -> Surface:
    """Span quadrilaterals between neighbouring points of a depth map.

    A quadrilateral is left out where a corner is missing, where the depth across it changes as on a surface that is
    more than 80 degrees oblique, and where it lies far outside the depths of nearly all others.

    Parameters
    ----------
    points
        X, Y and Z of every pixel in mm, shape (y, x, 3); NaN where there is none.
    focal_length_px
        f, in pixels.
    max_quads
        About the most quadrilaterals to make; points between their corners are then skipped, never averaged.

    Returns
    -------
    Surface
        The quadrilaterals.
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
    return Surface(kept, rows * step + step // 2, columns * step + step // 2, step, limits)


def shade(surface: Surface) -> Map:
    """Return how brightly a distant light shines on each quadrilateral, 0 to 1, shape (n,)."""
    corners = surface.corners
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    length = np.linalg.norm(normals, axis=1)
    cosine = np.abs(normals @ (_LIGHT / np.linalg.norm(_LIGHT))) / np.where(length > 0, length, 1.0)
    return np.asarray(0.3 + 0.7 * cosine)


def texture(image: Map, surface: Surface) -> Map:
    """Return the image's grey value at each quadrilateral, 0 to 1, shape (n,)."""
    averaged = ndimage.uniform_filter(image, surface.step_px)
    low, high = robust_limits(averaged[surface.rows, surface.columns], percent=1.0)
    grey = (averaged[surface.rows, surface.columns] - low) / (high - low)
    return np.asarray(np.clip(grey, 0.0, 1.0))


def surface_axes(figure: Any, box: tuple[float, float, float, float], limits: NDArray[np.float64], view: View) -> Any:
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


def add_surface(axes: Any, surface: Surface, colours: NDArray[np.float64]) -> None:
    """Draw the quadrilaterals in RGB colours, shape (n, 3)."""
    # Without thin edges of the same colour, the background shines through between neighbours.
    add_polygons(axes, surface.corners, facecolors=colours, edgecolors=colours, linewidths=0.2, antialiaseds=False)


def add_polygons(axes: Any, corners: Points, **options: Any) -> None:
    """Draw polygons, shape (n, corners, 3) in X, Y and Z."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    if len(corners):
        # In files of vectors they are pixels all the same: a hundred thousand facets would take minutes to show.
        axes.add_collection3d(Poly3DCollection(corners[..., _PLOT_ORDER], rasterized=True, **options))
