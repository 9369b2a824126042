"""Surfaces of a twin: depth maps cut at discontinuities, smoothed within their uncertainty, and meshed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from scenetruth.camera import Camera
from scenetruth.scoring.surface_labels import STEEPEST_DEG, fill_std, label_surfaces

__all__ = ["Canvas", "GridMesh", "SurfacePart", "find_parts", "mesh_part", "smooth_map"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_OVERLAP_PX = 3
_SCALES_PX = (1.5, 3.0, 6.0, 12.0, 24.0)
"""Standard deviations of the Gaussian windows of smoothing."""
_AGREEMENT_STDS, _LEVEL_PX = 1.5, 3.0
"""Root mean square up to which planes of two windows agree, in deviations, and window of the mean of their sizes."""
_ROUGHNESS_PX, _CORRELATIONS_PX = 3.0, (0.28, 8.0)
"""Window of the roughness, and bounds of the width of the autocorrelation: 4 π w² is 1 px² for white noise."""
_RIDGE = 1e-5
_CLEAR_PX = 6.0
_BORDER_PX = 3.0
"""Distance from measured pixels within which their surface is assumed to continue."""
_BAND_PX = 12.0
"""The same next to the border of the image."""
_WIDEST_SHARE = 1 / 3


@dataclass(frozen=True, eq=False)
class Canvas:
    """Pixel grid of the reference image, extended by a margin at all borders.

    ``camera``: Camera of the recording. ``margin``: Width of the margin in px.
    """

    camera: Camera
    margin: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.camera.height + 2 * self.margin, self.camera.width + 2 * self.margin

    @cached_property
    def pixels(self) -> Floats:
        """Pixel coordinates (x, y) in the reference image, shape (h, w, 2)."""
        y, x = np.indices(self.shape, dtype=np.float64) - self.margin
        return np.stack([x, y], axis=-1)

    @cached_property
    def rays(self) -> Floats:
        """Ray directions with Z = 1, shape (h, w, 3); NaN where the lens distortion is not invertible."""
        return self.camera.ray_directions(self.pixels)

    def extend(self, values: NDArray[np.floating]) -> Floats:
        """Return a map of the image on the canvas, NaN in the margin."""
        return np.pad(np.asarray(values, dtype=np.float64), self.margin, constant_values=np.nan)

    def crop(self, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """Return the part of a map of the canvas inside the image."""
        inside = slice(self.margin, -self.margin or None)
        return values[inside, inside]


@dataclass(frozen=True, eq=False)
class SurfacePart:
    """One continuous surface on the canvas.

    ``depth_mm``: Smoothed depth, extrapolated over the canvas. ``front``: Pixels where it is the nearest surface.
    ``mask``: Pixels of its mesh: ``front``, and where it continues behind nearer surfaces. ``measured``: Pixels with a
    valid depth.
    """

    name: str
    depth_mm: Floats
    front: Mask
    mask: Mask
    measured: Mask


def find_parts(
    canvas: Canvas, depth_mm: Floats, depth_std_mm: Floats, reach_mm: float, shown: Mask | None = None
) -> list[SurfacePart]:
    """Return the surfaces of a depth map of the reference image, the largest first.

    ``depth_mm``, ``depth_std_mm``: Maps of the image; NaN where the depth is invalid.
    ``reach_mm``: Largest displacement of a camera from the reference, for the surfaces behind others.
    ``shown``: Pixels of the image that show a surface by their brightness, measured or not.
    """
    depth, std = canvas.extend(depth_mm), canvas.extend(depth_std_mm)
    known = np.isfinite(depth) & np.isfinite(canvas.rays).all(axis=-1)
    std = fill_std(std, known)
    labels = label_surfaces(np.where(known, depth, np.nan), std, canvas.camera.focal_px)
    count = int(labels.max())
    if count == 0:
        return []
    distance, (rows, columns) = ndimage.distance_transform_edt(labels == 0, return_indices=True)
    owner = np.where(_continued(canvas, distance, shown), labels[rows, columns], 0)
    smooth = {}
    for number in range(1, count + 1):
        inside = labels == number
        found = smooth_map(np.where(inside, depth, np.nan), std)
        smooth[number] = np.clip(found, 0.5 * depth[inside].min(), 2.0 * depth[inside].max())
    front = np.full(canvas.shape, np.nan)
    for number, each in smooth.items():
        front[owner == number] = each[owner == number]
    nearest = float(np.nanmin(front))
    parts = []
    for number, each in smooth.items():
        own, inside = owner == number, labels == number
        parallax = canvas.camera.focal_px * reach_mm * abs(1 / nearest - 1 / float(np.median(depth[inside])))
        reach_px = min(parallax + _CLEAR_PX, _WIDEST_SHARE * canvas.shape[1])
        near = ndimage.distance_transform_edt(~own) <= reach_px
        step = np.tan(np.deg2rad(STEEPEST_DEG)) * each / canvas.camera.focal_px
        others = ~own & (owner > 0)
        behind = near & others & (each > front + step)
        # Meshes end at the last vertex inside: surfaces that touch overlap, lest there be a gap.
        touching = ndimage.binary_dilation(own, iterations=_OVERLAP_PX) & others & (np.abs(each - front) <= step)
        parts.append(SurfacePart(f"surface_{number}", each, own, own | behind | touching, inside))
    return parts


def _continued(canvas: Canvas, distance: Floats, shown: Mask | None) -> Mask:
    """Return where surfaces are assumed: next to measured pixels, in gaps that they enclose, and beyond the image.

    ``distance``: Distance to the nearest measured pixel in px. ``shown``: Pixels of the image that show a surface.
    """
    outside = np.ones(canvas.shape, dtype=np.bool_)
    canvas.crop(outside)[...] = False
    enclosed = ndimage.binary_fill_holes((distance <= _BORDER_PX) & ~outside) & ~outside
    # Estimates often lack pixels at the border of the image, where surfaces do not end.
    band = ndimage.distance_transform_edt(~outside) <= _BAND_PX if canvas.margin else np.zeros_like(outside)
    near = (distance <= _BORDER_PX) | (enclosed & (distance <= canvas.margin)) | (band & (distance <= _BAND_PX))
    if shown is not None:
        seen = np.zeros(canvas.shape, dtype=np.bool_)
        canvas.crop(seen)[...] = shown
        near |= seen & (distance <= canvas.margin)
    reached, (rows, columns) = ndimage.distance_transform_edt(~(near & ~outside), return_indices=True)
    beyond = outside & (reached <= np.sqrt(2) * canvas.margin) & near[rows, columns]
    return np.asarray((near | beyond) & np.isfinite(canvas.rays).all(axis=-1))


def smooth_map(values: Floats, std: Floats, scales_px: Sequence[float] = _SCALES_PX) -> Floats:
    """Return a map smoothed by local planes, as far as they agree with the measured values within their uncertainty.

    The window of every pixel is the largest whose plane agrees with those of all smaller windows, and with the values
    themselves: their difference has a local root mean square below 1.5 standard deviations of the other plane (the rule
    of Lepski for the width of a window). Errors are correlated over a distance that the roughness of the values shows.
    Outside the measured pixels, planes are extrapolated.

    ``values``: NaN where there is no value. ``std``: Standard deviations, positive.
    """
    inside = np.isfinite(values)
    filled, weight = np.where(inside, values, 0.0), np.where(inside, 1 / std**2, 0.0)
    unit = max(float(weight.max(initial=0.0)), 1e-300)
    planes = [_local_planes(filled, weight / unit, scale) for scale in scales_px]
    fits, leverages = ([each[number] for each in planes] for number in (0, 1))
    width = _correlation_px(filled - _local_planes(filled, weight / unit, _ROUGHNESS_PX)[0], std, inside)
    for number in range(len(fits) - 2, -1, -1):
        fits[number] = np.where(np.isfinite(fits[number]), fits[number], fits[number + 1])
    level, agrees = np.zeros(values.shape), inside.copy()
    earlier = [(filled, std)]
    for number, (fit, scale) in enumerate(zip(fits, scales_px, strict=True)):
        for other, deviation in earlier:
            with np.errstate(invalid="ignore"):
                square = np.where(inside, ((fit - other) / deviation) ** 2, 0.0)
            agrees &= _local_mean(square, inside, scale) <= _AGREEMENT_STDS**2
        level[agrees] = number
        variance = leverages[number] / unit * width**2 / (width**2 + scale**2)
        earlier.append((fit, np.sqrt(variance)))
    level = _local_mean(np.where(inside, level, 0.0), inside, _LEVEL_PX)
    distance, (rows, columns) = ndimage.distance_transform_edt(~inside, return_indices=True)
    # Extrapolation by planes of a window that is as wide as the distance.
    needed = np.log2(np.maximum(distance, scales_px[0]) / scales_px[0])
    level = np.clip(np.where(inside, level, np.maximum(level[rows, columns], needed)), 0, len(fits) - 1)
    lower = np.minimum(level.astype(np.int64), len(fits) - 2) if len(fits) > 1 else np.zeros(level.shape, np.int64)
    stack, share = np.stack(fits), level - lower
    pick = np.take_along_axis(stack, lower[None], axis=0)[0]
    above = np.take_along_axis(stack, np.minimum(lower + 1, len(fits) - 1)[None], axis=0)[0]
    found = (1 - share) * pick + share * above
    return np.asarray(np.where(np.isfinite(found), found, values[rows, columns]))


def _correlation_px(rough: Floats, std: Floats, inside: Mask) -> float:
    """Return the width w of the autocorrelation exp(-d² / 4 w²) of errors, from values less their local plane.

    The variance of errors less their plane in a Gaussian window s is 1 - 2 / (1 + a / 2) + 1 / (1 + a), a = s² / w².
    """
    if not inside.any():
        return _CORRELATIONS_PX[0]
    # The median of the square of a normal variable is 0.455, and is not that of edges.
    found = float(np.nanmedian((rough[inside] / std[inside]) ** 2)) / 0.455
    widths = np.geomspace(*_CORRELATIONS_PX, 50)
    ratio = (_ROUGHNESS_PX / widths) ** 2
    return float(np.interp(-found, -(1 - 2 / (1 + ratio / 2) + 1 / (1 + ratio)), widths))


def _local_mean(values: Floats, inside: Mask, sigma: float) -> Floats:
    """Return the mean over the valid pixels of a Gaussian window."""
    weight = ndimage.gaussian_filter(inside.astype(np.float64), sigma, mode="constant")
    total = ndimage.gaussian_filter(values, sigma, mode="constant")
    return np.asarray(total / np.maximum(weight, 1e-12))


def _local_planes(values: Floats, weight: Floats, sigma: float) -> tuple[Floats, Floats]:
    """Return the value at every pixel of the plane fitted in a Gaussian window, and its leverage; NaN without weight.

    The leverage is the variance of the value if the window contained one measurement of its mean weight.
    """
    y, x = np.indices(values.shape, dtype=np.float64)
    y, x = y - y.mean(), x - x.mean()
    total, m_x, m_y, m_xx, m_xy, m_yy, m_v, m_xv, m_yv = (
        ndimage.gaussian_filter(weight * each, sigma, mode="constant")
        for each in (np.ones_like(x), x, y, x * x, x * y, y * y, values, x * values, y * values)
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        m_x, m_y, m_v = m_x / total, m_y / total, m_v / total
        c_xx = m_xx / total - m_x**2 + _RIDGE * sigma**2
        c_yy = m_yy / total - m_y**2 + _RIDGE * sigma**2
        c_xy, c_xv, c_yv = m_xy / total - m_x * m_y, m_xv / total - m_x * m_v, m_yv / total - m_y * m_v
        determinant = c_xx * c_yy - c_xy**2
        slope_x = (c_yy * c_xv - c_xy * c_yv) / determinant
        slope_y = (c_xx * c_yv - c_xy * c_xv) / determinant
        d_x, d_y = x - m_x, y - m_y
        found = m_v + slope_x * d_x + slope_y * d_y
        leverage = (1 + (c_yy * d_x**2 - 2 * c_xy * d_x * d_y + c_xx * d_y**2) / determinant) / total
    valid = total > 1e-9
    return np.where(valid, found, np.nan), np.where(valid, leverage, np.inf)


@dataclass(frozen=True, eq=False)
class GridMesh:
    """Triangles through pixels of the canvas.

    ``places``: Row and column on the canvas of every vertex, shape (n, 2). ``faces``: Shape (m, 3).
    """

    places: NDArray[np.int64]
    faces: NDArray[np.int64]

    def at_vertices(self, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """Return the values of a map of the canvas at the vertices."""
        return values[self.places[:, 0], self.places[:, 1]]


def mesh_part(part: SurfacePart, step_px: int) -> GridMesh | None:
    """Return triangles over the pixels of a surface, with vertices every ``step_px`` pixels; None if it is too narrow.

    The shorter diagonal of every square, in depth, is the edge of its two triangles. Edges face the camera.
    """
    height, width = part.mask.shape
    rows, columns = (_lattice(size, step_px) for size in (height, width))
    here = part.mask[np.ix_(rows, columns)]
    square = here[:-1, :-1] & here[1:, :-1] & here[:-1, 1:] & here[1:, 1:]
    if not square.any():
        return None
    number = np.arange(here.size).reshape(here.shape)
    a, b, c, d = (corner[square] for corner in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    depth = part.depth_mm[np.ix_(rows, columns)].ravel()
    first = np.abs(depth[a] - depth[c]) <= np.abs(depth[b] - depth[d])
    upper = np.where(first[:, None], np.column_stack([a, c, b]), np.column_stack([a, d, b]))
    lower = np.where(first[:, None], np.column_stack([a, d, c]), np.column_stack([b, d, c]))
    faces = np.concatenate([upper, lower])
    used, compact = np.unique(faces, return_inverse=True)
    places = np.column_stack([rows[used // len(columns)], columns[used % len(columns)]])
    return GridMesh(places, compact.reshape(faces.shape))


def _lattice(size: int, step: int) -> NDArray[np.int64]:
    """Return the indices 0, step, ... up to the last pixel, which is one of them."""
    found = np.arange(0, size, step)
    return found if found[-1] == size - 1 else np.append(found, size - 1)
