"""Noise model of the standard uncertainties: propagation of image noise through filters, window and null space."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from scenetruth.estimators.method_settings import StructureTensorSettings
from scenetruth.estimators.structure_tensor.filters import PAPER, REACH, AcquisitionAxes, FilterPair, gaussian_window
from scenetruth.estimators.structure_tensor.maps import STRIDE, Texture
from scenetruth.threads import bands, in_threads

__all__ = ["NoiseModel", "propagate_noise", "texture_transfer"]

Array = NDArray[np.float64]

_PHASES = np.linspace(0.0, 2.0, 65)


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Noise power after the filters, for white image noise of unit power.

    The constraint r = d·p is one linear filter of the images, with a zero at the spatial and temporal frequency of a
    texture that satisfies it. First-order errors of p are A⁻¹ Σ w d r, so their covariance depends on the noise that
    passes this filter around the frequency of the texture, within the bandwidth of the window. In x and y the window is
    wide and the filter flat; along s there is no window, along t a short one: there the noise depends on the phase φ by
    which the texture advances per step, and is tabulated.
    """

    residual_s: tuple[float, float]
    """Expectation of p_sᵀ J p_s: the constant and the factor of v_x²."""
    residual_t: tuple[float, float]
    """Expectation of p_tᵀ J p_t: the constant and the factor of u_x² + u_y²."""
    gradient: float
    """Expectation of Σ w g_x² in an image of pure noise."""
    window: float
    """Σ w² over x and y."""
    moment_ratio: float
    """Σ w² ξ² / Σ w² over Σ w ξ²: the relative second moment of the squared window."""
    phases: Array
    """φ in radian per step, at which the following values are tabulated."""
    disparity_s: Array
    """Noise of the disparity constraint along s, around a texture that moves by φ per camera step."""
    disparity_t: Array
    """Noise factor of its filter and window along t, around a texture that moves by φ per frame."""
    motion_s: float
    """Noise of the motion constraint along s."""
    motion_t: Array
    """Noise of the motion constraint along t, after the window, around a texture that moves by φ per frame."""


def propagate_noise(
    rig: AcquisitionAxes, over_s: FilterPair, over_t: FilterPair, channels: int, settings: StructureTensorSettings
) -> NoiseModel:
    """Propagate white noise of unit power through the filters and the window of an estimate."""
    s_xy, d_xy = _power(PAPER.smoothing), _power(PAPER.derivative)
    (s_s, d_s), (s_t, d_t) = ((_power(pair.smoothing), _power(pair.derivative)) for pair in (over_s, over_t))
    window = gaussian_window(settings.window_sigma_px, settings.window_taps_px)
    offsets = np.arange(len(window)) - len(window) // 2
    alone = np.ones(1)
    return NoiseModel(
        residual_s=(channels * d_s * s_xy**2 * s_t, channels * s_s * d_xy * s_xy * s_t),
        residual_t=(channels * s_s * d_t * s_xy**2, channels * s_s * s_t * d_xy * s_xy),
        gradient=channels * s_s * s_t * d_xy * s_xy,
        window=_power(window) ** 2,
        moment_ratio=_moment_ratio(window, offsets),
        phases=_PHASES,
        disparity_s=_constraint_noise(over_s, alone),
        disparity_t=_smoothing_noise(over_t, rig.window_t),
        motion_s=s_s,
        motion_t=_constraint_noise(over_t, rig.window_t),
    )


def _moment_ratio(window: Array, offsets: NDArray[Any]) -> float:
    spread = float(window @ offsets**2)
    return float((window**2 @ offsets**2) / _power(window) / spread) if spread > 0 else 1.0


def _power(weights: Array) -> float:
    return float(np.sum(weights**2))


def _spread(weights: NDArray[Any], window: Array) -> Array:
    """Return Σ_τ |Σ_m w_m e^{iφm} h(τ - m)|² for every phase; ``weights`` has the shape (phase, node)."""
    turned = window * np.exp(1j * np.outer(_PHASES, np.arange(len(window))))
    taken = np.zeros((len(_PHASES), weights.shape[1] + len(window) - 1), dtype=np.complex128)
    for m in range(len(window)):
        taken[:, m : m + weights.shape[1]] += turned[:, m : m + 1] * weights
    return np.asarray(np.sum(np.abs(taken) ** 2, axis=1))


