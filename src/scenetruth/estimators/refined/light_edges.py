"""Errors of the motion at edges of light that do not move with the surface, such as borders of shadows.

Light on a surface is the same for all cameras at a time. Where images of one frame agree, but those of different frames
do not, and no other surface begins, light has changed or moved. A gain and an offset per window do not describe an edge
of it, which draws the motion towards its own. The velocity of the other pixels of the window shows this error; it is
added to the variances.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined.fit_maps import extract_fields, find_discontinuities
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.initialisation import fill_gaps
from scenetruth.estimators.refined.iterations import RefinedState
from scenetruth.estimators.refined.kernels.smoothing import gaussian_mean
from scenetruth.estimators.refined.kernels.warp import STEADY
from scenetruth.estimators.refined.row_bands import (
    FIT_LIMITS,
    NO_OCCLUSION,
    around,
    even_images,
    local_means,
    window_weights,
)
from scenetruth.schema.variables import MOTION_ACCELERATED, MOTION_ACCELERATED_IN_PART

__all__ = ["FrameDifferences", "add_light_edges", "compare_velocities"]

# Mean square difference between frames, relative to noise and to that within frames, from which light has changed; of
# noise alone, 1e-5 of the pixels exceed the first with five frames.
_CHANGED, _OF_FRAME, _FRAMES = 3.0, 2.0, 5
# Apparent displacement of the texture, in px per frame, from which a change is one of light: less is left by motions
# that are not quite steady.
_DISPLACED_PX = 0.02
# Standard deviations from which the difference of velocities is significant.
_SIGNIFICANT = 2.0
_SPREAD_PX = 1  # distance in px to which neighbours of changed pixels are not used
_CUT = 2.0  # half-width of windows in standard deviations
# Largest share of changed pixels in a wider window, relative to the window's σ: edges are lines, an unsteady motion
# changes all textured pixels.
_MOST_CHANGED, _WIDER = 0.5, 2.0
# Smallest fraction of the images that a window must use: fits to fewer frames leave the others unexplained.
_ALL_IMAGES = 0.75
# Texture that is added for stability, relative to that of all pixels of a window.
_LEAST_TEXTURE = 1e-6
_ROWS = 32

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class FrameDifferences:
    """Differences between warped images at pixels, summed over channels; 0 where unknown."""

    known: Mask
    between: Map
    """Mean square difference of the frames, in units of the variance of an image, shape (y, x)."""
    within: Map
    """Mean square difference of the images of a frame, in the same units."""
    tensor: Map
    """Products g_x², g_x g_y and g_y² of the texture gradient, shape (3, y, x)."""
    side: Map
    """Texture gradient times the change of grey values per frame, shape (2, y, x)."""
    times: Map
    """Sum of the squared times of the images from their mean."""

    @classmethod
    def blank(cls, shape: tuple[int, int], times: NDArray[np.float64]) -> FrameDifferences:
        """Return maps without any pixel, of images with these times."""
        known, squares = np.zeros(shape, dtype=np.bool_), np.full(shape, np.sum((times - times.mean()) ** 2))
        return cls(known, np.zeros(shape), np.zeros(shape), np.zeros((3, *shape)), np.zeros((2, *shape)), squares)

    def find_changed(self, frames: int, noise: float, sigma: float) -> Mask:
        """Return the pixels whose light has changed between the frames, at a noise of the images.

        ``sigma``: Standard deviation of the windows: an edge of light is steeper than the texture around it.
        """
        limit = 1.0 + (_CHANGED - 1.0) * math.sqrt((_FRAMES - 1) / min(frames - 1, _FRAMES - 1))
        between, within = (local_means(np.where(self.known, each, 1.0)) for each in (self.between, self.within))
        gradient = local_means(self.tensor[0] + self.tensor[2])
        usual, known = (
            gaussian_mean(each, _WIDER * sigma, _CUT)
            for each in (np.where(self.known, gradient, 0.0), self.known.astype(np.float64))
        )
        gradient = np.minimum(gradient, usual / np.maximum(known, 1e-9))
        square = (between - within) * noise**2 * (frames - 1) / self.times
        changed = (between > limit) & (between > _OF_FRAME * within)
        return np.asarray(self.known & changed & (square > _DISPLACED_PX**2 * gradient))


def add_light_edges(refined: RefinedState, settings: RefinedSettings) -> RefinedState:
    """Return the fit with the squared errors of velocities at edges of light."""
    images, fit, sigma = refined.images.included(), refined.fit, settings.window_sigma_px
    frames, cameras = len(images.times), len(images.positions)
    known = np.asarray(np.isfinite(fit.theta).all(axis=0))
    noise = images.residual_noise(fit.residual[0])
    if min(frames, cameras) == 1 or not known.any() or not noise > 0.0:
        return refined
    theta = fill_gaps(fit.theta, known)
    reach = window_weights(sigma).shape[2] // 2
    apart = around(_find_outlines(refined.images, theta, reach), reach)
    unsteady = (refined.motion == MOTION_ACCELERATED) | (refined.motion == MOTION_ACCELERATED_IN_PART)
    unsteady |= fit.images < _ALL_IMAGES * images.count
    # Pixels with images of one frame that agree leave this residual.
    least = 1.0 + (_CHANGED - 1.0) * (frames - 1) / (frames * cameras - 1)
    left = (refined.seen.square > least * noise**2) & np.isfinite(refined.seen.square) & ~unsteady & ~apart
    if not left.any():
        return refined
    fields = np.ascontiguousarray(extract_fields(theta))
    weights = window_weights(sigma)[0, 0] if settings.photometric_model == "per_image" else None
    near = around(left, 2 * reach)
    seen = _compare_frames(images, np.where(near, fields, np.nan), weights, noise)
    changed = seen.find_changed(frames, noise, sigma)
    share = gaussian_mean(changed.astype(np.float64), _WIDER * sigma, _CUT)
    edges = changed & ~unsteady & ~apart & (share < _MOST_CHANGED)
    if not edges.any():
        return refined
    change, hidden = compare_velocities(seen, changed, _image_velocity(images, fields), sigma, noise)
    variance = fit.variance
    with np.errstate(divide="ignore", invalid="ignore"):
        change, hidden = (np.asarray(images.transfers**2 * each / theta[0] ** 2) for each in (change, hidden))
        significant = ((change + hidden) / variance[3:5]).sum(axis=0) > _SIGNIFICANT**2
    where = significant & near & around(edges, reach) & ~apart & ~unsteady
    return replace(refined, light_edges=np.where(where & np.isfinite(change + hidden), change + hidden, 0.0))


def compare_velocities(
    seen: FrameDifferences, changed: Mask, velocity: Map, sigma: float, noise: float
) -> tuple[Map, Map]:
    """Return the squared errors of image velocities, of shape (2, y, x), in px² per frame², and their noise.

    They are the squared differences from the velocity at which the pixels without changes of light fit best in a
    Gaussian window. The noise is the variance of these velocities that is not that of all pixels.
    """
    used = seen.known & ~around(changed, _SPREAD_PX)

    def smooth(values: Map) -> Map:
        return np.stack([gaussian_mean(each, sigma, _CUT) for each in values])

    tensor = np.where(seen.known, seen.tensor, 0.0)
    whole, part = smooth(tensor), smooth(np.where(used, tensor, 0.0))
    side = smooth(np.where(used, _multiply(tensor, velocity) - seen.side, 0.0)) - _multiply(part, velocity)
    # Without any texture left, the velocity is kept, with a large variance.
    part[[0, 2]] += _LEAST_TEXTURE * (whole[0] + whole[2]) + 1e-30
    determinant = part[0] * part[2] - part[1] ** 2
    change = np.stack([part[2] * side[0] - part[1] * side[1], part[0] * side[1] - part[1] * side[0]]) / determinant
    of_pixel = noise**2 / (seen.times * 4.0 * math.pi * sigma**2)
    whole[[0, 2]] += _LEAST_TEXTURE * (whole[0] + whole[2]) + 1e-30
    usual = of_pixel * whole[[2, 0]] / (whole[0] * whole[2] - whole[1] ** 2)
    return change**2, np.maximum(of_pixel * part[[2, 0]] / determinant - usual, 0.0)


def _multiply(tensor: Map, vector: Map) -> Map:
    """Return the products of symmetric tensors (3, y, x) with vectors (2, y, x)."""
    return np.stack([tensor[0] * vector[0] + tensor[1] * vector[1], tensor[1] * vector[0] + tensor[2] * vector[1]])


def _find_outlines(images: ImageStack, theta: Map, least: int) -> Mask:
    """Return where another surface begins, along at least some pixels."""
    from scipy.ndimage import label

    # In a single frame, only disparities differ.
    lines, _ = label(find_discontinuities(images.within(0.0), theta), np.ones((3, 3)))
    long = np.bincount(lines.ravel()) >= least
    long[0] = False
    return np.asarray(long[lines])


def _image_velocity(images: ImageStack, fields: Map) -> Map:
    """Return the velocity in the image, px per frame, shape (2, y, x)."""
    y, x = np.mgrid[: images.shape[0], : images.shape[1]].astype(np.float64)
    d, q_x, q_y, q_z = fields[:STEADY]
    centre_x, centre_y = images.centre
    return np.asarray(
        d * np.stack([q_x - (x - centre_x) * q_z / images.focal, q_y - (y - centre_y) * q_z / images.focal])
    )


def _compare_frames(images: ImageStack, fields: Map, weights: Map | None, noise: float) -> FrameDifferences:
    """Warp all images by fields, NaN where not required, and compare them."""
    view = images.view()
    seen = FrameDifferences.blank(images.shape, view.t)
    frames, cameras, channels = len(images.times), len(images.positions), images.channels
    bad, height = images.bad_stack(), images.shape[0]
    least, margin = max(2, math.ceil(0.5 * images.count)), 0 if weights is None else len(weights)
    required = np.isfinite(fields[0])
    known = np.ones(images.shape, dtype=np.bool_)
    size = max(_ROWS, int(FIT_LIMITS.scratch_bytes / (4 * len(view.s) * images.shape[1])) - 2 * margin)
    rows = np.flatnonzero(required.any(axis=1))
    for top in range(int(rows[0]), int(rows[-1]) + 1, size):
        bottom = min(top + size, int(rows[-1]) + 1)
        first, end = max(top - margin, 0), min(bottom + margin, height)
        where = np.zeros(images.shape, dtype=np.bool_)
        where[top:bottom] = required[top:bottom]
        if not where.any():
            continue
        inside = where[first:end]
        for channel in range(channels):
            each = images.stack(channel), view, fields, NO_OCCLUSION, bad, first, weights, least, end - first
            even, gradient = even_images(*each)
            grey = even[:, inside].astype(np.float64).reshape(frames, cameras, -1)
            valid = np.isfinite(grey)
            counts = valid.sum(axis=1)
            known[where] &= (counts > 0).all(axis=0) & (counts.sum(axis=0) >= least)
            grey = np.where(valid, grey, 0.0)
            number = np.maximum(counts.sum(axis=0), 1)
            mean = grey.sum(axis=(0, 1)) / number
            of_frame = grey.sum(axis=1) / np.maximum(counts, 1)
            unit = 1.0 / (noise**2 * images.variance.at(mean))
            freedom = np.maximum(counts - 1, 0).sum(axis=0)
            within = np.where(valid, grey - of_frame[:, None], 0.0)
            seen.between[where] += unit * (counts * (of_frame - mean) ** 2).sum(axis=0) / (frames - 1) / channels
            seen.within[where] += unit * (within**2).sum(axis=(0, 1)) / np.maximum(freedom, 1) / channels
            times = view.t.reshape(frames, cameras, 1)
            off = np.where(valid, times - (times * valid).sum(axis=(0, 1)) / number, 0.0)
            squares = np.maximum((off**2).sum(axis=(0, 1)), 1e-12)
            slope = (off * grey).sum(axis=(0, 1)) / squares
            weight = unit * noise**2
            along, down = gradient[:, inside].astype(np.float64)
            seen.tensor[:, where] += weight * np.stack([along**2, along * down, down**2])
            seen.side[:, where] += weight * slope * np.stack([along, down])
            few = counts.sum(axis=0) < least
            seen.times[where] = np.where(few, seen.times[where], squares)
    seen.known[:] = known & required & np.isfinite(seen.tensor).all(axis=0)
    return seen
