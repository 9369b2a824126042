"""Systematic errors of fine textures: images are interpolated between pixels with an error that depends on the phase.

A wave of f cycles per px, sampled at integer pixels and interpolated by a B-spline of order n at a position X, has a
second component of frequency f - 1 with the amplitude r = f^(n+1) / (f^(n+1) + (1 - f)^(n+1)). Its phase relative to
the wave is -2πX: the image seems to be displaced by -r sin(2πX) / (2πf). This is below 1e-3 px for waves longer than
4 px, and 0.04 px at 2.4 px. The phase is the same in a whole window, so that windows do not average it; over images
of different phases it averages in part. The power spectrum of the reference determines the amplitude, the fitted
positions determine the phases, and the design of the fit determines what remains in disparity and motion.

Demosaicing gives a wave of f cycles per px an alias of f - 1/2, with the phase πX relative to the wave. An image seems
to be displaced by A Im(m* exp(iπX)), with the mean m of exp(iπX) over all images, and A the mean of 2πf over the power
of the aliases, relative to that of (2πf)² over all power.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.channel_noise import Covariances
from scenetruth.estimators.refined.fit_maps import STEADY_PLACES
from scenetruth.estimators.refined.image_stack import ImageStack, without_aliases
from scenetruth.estimators.refined.kernels.warp import ImageView
from scenetruth.estimators.refined.kernels.window_solver import Fit
from scenetruth.estimators.refined.noise_estimation import spline_transfer
from scenetruth.schema.variables import MOTION_ACCELERATED, MOTION_ACCELERATED_IN_PART

__all__ = ["compute_phase_error_px", "enlarge_variances", "interpolation_error", "measure_noise_coupling"]

_TAPS = 16  # half-width of the filters
_TEXTURE, _ALIAS = 0.15, 0.35  # frequencies up to which waves of demosaiced images are texture, and from which aliases
# Aliases: largest amplitude of the displacement in px, of those as strong as the texture; smallest share of the squared
# gradient that is due to the texture; wave number of long aliases in rad per px.
_MOST_PX, _LEAST_OF_TEXTURE, _LONG = 1.5, 0.3, 0.9
# Standard deviation in px of the smoothing of gradients; smallest and largest ratio of variances; smallest share of the
# squared gradient along an axis with texture.
_SLOPE_PX, _LEAST_COUPLING, _MOST_COUPLING, _LEAST_TEXTURE = 0.5, 0.05, 3.0, 0.02
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
def _filters(order: int, *, aliases: bool = False) -> tuple[Map, Map, Map]:
    """Return filters m, m2 and m0: with T, they form the products of the gradient with the error per phase, and itself.

    The last one selects the waves of the error.

    ``aliases``: Of the aliases of demosaicing, instead of interpolation.
    """
    count = 8 * _TAPS
    f = np.abs(np.fft.fftfreq(count))
    # The response decays with the square of the distance: its inner half is unchanged, so that waves stay separate.
    window = np.minimum(2.0 * np.hanning(2 * _TAPS + 3)[1:-1], 1.0)
    if aliases:
        # A smooth transition has a short filter.
        share = np.sin(0.5 * np.pi * np.clip((f - _TEXTURE) / (_ALIAS - _TEXTURE), 0.0, 1.0)) ** 2
    else:
        share = interpolation_error(f, order)
    whole = (2.0 * np.pi * f * share, (2.0 * np.pi * f) ** 2, share)
    middle = slice(count // 2 - _TAPS, count // 2 + _TAPS + 1)
    first, second, power = (np.real(np.fft.fftshift(np.fft.ifft(each)))[middle] * window for each in whole)
    return first, second, power


def compute_phase_error_px(
    images: ImageStack, sigma_px: float, noise: float, *, aliases: bool = False
) -> tuple[Map, int]:
    """Return the amplitudes of the displacement error along x and y in blocks, (2, rows, columns), and their size.

    The displacement of least squares is Σ T_x e / Σ T_x² with the error e = (r / 2πf) T_x of every wave.

    ``aliases``: Error of the aliases of demosaicing, instead of interpolation.
    """
    (_, products, gradient), block = _measure_fine_waves(images, sigma_px, noise, aliases=aliases)
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.where(gradient > 0, products / gradient, 0.0)
    return np.minimum(error, 0.5), block


def _measure_fine_waves(images: ImageStack, sigma_px: float, noise: float, *, aliases: bool) -> tuple[Map, int]:
    """Return the power of fine waves, its product with their wave number, and the mean square gradient, in blocks.

    They are sums over the channels, for waves along x and y, of the shape (3, 2, rows, columns).
    """
    from scipy.ndimage import convolve1d, gaussian_filter

    block = max(1, round(sigma_px / _BLOCKS))
    frame, camera = images.reference()
    first, second, share = _filters(images.spline, aliases=aliases)
    sums: Map | None = None
    variance = 0.0
    for channel in range(images.channels):
        grey = images.grey(frame, camera, channel)
        square = noise**2 * images.variance.at(grey)
        grey -= grey.mean()
        # Covariances of the noise of neighbours, relative to its power at low frequencies.
        along = np.zeros(_TAPS + 1)
        row = (1.0,) if images.demosaiced is None else images.demosaiced.covariances[channel][channel][0]
        along[: len(row)] = row
        covariance = np.concatenate([along[:0:-1], along])
        # The same noise is in both factors.
        parts = [
            _block_means(grey * convolve1d(grey, taps, axis=axis, mode="mirror") - taps @ covariance * square, block)
            for taps in (first, second, share)
            for axis in (1, 0)
        ]
        sums = np.stack(parts) if sums is None else sums + np.stack(parts)
        variance += 2.0 * float((first**2).sum()) * noise**4 * float(along[0]) ** 2
    assert sums is not None
    means = np.stack([gaussian_filter(each, sigma_px / block) for each in sums])
    # Below its standard error, the power of fine waves is that of noise.
    floor = _ABOVE * np.sqrt(variance / (4.0 * np.pi * sigma_px**2))
    return np.stack([means[4:], np.maximum(means[:2] - floor, 0.0), means[2:4]]), block


def enlarge_variances(
    images: ImageStack,
    fit: Fit,
    motion: NDArray[np.int8],
    sigma_px: float,
    *,
    accelerated: bool,
    by_aliases: Map | None = None,
    coupling: Map | float = 1.0,
) -> Fit:
    """Return a fit whose variances include the interpolation error of fine textures.

    ``motion``: Motion model of every pixel, as in ``motion_model``, which determines the frames of the fit.
    ``accelerated``: Whether all motions are accelerated.
    ``by_aliases``: As from `measure_alias_residual`, if aliases are separated.
    ``coupling``: As from `measure_noise_coupling`.
    """
    from scipy.ndimage import gaussian_filter

    noise = images.residual_noise(without_aliases(fit.residual[0], by_aliases)) / images.transfer
    if not np.isfinite(noise):
        return fit
    error, block = compute_phase_error_px(images, sigma_px, noise)
    of_aliases, most = np.zeros_like(error), None
    centres = [
        np.minimum(np.arange(count) * block + block // 2, size - 1)
        for count, size in zip(error.shape[1:], images.shape, strict=True)
    ]
    grid = np.ix_(*centres)
    if images.demosaiced is not None:
        fine, _ = _measure_fine_waves(images, sigma_px, noise, aliases=True)
        unit = images.channels * images.variance.at(images.reference_grey()[grid])
        if by_aliases is not None:
            of_aliases = _displace_by(by_aliases[(slice(1, 3), *grid)] * unit, fine)
        else:
            of_aliases, _ = compute_phase_error_px(images, sigma_px, noise, aliases=True)
            most = _displace_by(fit.residual[0][grid] * unit, fine)
    if not error.any() and not of_aliases.any():
        return fit
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
        for kind, sizes in ((_interpolated, error), (_aliased, of_aliases)):
            if where.any() and sizes.any():
                at = theta[:, where], (centres[1], centres[0]), where
                limit = most if kind is _aliased else None
                added[:, where] += _added(part, *at, sizes, kind, most=limit, accelerated=curved)
    if by_aliases is not None:
        added += by_aliases[(slice(3, None), *grid)]
    known = np.isfinite(added).all(axis=0)
    weights = np.maximum(gaussian_filter(known.astype(np.float64), sigma_px / block), 1e-9)
    # The sign of an error alternates with the phase: neighbours have its mean square.
    added = np.stack([gaussian_filter(np.where(known, each, 0.0), sigma_px / block) / weights for each in added])
    rows, columns = (np.arange(size) // block for size in images.shape)
    whole = added[:, rows[:, None], columns]
    if images.demosaiced is not None:
        # Maps divide by the squared transfer, as is due to variances by noise.
        whole *= (images.transfers_of(fit.residual[0], by_aliases, coupling) / spline_transfer(images.spline)) ** 2
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


def measure_noise_coupling(images: ImageStack, sigma_px: float, noise: float) -> Map | float:
    """Return the variance by demosaiced noise relative to that by white noise of its power at low frequencies, (y, x).

    A fit weights noise with the gradient T of the texture: its variance is Σ T C T' / (Σ T²)² with the covariances C.
    Of the ratios for T_x and T_y to Σ T², the larger one is returned, because variances combine both.

    ``noise``: Standard deviation of white noise of the same power.
    """
    from scipy.ndimage import convolve, gaussian_filter

    if images.demosaiced is None:
        return 1.0
    frame, camera = images.reference()
    impulse = np.zeros((8 * _TAPS, 8 * _TAPS))
    impulse[0, 0] = 1.0
    channels = range(images.channels)
    greys = [images.grey(frame, camera, channel) for channel in channels]
    noises = [noise * np.sqrt(images.variance.at(grey)) for grey in greys]
    sums = np.zeros((2, 2, *images.shape))
    for place, order in enumerate(((0, 1), (1, 0))):
        slopes = [gaussian_filter(grey - grey.mean(), _SLOPE_PX, order=order) for grey in greys]
        # Noise of the reference is in both factors: gradients of it, and their products.
        passed = np.abs(np.fft.fft2(gaussian_filter(impulse, _SLOPE_PX, order=order, mode="wrap"))) ** 2
        for one, other in product(channels, channels):
            covariances = images.demosaiced.covariances[one][other]
            if not covariances:
                continue
            whole = _whole(covariances)
            power = np.real(np.fft.fft2(_centred(whole, len(impulse))))
            both = noises[one] * noises[other]
            if one == other:
                sums[0, place] += slopes[one] ** 2 - np.mean(passed * power) * both
            weighted = convolve(slopes[other], whole, mode="mirror")
            sums[1, place] += slopes[one] * weighted - np.mean(passed * power**2) * both
    gradient, coupled = (np.stack([gaussian_filter(each, sigma_px) for each in part]) for part in sums)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(gradient > 0, coupled / gradient, 1.0)
    # An axis without texture, along which nothing is determined, does not count.
    ratio[gradient < _LEAST_TEXTURE * gradient.sum(axis=0)] = 0.0
    coupling: Map = np.clip(ratio, _LEAST_COUPLING, _MOST_COUPLING).max(axis=0)
    return coupling


def _whole(quadrant: Covariances) -> Map:
    """Return symmetric covariances at all distances."""
    half = np.array(quadrant)
    half = np.concatenate([half[:0:-1], half])
    return np.concatenate([half[:, :0:-1], half], axis=1)


def _centred(values: Map, size: int) -> Map:
    """Return values around the first element of a square array, with its ends next to each other."""
    reach = len(values) // 2
    return np.roll(np.pad(values, (0, size - len(values))), (-reach, -reach), axis=(0, 1))


def _displace_by(power: Map, fine: Map) -> Map:
    """Return the amplitudes of the displacement error by aliases of a power, in px.

    Aliases are the fine waves themselves, or have the wave numbers that those of a fine texture leave to π; beyond the
    power of the fine waves, they are long.

    ``fine``: Fine waves of the reference, see `_measure_fine_waves`.
    """
    visible, products, gradient = fine
    with np.errstate(divide="ignore", invalid="ignore"):
        number = np.clip(np.where(visible > 0, products / visible, _LONG), 0.0, np.pi)
        share = np.where(power < visible, power / visible, 1.0)
        number = share * number + (1.0 - share) * (np.pi - number)
        beyond = np.where(power > visible, 1.0 - np.maximum(visible, 0.0) / power, 0.0)
        number = (1.0 - beyond) * number + beyond * _LONG
        # The more of the gradient is that of aliases, the more they displace the fit, and the fitted positions.
        of_texture = np.maximum(1.0 - power * number**2 / gradient, _LEAST_OF_TEXTURE)
        return np.where(gradient > 0, np.minimum(power * number / gradient / of_texture**3, _MOST_PX), 0.0)


def combine_displacements(view: ImageView, *, accelerated: bool) -> Map:
    """Return how displacements of n images along x, then y, change d, d q_X, d q_Y and the change of d, (4, 2n)."""
    s, s_y, t = view.s, view.s_y, view.t
    columns = [(-s, -s_y), (t, 0 * t), (0 * t, t), (s * t, s_y * t)]
    if accelerated:
        half = 0.5 * t * t
        columns += [(half, 0 * t), (0 * t, half), (s * half, s_y * half)]
    return np.linalg.pinv(np.stack([np.concatenate(each) for each in columns], axis=-1))[:4]


def _added(
    images: ImageStack,
    theta: Map,
    centres: tuple[NDArray[np.intp], NDArray[np.intp]],
    where: NDArray[np.bool_],
    error: Map,
    displaced: Callable[[Map], tuple[Map, Map]],
    *,
    most: Map | None,
    accelerated: bool,
) -> Map:
    """Return the squared errors of d, q_X, q_Y and q_Z at the blocks of a mask, shape (4, n).

    The displacements of the images are a linear function of d, of d q, and of the change of d per frame, which is
    inverted by least squares. The sum of the squares is that of the phases at the fitted positions, which may agree by
    symmetry, and of independent phases.

    ``displaced``: Displacements at the positions of the images, relative to the error, and their mean square.
    """
    view = images.view()
    s, s_y, t = view.s, view.s_y, view.t
    inverse = combine_displacements(view, accelerated=accelerated and len(images.times) > 2)
    at_rows, at_columns = np.nonzero(where)
    x, y = centres[0][at_columns] - view.centre_x, centres[1][at_rows] - view.centre_y
    d, q_x, q_y, q_z = theta[STEADY_PLACES]
    sizes = error[:, where]
    at = np.empty((2, len(s), len(d)))
    for i in range(len(s)):
        scale = 1.0 / (1.0 + t[i] * d * q_z / view.focal)
        at[0, i] = (x + d * (t[i] * q_x - s[i])) * scale + view.centre_x
        at[1, i] = (y + d * (t[i] * q_y - s_y[i])) * scale + view.centre_y
    out = np.zeros((4, len(d)))
    (right, square_x), (down, square_y) = displaced(at[0]), displaced(at[1])
    if most is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            left = np.maximum(1.0 - 2.0 * np.stack([square_x, square_y]), 0.0) * len(s) / max(len(s) - 1, 1)
            sizes = np.fmin(sizes, most[:, where] / left)
    for i in range(len(s)):
        out += inverse[:, i, None] * sizes[0] * right[i]
        out += inverse[:, len(s) + i, None] * sizes[1] * down[i]
    square = out**2
    if displaced is _interpolated:
        sums = np.stack([(inverse[:, : len(s)] ** 2).sum(axis=1), (inverse[:, len(s) :] ** 2).sum(axis=1)])
        square += sums[0][:, None] * sizes[0] ** 2 * square_x + sums[1][:, None] * sizes[1] ** 2 * square_y
    if len(images.positions) == 1:
        return np.stack([0.0 * d, square[1], square[2], 0.0 * d])
    # From px to the units of the parameters: d q, and d² q_Z / f.
    return np.stack([square[0], square[1] / d**2, square[2] / d**2, square[3] * (view.focal / d**2) ** 2])


def _interpolated(places: Map) -> tuple[Map, Map]:
    """Return the displacements by interpolation of images at positions in px, shape (n, any), and the mean square."""
    return np.sin(2.0 * np.pi * places), np.full(places.shape[1:], 0.5)


def _aliased(places: Map) -> tuple[Map, Map]:
    """Return those by aliases of demosaicing, relative to the mean of the images."""
    turned = np.exp(1j * np.pi * places)
    mean = turned.mean(axis=0)
    return (np.conj(mean) * turned).imag, 0.5 * np.abs(mean) ** 2


def _block_means(values: Map, block: int) -> Map:
    """Return the means over blocks of pixels, which are smaller at the right and at the bottom."""
    for axis in (0, 1):
        size = values.shape[axis]
        edges = np.arange(0, size, block)
        counts = np.diff(np.append(edges, size))
        values = np.add.reduceat(values, edges, axis=axis) / (counts[:, None] if axis == 0 else counts)
    return values
