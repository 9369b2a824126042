"""Displacements that methods find in windows of demosaiced images, from the waves behind the demosaicing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from scenetruth.camera.sensor import DemosaicedWave, quintic_spline_response
from scenetruth.estimators.method_settings import StructureTensorSettings
from scenetruth.estimators.structure_tensor import PAPER, choose_acquisition_axes
from tests.helpers.demosaiced_waves import STEPS

__all__ = ["refined_map", "tensor_map"]

Floats = NDArray[np.float64]

_DEGREE, _PLACES = 7, 10
_SMALL_PX = 1e-4
_LEAST_GAIN = 0.1
_CONVERGED_PX = 1e-6


class _Window:
    """Gaussian window of both axes, truncated at a distance in px."""

    def __init__(self, sigma_px: float, reach: int) -> None:
        self.at = np.arange(-reach, reach + 1.0)
        self.weights = np.exp(-0.5 * (self.at / sigma_px) ** 2)
        self.weights /= self.weights.sum()

    def __call__(self, values: Floats, along_x: int = 0, along_y: int = 0) -> Floats:
        """Return the weighted sums around every pixel, times powers of the distance along x and y."""
        summed = correlate1d(values, self.weights * self.at**along_x, axis=1)
        return np.asarray(correlate1d(summed, self.weights * self.at**along_y, axis=0))


def _phases(waves: Sequence[DemosaicedWave], shape: tuple[int, int]) -> NDArray[np.complex128]:
    """Return exp(i κ x) of all waves and aliases at all pixels, shape (y, x, n)."""
    y, x = np.indices(shape).astype(np.float64)
    vectors = np.concatenate([wave.wave_vectors for wave in waves])
    return np.asarray(np.exp(1j * (x[..., None] * vectors[:, 0] + y[..., None] * vectors[:, 1])))


def tensor_map(
    waves: Sequence[DemosaicedWave], displacement_px: float, shape: tuple[int, int], sigma_px: float = 6.0
) -> Floats:
    """Return the disparity of the structure tensor of images of a plane, unregistered, in its windows, shape (y, x)."""
    over_s = choose_acquisition_axes(STEPS.astype(np.float64), 1, StructureTensorSettings()).over_s
    scale = np.sqrt(PAPER.noise_ratio / over_s.noise_ratio)
    amplitudes = np.concatenate([wave.amplitudes for wave in waves])
    vectors = np.concatenate([wave.wave_vectors for wave in waves])
    own = np.repeat([wave.wave_vector[0] for wave in waves], 4)
    (along_x, smooth_x), (along_y, smooth_y) = (PAPER.transfer(k) for k in vectors.T)
    along_s, smooth_s = over_s.transfer(own * displacement_px)
    responses = (
        along_x * smooth_y * smooth_s, smooth_x * along_y * smooth_s, scale * smooth_x * smooth_y * along_s,
    )  # fmt: skip
    phases = _phases(waves, shape)
    gradient = [(phases @ (each[:, None] * amplitudes)).real for each in responses]
    window = _Window(sigma_px, StructureTensorSettings().window_taps_px // 2)
    tensor = np.array([[window((one * other).sum(axis=-1)) for one in gradient] for other in gradient])
    _, vector = np.linalg.eigh(np.moveaxis(tensor, (0, 1), (-2, -1)))
    return np.asarray(-vector[..., 0, 0] / vector[..., 2, 0] / scale)


def refined_map(
    waves: Sequence[DemosaicedWave],
    displacement_px: float,
    shape: tuple[int, int],
    sigma_px: float,
    *,
    gains: bool = True,
    reach_px: float = 0.15,
    iterations: int = 40,
) -> Floats:
    """Return the disparity at which Gauss-Newton steps of the method ``refined`` end, shape (y, x).

    The images at the displacement u of every pixel follow from the waves. In every window, a plane is fitted to the
    differences to their mean, with a common gradient, after removal of a gain and an offset of each image.

    ``reach_px``: Largest difference of u to the displacement.
    """
    values, slopes = _images(waves, displacement_px, shape, reach_px)
    window = _Window(sigma_px, int(np.ceil(2 * sigma_px)))
    found = np.full(shape, displacement_px)
    for _ in range(iterations):
        at = (found - displacement_px)[..., None] / reach_px
        images = np.polynomial.chebyshev.chebval(at, values, tensor=False)
        gradient = np.polynomial.chebyshev.chebval(at, slopes, tensor=False).mean(axis=0)
        if gains:
            images = np.stack([_without_gains(each, window) for each in np.moveaxis(images, -1, 0)], axis=-1)
        known = np.isfinite(images)
        count = known.sum(axis=0)
        mean = np.where(known, images, 0).sum(axis=0) / np.maximum(count, 1)
        left = np.where(known, mean - np.where(known, images, 0), 0)
        change = np.where(known, STEPS[:, None, None, None] * gradient, 0)
        change = np.where(known, change - change.sum(axis=0) / np.maximum(count, 1), 0)
        square = (change**2).sum(axis=(0, -1))
        side = square * found + (change * left).sum(axis=(0, -1))
        moments = {(i, j): window(square, i, j) for i in range(3) for j in range(3 - i)}
        basis = ((0, 0), (1, 0), (0, 1))
        normal = np.array([[moments[a + c, b + d] for a, b in basis] for c, d in basis])
        sides = np.array([window(side, a, b) for a, b in basis])
        solved = np.linalg.solve(np.moveaxis(normal, (0, 1), (-2, -1)), np.moveaxis(sides, 0, -1)[..., None])
        before, found = found, np.clip(solved[..., 0, 0], displacement_px - reach_px, displacement_px + reach_px)
        if np.quantile(np.abs(found - before), 0.99) < _CONVERGED_PX:
            break
    return found


def _images(
    waves: Sequence[DemosaicedWave], displacement_px: float, shape: tuple[int, int], reach_px: float
) -> tuple[Floats, Floats]:
    """Return Chebyshev coefficients of registered images and gradients over u, shape (degree, s, y, x, colour)."""
    amplitudes = np.concatenate([wave.amplitudes for wave in waves])
    vectors = np.concatenate([wave.wave_vectors for wave in waves])
    own = np.repeat([wave.wave_vector[0] for wave in waves], 4)
    phases, at = _phases(waves, shape), np.polynomial.chebyshev.chebpts1(_PLACES)
    fitted: list[Any] = []
    for offsets in ((0.0,), (_SMALL_PX, -_SMALL_PX)):
        factors = []
        for place in displacement_px + reach_px * at:
            for s in STEPS:
                each = [quintic_spline_response(vectors, float(place * s + offset)) for offset in offsets]
                response = each[0] if len(each) == 1 else (each[0] - each[1]) / (2 * _SMALL_PX)
                factors.append(response * np.exp(-1j * own * displacement_px * s))
        count = len(STEPS)
        series = np.linalg.pinv(np.polynomial.chebyshev.chebvander(at, _DEGREE))
        of_wave = np.einsum("dp,psn->dsn", series, np.array(factors).reshape(_PLACES, count, -1))
        fitted.append(np.array([[(phases @ (w[:, None] * amplitudes)).real for w in each] for each in of_wave]))
    return fitted[0], fitted[1]


def _without_gains(images: NDArray[Any], window: _Window) -> Floats:
    """Remove gain and offset relative to the mean image, estimated every few pixels, from images of one channel."""
    mean = images.mean(axis=0)
    step = max(1, round(len(window.at) / 6))
    grey, square = window(mean), window(mean * mean)
    spread = square - grey**2
    out = np.empty_like(images)
    for each, target in zip(images, out, strict=True):
        own = window(each)
        with np.errstate(invalid="ignore", divide="ignore"):
            gain = np.where(spread > 1e-9, (window(each * mean) - own * grey) / spread, 1.0)
        gain = np.where(gain > _LEAST_GAIN, gain, np.nan)
        target[:] = (each - _between(own - gain * grey, step)) / _between(gain, step)
    return out


def _between(values: Floats, step: int) -> Floats:
    """Interpolate the values at every n-th pixel, and at the last, linearly."""
    for axis in (0, 1):
        size = values.shape[axis]
        at = np.unique([*range(0, size, step), size - 1])
        values = np.apply_along_axis(lambda line: np.interp(np.arange(size), at, line[at]), axis, values)  # noqa: B023
    return values