def _constraint_noise(pair: FilterPair, window: Array) -> Array:
    """Return the noise that passes D - (D̂ / Ŝ)(φ) S, the filter of the constraint around a texture of phase φ."""
    derivative, smoothing = pair.transfer(_PHASES)
    ratio = derivative / smoothing
    return _spread(np.conj(pair.derivative - ratio[:, None] * pair.smoothing), window)


def _smoothing_noise(pair: FilterPair, window: Array) -> Array:
    return _spread(np.broadcast_to(pair.smoothing, (len(_PHASES), len(pair.smoothing))), window)


def texture_transfer(image: NDArray[np.float32], settings: StructureTensorSettings) -> Texture:
    """Return noise transfer and wave numbers of the texture, shape (y / 4, x / 4), of an image (channel, y, x)."""
    from scenetruth.estimators.structure_tensor.registration_kernels import ENERGIES, gradient_energies

    blocks = tuple(-(-size // STRIDE) for size in image.shape[1:])
    total = np.zeros((len(ENERGIES), *blocks), dtype=np.float32)
    filters = [weights.astype(np.float32) for weights in (PAPER.smoothing, PAPER.derivative)]
    for channel in image:
        padded = np.pad(channel, 2 * REACH, mode="edge")
        in_threads(partial(gradient_energies, padded, *filters, STRIDE, total), bands(blocks[0]))
    # Blocks whose filters touch an invalid pixel.
    total[:, np.isnan(total).any(axis=0)] = 0.0
    taps = 2 * int(np.ceil(settings.window_taps_px / (2 * STRIDE))) + 1
    window = gaussian_window(max(settings.window_sigma_px / STRIDE, 0.3), taps).astype(np.float32)
    in_threads(lambda index: _windowed(total[index], window), list(range(len(total))))
    energies = dict(zip(ENERGIES, total, strict=True))
    # Squares of values near the limit of the type are infinite: such images have no standard deviations.
    with np.errstate(over="ignore", invalid="ignore"):
        return _ratios(energies, settings)


def _windowed(energy: NDArray[np.float32], window: NDArray[np.float32]) -> None:
    for axis in (0, 1):
        correlate1d(energy, window, axis=axis, mode="nearest", output=energy)


def _ratios(energies: dict[str, NDArray[np.float32]], settings: StructureTensorSettings) -> Texture:
    tiny = np.float32(1e-20)
    wide_x = energies["dx"] / (energies["sx"] + tiny)
    wide_y = energies["dy"] / (energies["sy"] + tiny)
    # The window is finite: noise passes in a band around the wave number of the texture.
    plain, tilted = _band_factors(settings.window_sigma_px, settings.window_taps_px)
    k_x, k_y = np.sqrt(wide_x), np.sqrt(wide_y)
    wider = np.interp(k_x, _PHASES, plain) * np.interp(k_y, _PHASES, plain)
    coordinates = np.interp(k_x, _PHASES, tilted / plain) + np.interp(k_y, _PHASES, tilted / plain)
    return Texture(
        passed_x=(energies["sx"] / (energies["x"] + tiny) * wider).astype(np.float32),
        passed_xy=((energies["sx"] + energies["sy"]) / (energies["x"] + energies["y"] + tiny) * wider).astype(
            np.float32
        ),
        wave_number_x2=wide_x.astype(np.float32),
        wave_number_y2=wide_y.astype(np.float32),
        widened=(coordinates / 2).astype(np.float32),
    )


@lru_cache(maxsize=8)
def _band_factors(window_sigma_px: float, window_taps_px: int) -> tuple[Array, Array]:
    """Return the mean of Ŝ² in the band of the window over Ŝ² at its centre, also for the window times a coordinate."""
    window = gaussian_window(window_sigma_px, window_taps_px)
    local = window * (np.arange(len(window)) - len(window) // 2)
    weights = np.broadcast_to(PAPER.smoothing, (len(_PHASES), len(PAPER.smoothing)))
    middle = np.abs(PAPER.transfer(_PHASES)[1]) ** 2
    plain, tilted = (
        np.minimum(_spread(weights, part) / (_power(part) * middle), 10.0)
        for part in (window, local if np.any(local) else window)
    )
    return plain, tilted
