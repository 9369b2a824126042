"""Refinement of detected corners and dots to some thousandths of a pixel, with the covariance of each point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

from scenetruth.camera import Camera
from scenetruth.capture.calibration.boards import Board, CharucoBoard, Checkerboard, DotGrid
from scenetruth.capture.calibration.corner_detection import Detection
from scenetruth.capture.calibration.corner_kernels import centroids, fit_corners
from scenetruth.capture.calibration.disc_kernels import fit_discs
from scenetruth.capture.calibration.start_values import fit_homography

__all__ = ["RefinedPoints", "disc_bias", "estimate_gain_spread", "estimate_noise", "refine_points"]

Array = NDArray[np.float64]

_REACH = 0.48
"""Extent of the window in squares: windows of neighbouring corners share no pixel."""
_HALF_PX = 12
"""Largest half width of the window: the edges are straight within it."""
_BLUR_START = 0.8
_BLURS = 3.0  # standard deviations of the blur that a window keeps from the markers
_LEAST_GAP_PX = 0.5
_MISFIT = 4.0
"""Mean square of residuals beyond which a corner is not that of the model (reflection, dirt, saturation)."""
_FARTHEST_PX = 3.0
"""Largest distance of a refined corner from its detection."""
_DOT_INNER = 1.3  # radii of the window of the first centroid
_HOLE, _RING = 0.55, 0.6
"""Pixels used for a dot, in radii: from the hole of a hollow dot to some of the ground."""
_EDGE_PX, _RING_PX, _RING_MOST_PX = 1.5, 3.0, 12.0
"""Distance that is kept from the edges of neighbours, and least and largest width of the ground."""
_SHARP_PX, _SHARP_BLUR_PX = 0.007, 0.4
"""Error of dots with edges sharper than a pixel, times the root of the radius in px, measured with renders of 4 and
8 px radius without blur; and the blur from which it vanishes.
"""
_MEDIAN_SQUARE = 0.4549364231195724  # of a normal value
_SMOOTH_PX, _SMOOTH_SIGMAS, _FEWEST_SMOOTH = 7, 4.0, 500
"""Parts whose means of 3 x 3 px differ by less than four standard deviations of a pixel, 12 of a mean, are smooth."""
_FLOOR_PX = 5e-4
"""Standard deviation of what the edge model leaves out, for example curved edges: without noise, the corners of
rendered boards have errors of 0.0002 to 0.0005 px rms.
"""


@dataclass(frozen=True, eq=False)
class RefinedPoints:
    """Refined positions of the points of a board in one image.

    ``ids``: Indices of the points of the board, shape (n,).
    ``pixels``: Positions, shape (n, 2).
    ``covariance_px2``: Covariances, shape (n, 2, 2).
    ``blur_px``: Median standard deviation of the blur of the edges; of corners or dots.
    ``mean_square``: Median of the mean squared residuals of the edge model in units of the noise; NaN for dots.
    ``rejected``: Number of detected points that do not fit the model.
    """

    ids: NDArray[np.int64]
    pixels: Array
    covariance_px2: Array
    blur_px: float
    mean_square: float
    rejected: int


def estimate_noise(image: Array) -> float:
    """Return the standard deviation of the noise of an image, from its second differences (Immerkær 1996).

    The median over the image makes edges irrelevant.
    """
    return float(np.sqrt(np.nanmedian(_local_noise(image)) / _MEDIAN_SQUARE))


def estimate_gain_spread(light: Array, variance: Array) -> float:
    """Return the standard deviation of the gains of single pixels, from bright, smooth parts of an image.

    It is what the differences of neighbours have in excess of the noise in time; 0 if too few pixels are smooth.

    ``light``: Values less those of the dark frame.
    ``variance``: Variance of their noise in time.
    """
    mean = uniform_filter(light, 3)
    span = maximum_filter(mean, _SMOOTH_PX) - minimum_filter(mean, _SMOOTH_PX)
    smooth = span < _SMOOTH_SIGMAS * np.sqrt(variance)
    smooth &= mean > np.median(mean)
    smooth[[0, -1]] = smooth[:, [0, -1]] = False
    if np.count_nonzero(smooth) < _FEWEST_SMOOTH:
        return 0.0
    inner = smooth[1:-1, 1:-1]
    ratio = _local_noise(light)[inner] / uniform_filter(variance, 3)[smooth]
    excess = float(np.median(ratio)) / _MEDIAN_SQUARE - 1
    return float(np.sqrt(max(excess, 0.0) * np.median(variance[smooth]) / np.median(mean[smooth]) ** 2))


def _local_noise(image: Array) -> Array:
    """Return squared second differences along both axes, whose mean is the variance of white noise."""
    core = (
        image[:-2, :-2] - 2 * image[:-2, 1:-1] + image[:-2, 2:]
        - 2 * (image[1:-1, :-2] - 2 * image[1:-1, 1:-1] + image[1:-1, 2:])
        + image[2:, :-2] - 2 * image[2:, 1:-1] + image[2:, 2:]
    )  # fmt: skip
    return np.asarray((core / 6) ** 2)


def refine_points(image: Array, variance: Array | float, board: Board, detection: Detection) -> RefinedPoints:
    """Return refined positions of detected points.

    ``image``: Grey values, linear in the light, shape (rows, columns).
    ``variance``: Variance of the noise of every pixel.
    """
    grey = np.ascontiguousarray(image, dtype=np.float64)
    noise = np.array(np.broadcast_to(np.maximum(variance, 1e-12), grey.shape), dtype=np.float64)
    points = board.points_mm[detection.ids, :2]
    homography = fit_homography(points, detection.pixels)
    if isinstance(board, DotGrid):
        return _refine_dots(grey, noise, board, detection, axes_of(homography, points) * (board.diameter_mm / 2))
    return _refine_corners(grey, noise, board, detection, axes_of(homography, points) * board.square_mm)


def axes_of(homography: Array, points: Array) -> Array:
    """Return the derivatives of a homography at points, in px per mm, shape (n, 2, 2)."""
    inside = np.column_stack([points, np.ones(len(points))]) @ homography.T
    x, y, w = inside.T
    rows = [[(homography[i, j] * w - value * homography[2, j]) / w**2 for j in (0, 1)] for i, value in ((0, x), (1, y))]
    return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0))


def _refine_corners(
    grey: Array, noise: Array, board: CharucoBoard | Checkerboard, detection: Detection, axes: Array
) -> RefinedPoints:
    # The shortest side of a square in the image, foreshortened.
    side = np.abs(np.linalg.det(axes)) / np.linalg.norm(axes, axis=1).max(axis=1)
    starts, blur = np.ascontiguousarray(detection.pixels), _BLUR_START
    found = np.empty((len(starts), 8))
    for _ in range(2):
        # The pixels themselves blur by the root of 1 / 12.
        gaps = np.maximum(board.gap - _BLURS * np.hypot(blur, 12**-0.5) / side, _LEAST_GAP_PX / side)
        fit_corners(grey, noise, starts, axes, gaps, _REACH, _HALF_PX, found)
        fitted = np.isfinite(found[:, 0])
        if not fitted.any():
            break
        starts = np.where(fitted[:, None], found[:, :2], starts)
        if abs(np.median(found[fitted, 5]) - blur) < 0.1:
            break
        blur = float(np.median(found[fitted, 5]))
    with np.errstate(invalid="ignore"):
        near = np.hypot(*(found[:, :2] - detection.pixels).T) < _FARTHEST_PX
        # Noise may be misjudged as a whole: a corner is compared with the others.
        usual = max(1.0, float(np.median(found[near, 6]))) if near.any() else 1.0
        kept = near & (found[:, 6] < _MISFIT * usual)
    part = found[kept]
    covariance = _covariances(part[:, 2], part[:, 3], part[:, 4]) * np.maximum(part[:, 6], 1.0)[:, None, None]
    return RefinedPoints(
        ids=detection.ids[kept], pixels=part[:, :2].copy(), covariance_px2=covariance + _FLOOR_PX**2 * np.eye(2),
        blur_px=float(np.median(part[:, 5])) if len(part) else np.nan,
        mean_square=float(np.median(part[:, 6])) if len(part) else np.nan, rejected=int((~kept).sum()),
    )  # fmt: skip


def _covariances(xx: Array, yy: Array, xy: Array) -> Array:
    return np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-2)


def _refine_dots(grey: Array, noise: Array, board: DotGrid, detection: Detection, axes: Array) -> RefinedPoints:
    nearest = board.spacing_mm / (np.sqrt(2) if board.kind == "asymmetric_dots" else 1)
    return refine_dots(grey, noise, detection.ids, detection.pixels, axes, 2 * nearest / board.diameter_mm)


def refine_dots(
    image: Array, variance: Array | float, ids: NDArray[np.int64], centres: Array, axes: Array, neighbour_radii: float
) -> RefinedPoints:
    """Return the centroids of dots with their covariance.

    ``axes``: Pixels per radius along the rows and columns of the board, shape (n, 2, 2).
    ``neighbour_radii``: Distance to the nearest dot in radii.
    """
    grey = np.ascontiguousarray(image, dtype=np.float64)
    noise = np.array(np.broadcast_to(np.maximum(variance, 1e-12), grey.shape), dtype=np.float64)
    pixel = 1 / max(float(np.median(np.sqrt(np.abs(np.linalg.det(axes))))), 1e-3)
    # The blurred edges of neighbours stay outside.
    ring = max(min(_RING, _RING_MOST_PX * pixel), _RING_PX * pixel)
    outer = min(1 + ring, max(neighbour_radii - 1 - _EDGE_PX * pixel, 0.5 * neighbour_radii))
    starts = np.ascontiguousarray(centres)
    rough, found = np.empty((len(starts), 5)), np.empty((len(starts), 9))
    centroids(grey, noise, starts, axes, min(_DOT_INNER, 1 + 0.6 * (outer - 1)), outer, rough)
    starts = np.where(np.isfinite(rough[:, :1]), rough[:, :2], starts)
    fit_discs(grey, noise, np.ascontiguousarray(starts), axes, max(_HOLE, 1 - _RING_MOST_PX * pixel), outer, found)
    with np.errstate(invalid="ignore"):
        near = np.hypot(*(found[:, :2] - centres).T) < _FARTHEST_PX + 0.1 / pixel
        usual = max(1.0, float(np.median(found[near, 6]))) if near.any() else 1.0
        kept = near & (found[:, 6] < _MISFIT * usual)
    part = found[kept]
    covariance = _covariances(part[:, 2], part[:, 3], part[:, 4]) * np.maximum(part[:, 6], 1.0)[:, None, None]
    floor = _FLOOR_PX**2 + pixel * (_SHARP_PX * np.maximum(1 - part[:, 5] / _SHARP_BLUR_PX, 0.0)) ** 2
    return RefinedPoints(
        ids=ids[kept], pixels=part[:, :2].copy(), covariance_px2=covariance + floor[:, None, None] * np.eye(2),
        blur_px=float(np.median(part[:, 5])) if len(part) else np.nan,
        mean_square=float(np.median(part[:, 6])) if len(part) else np.nan, rejected=int((~kept).sum()),
    )  # fmt: skip


def disc_bias(camera: Camera, rotation: Array, translation: Array, points: Array, radius_mm: float) -> Array:
    """Return the centroids of imaged discs less the images of their centres, shape (n, 2).

    The centroid is the mean of the image positions, weighted by the area of the image of every element.

    ``rotation``, ``translation``: Pose of the board in the frame of the camera.
    ``points``: Centres on the board in mm, shape (n, 3).
    """
    # Exact for polynomials of degree 5 on the disc (radii by Gauss's rule in the square of the radius).
    nodes, weights = np.polynomial.legendre.leggauss(3)
    radii, shares = radius_mm * np.sqrt((nodes + 1) / 2), weights / 2
    angles = np.arange(8) * (np.pi / 4)
    offsets = np.array([[r * np.cos(angle), r * np.sin(angle), 0.0] for r in radii for angle in angles])
    share = np.repeat(shares, len(angles)) / len(angles)
    samples = points[:, None] + offsets
    inside = samples @ rotation.T + translation
    images = camera.project(inside)
    area = _area(camera, rotation, inside) * share
    centroid = (area[..., None] * images).sum(axis=1) / area.sum(axis=1)[:, None]
    return np.asarray(centroid - camera.project(points @ rotation.T + translation))


def _area(camera: Camera, rotation: Array, inside: Array) -> Array:
    """Return the area of the image per area of the board at points in the frame of the camera, shape (n, m)."""
    z = inside[..., 2]
    plain = np.abs((inside * rotation[:, 2]).sum(axis=-1)) / z**3
    if camera.distortion is None:
        return np.asarray(plain)
    return np.asarray(plain * np.abs(np.linalg.det(camera.distortion.jacobian(inside[..., :2] / z[..., None]))))
