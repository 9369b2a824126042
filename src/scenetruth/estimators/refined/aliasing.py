"""Systematic errors of fine textures: images are interpolated between pixels with an error that depends on the phase.

A wave of f cycles per px, sampled at integer pixels and interpolated by a B-spline of order n at a position X, has a
second component of frequency f - 1 with the amplitude r = f^(n+1) / (f^(n+1) + (1 - f)^(n+1)). Its phase relative to
the wave is -2πX: the image seems to be displaced by -r sin(2πX) / (2πf). This is below 1e-3 px for waves longer than
4 px, and 0.04 px at 2.4 px. The phase is the same in a whole window, so that windows do not average it; over images
of different phases it averages in part. The power spectrum of the reference determines the amplitude, the fitted
positions determine the phases, and the design of the fit determines what remains in disparity and motion.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.fit_maps import STEADY_PLACES
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels.window_solver import Fit
from scenetruth.schema.variables import MOTION_ACCELERATED, MOTION_ACCELERATED_IN_PART

__all__ = ["compute_phase_error_px", "enlarge_variances", "interpolation_error"]

_TAPS = 16  # half-width of the filters
_BLOCKS = 2.0  # blocks per standard deviation of a window
_ABOVE = 3.0  # smallest ratio of the power of fine waves to the standard error of that of noise
# Indices of the element's variances: slopes and curvatures follow disparity; rotation and growth follow motion.
_OF_SURFACE, _OF_MOTION = slice(0, 4), slice(4, 11)

Map = NDArray[np.float64]


def interpolation_error(frequency: Any, order: int) -> Any:
    """Return the amplitude of the second component of an interpolated wave, for frequencies up to 0.5 per px.

    >>> [round(float(interpolation_error(f, 5)), 4) for f in (0.25, 0.4, 0.5)]
    [0.0014, 0.0807, 0.5]
    """
    f = np.abs(frequency)
    return f ** (order + 1) / (f ** (order + 1) + (1.0 - f) ** (order + 1))


@cache
def _filters(order: int) -> tuple[Map, Map]:
    """Return filters m and m2: with T, they form the products of the gradient with the error per phase, and itself."""
    count = 8 * _TAPS
    f = np.abs(np.fft.fftfreq(count))
    # The response decays with the square of the distance: its inner half is unchanged, so that waves stay separate.
    window = np.minimum(2.0 * np.hanning(2 * _TAPS + 3)[1:-1], 1.0)
    whole = (2.0 * np.pi * f * interpolation_error(f, order), (2.0 * np.pi * f) ** 2)
    middle = slice(count // 2 - _TAPS, count // 2 + _TAPS + 1)
    first, second = (np.real(np.fft.fftshift(np.fft.ifft(each)))[middle] * window for each in whole)
    return first, second


def compute_phase_error_px(images: ImageStack, sigma_px: float, noise: float) -> tuple[Map, int]:
    """Return the amplitudes of the displacement error along x and y in blocks, (2, rows, columns), and their size.

    The displacement of least squares is Σ T_x e / Σ T_x² with the error e = (r / 2πf) T_x of every wave.
    """
    from scipy.ndimage import convolve1d, gaussian_filter

    block = max(1, round(sigma_px / _BLOCKS))
    frame, camera = images.reference()
    first, second = _filters(images.spline)
    sums: Map | None = None
    variance = 0.0
    for channel in range(images.channels):
        grey = images.grey(frame, camera, channel)
        square = noise**2 * images.variance.at(grey)
        grey -= grey.mean()
        # The same noise is in both factors.
        parts = [
            _block_means(grey * convolve1d(grey, taps, axis=axis, mode="mirror") - taps[_TAPS] * square, block)
            for taps in (first, second)
            for axis in (1, 0)
        ]
        sums = np.stack(parts) if sums is None else sums + np.stack(parts)
        variance += 2.0 * float((first**2).sum()) * noise**4
    assert sums is not None
    means = np.stack([gaussian_filter(each, sigma_px / block) for each in sums])
    # Below its standard error, the power of fine waves is that of noise.
    floor = _ABOVE * np.sqrt(variance / (4.0 * np.pi * sigma_px**2))
    power = np.maximum(means[:2] - floor, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.where(means[2:] > 0, power / means[2:], 0.0)
    return np.minimum(error, 0.5), block


def enlarge_variances(
    images: ImageStack, fit: Fit, motion: NDArray[np.int8], sigma_px: float, *, accelerated: bool
) -> Fit:
    """Return a fit whose variances include the interpolation error of fine textures.

    ``motion``: Motion model of every pixel, as in ``motion_model``, which determines the frames of the fit.
    ``accelerated``: Whether all motions are accelerated.
    """
    from scipy.ndimage import gaussian_filter

    noise = images.residual_noise(fit.residual[0]) / images.transfer
    if not np.isfinite(noise):
        return fit
    error, block = compute_phase_error_px(images, sigma_px, noise)
    if not error.any():
        return fit
    centres = [
        np.minimum(np.arange(count) * block + block // 2, size - 1)
        for count, size in zip(error.shape[1:], images.shape, strict=True)
    ]
    grid = np.ix_(*centres)
    theta = fit.theta[:, centres[0][:, None], centres[1]]
    chosen, used = motion[grid], fit.images[grid]
    added = np.zeros((4, *error.shape[1:]))
    cameras = len(images.positions)
    spans = [(images, chosen < MOTION_ACCELERATED, accelerated), (images, chosen == MOTION_ACCELERATED, True)]
    in_part = chosen == MOTION_ACCELERATED_IN_PART
    if in_part.any():
        near = images.within(1.0)
        few = used <= len(near.times) * cameras
        spans += [(near, in_part & few, True), (images.within(2.0), in_part & ~few, True)]
    for part, where, curved in spans:
        if where.any():
            added[:, where] = _added(part, theta[:, where], (centres[1], centres[0]), where, error, accelerated=curved)
    known = np.isfinite(added).all(axis=0)
    weights = np.maximum(gaussian_filter(known.astype(np.float64), sigma_px / block), 1e-9)
    # The sign of an error alternates with the phase: neighbours have its mean square.
    added = np.stack([gaussian_filter(np.where(known, each, 0.0), sigma_px / block) / weights for each in added])
    rows, columns = (np.arange(size) // block for size in images.shape)
    whole = added[:, rows[:, None], columns]
    variance = fit.variance.copy()
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = 1.0 + whole / variance[[0, 3, 4, 5]]
        variance[[0, 3, 4, 5]] += whole
        # Derivatives within a window: the error is nearly the same there, and changes by less than its size.
        element = fit.element_variance.copy()
        element[_OF_SURFACE] *= np.sqrt(ratio[0])
        element[_OF_MOTION] *= np.sqrt(0.5 * (ratio[1] + ratio[2]))
        variance[1:3] *= np.sqrt(ratio[0])
        variance[6:] *= ratio[1:][: len(variance) - 6]
    return fit._replace(variance=variance, element_variance=element.astype(np.float32))


def _added(
    images: ImageStack,
    theta: Map,
    centres: tuple[NDArray[np.intp], NDArray[np.intp]],
    where: NDArray[np.bool_],
    error: Map,
    *,
    accelerated: bool,
) -> Map:
    """Return the squared errors of d, q_X, q_Y and q_Z at the blocks of a mask, shape (4, n).

    The displacements of the images are a linear function of d, of d q, and of the change of d per frame, which is
    inverted by least squares. The sum of the squares is that of the phases at the fitted positions, which may agree by
    symmetry, and of independent phases.
    """
    view = images.view()
    s, s_y, t = view.s, view.s_y, view.t
    columns = [(-s, -s_y), (t, 0 * t), (0 * t, t), (s * t, s_y * t)]
    if accelerated and len(images.times) > 2:
        half = 0.5 * t * t
        columns += [(half, 0 * t), (0 * t, half), (s * half, s_y * half)]
    inverse = np.linalg.pinv(np.stack([np.concatenate(each) for each in columns], axis=-1))[:4]
    at_rows, at_columns = np.nonzero(where)
    x, y = centres[0][at_columns] - view.centre_x, centres[1][at_rows] - view.centre_y
    d, q_x, q_y, q_z = theta[STEADY_PLACES]
    sizes = error[:, where]
    out = np.zeros((4, len(d)))
    for i in range(len(s)):
        scale = 1.0 / (1.0 + t[i] * d * q_z / view.focal)
        at_x = (x + d * (t[i] * q_x - s[i])) * scale + view.centre_x
        at_y = (y + d * (t[i] * q_y - s_y[i])) * scale + view.centre_y
        out += inverse[:, i, None] * sizes[0] * np.sin(2.0 * np.pi * at_x)
        out += inverse[:, len(s) + i, None] * sizes[1] * np.sin(2.0 * np.pi * at_y)
    halves = np.stack([(inverse[:, : len(s)] ** 2).sum(axis=1), (inverse[:, len(s) :] ** 2).sum(axis=1)])
    square = out**2 + 0.5 * (halves[0][:, None] * sizes[0] ** 2 + halves[1][:, None] * sizes[1] ** 2)
    if len(images.positions) == 1:
        return np.stack([0.0 * d, square[1], square[2], 0.0 * d])
    # From px to the units of the parameters: d q, and d² q_Z / f.
    return np.stack([square[0], square[1] / d**2, square[2] / d**2, square[3] * (view.focal / d**2) ** 2])


def _block_means(values: Map, block: int) -> Map:
    """Return the means over blocks of pixels, which are smaller at the right and at the bottom."""
    for axis in (0, 1):
        size = values.shape[axis]
        edges = np.arange(0, size, block)
        counts = np.diff(np.append(edges, size))
        values = np.add.reduceat(values, edges, axis=axis) / (counts[:, None] if axis == 0 else counts)
    return values
