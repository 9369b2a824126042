"""Bias of displacements between demosaiced images, predicted from the transfer functions of the demosaicing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenetruth.camera.sensor.demosaicing import DemosaicingMethod, demosaicing_taps

__all__ = ["DemosaicedWave", "demosaic_wave", "exact_response", "predict_displacement", "quintic_spline_response"]

Complex = NDArray[np.complex128]
Floats = NDArray[np.float64]

Response = Callable[[Floats, float], Complex]
"""Response of a registration to waves, such as exp(i k_x u): a function of wave vectors (x, y) in rad/px, shape (n, 2),
and of the displacement u along x in px, which returns n factors.
"""

_CARRIERS = ((0, 0), (0, 1), (1, 0), (1, 1))
_SECTIONS = 60
_SMALL_PX = 1e-4
_SEARCH_PX = 0.5
_SEARCH_STEPS = 101


def exact_response(wave_vectors: Floats, displacement_px: float) -> Complex:
    """Return the response of exact interpolation, exp(i k_x u)."""
    return np.asarray(np.exp(1j * wave_vectors[:, 0] * displacement_px))


@dataclass(frozen=True, eq=False)
class DemosaicedWave:
    """A wave behind colour filters after demosaicing: the wave itself, and its aliases.

    Attributes
    ----------
    wave_vector
        Wave vector (x, y) of the texture in rad/px.
    wave_vectors
        Those of the wave and of its three aliases, in [-π, π), shape (4, 2).
    amplitudes
        Complex amplitudes of red, green and blue for each of them, shape (4, 3).

    See Also
    --------
    demosaic_wave : Computes it.

    Examples
    --------
    >>> wave = demosaic_wave((2 * np.pi / 8, 0.0), [1, 1, 1], "RGGB", "bilinear")
    >>> np.abs(wave.amplitudes[:2]).round(3)
    array([[0.854, 0.927, 0.854],
           [0.146, 0.   , 0.146]])
    """

    wave_vector: tuple[float, float]
    wave_vectors: Floats
    amplitudes: Complex


def demosaic_wave(
    wave_vector: tuple[float, float], colour: ArrayLike, pattern: str, method: DemosaicingMethod
) -> DemosaicedWave:
    """Demosaic a wave in closed form.

    The response of the demosaicing repeats every two pixels. A wave with the wave vector k therefore becomes four waves
    with the wave vectors k, k + (π, 0), k + (0, π) and k + (π, π).

    Parameters
    ----------
    wave_vector
        Wave vector k = (k_x, k_y) in rad/px.
    colour
        Complex amplitudes a of the wave in red, green and blue: the texture is Re a exp(i k x).
    pattern
        Colours of the 2 x 2 pixels in row-major order from the upper left: RGGB, GRBG, GBRG or BGGR.
    method
        ``"bilinear"``, ``"malvar"`` or ``"binomial"``.

    Returns
    -------
    DemosaicedWave
        The four waves, the texture's first.

    Raises
    ------
    ValueError
        If the pattern or the method is not one of these.

    See Also
    --------
    predict_displacement : Bias of a registration of such images.

    Examples
    --------
    Red behind a bilinear demosaicing, along a wave of 8 px: the mean of 1 and of its interpolation, cos(π/4), and half
    the difference as an alias:

    >>> wave = demosaic_wave((2 * np.pi / 8, 0.0), [1, 1, 1], "RGGB", "bilinear")
    >>> np.abs(wave.amplitudes[:, 0]).round(4)
    array([0.8536, 0.1464, 0.    , 0.    ])
    """
    taps = demosaicing_taps(pattern, method)
    k = np.asarray(wave_vector, dtype=np.float64)
    given = np.asarray(colour, dtype=np.complex128)
    of_phase = np.zeros((2, 2, 3), dtype=np.complex128)
    for (y, x, result), weights in taps.items():
        for (dy, dx, source), weight in weights.items():
            of_phase[y, x, result] += weight * given[source] * np.exp(1j * (k[0] * dx + k[1] * dy))
    amplitudes = np.zeros((4, 3), dtype=np.complex128)
    for n, (q, p) in enumerate(_CARRIERS):
        for y, x in np.ndindex(2, 2):
            amplitudes[n] += of_phase[y, x] * (-1.0) ** (p * x + q * y) / 4
    moved = k + np.pi * np.array([(p, q) for q, p in _CARRIERS])
    wrapped = (moved + np.pi) % (2 * np.pi) - np.pi
    return DemosaicedWave((float(k[0]), float(k[1])), wrapped, amplitudes)


def predict_displacement(
    waves: Sequence[DemosaicedWave],
    displacement_px: float,
    positions: Sequence[float] = (0.0, 1.0),
    *,
    weights: ArrayLike = (1.0, 1.0, 1.0),
    grey: bool = False,
    response: Response = exact_response,
    gradient: Literal["own", "mean"] = "own",
) -> float:
    """Predict the displacement that a least-squares registration of demosaiced images finds along x.

    If a texture moves by ``displacement_px`` per step, the phases of a wave and of its aliases change by one angle. An
    alias has another wave number, and would move by another distance: a registration finds a compromise, weighted by
    power. The prediction is that of a window of many periods, in which the products of different waves cancel.

    Parameters
    ----------
    waves
        The demosaiced waves of a texture.
    displacement_px
        Displacement along x per step, in px.
    positions
        Positions of the images in steps; an image is displaced by its position times the displacement.
    weights
        Weights of the squared differences in red, green and blue.
    grey
        Whether the images are converted to grey values before, as means with these weights.
    response
        Response of the interpolation and of filters to waves, as a function of wave vectors (x, y) in rad/px, shape
        (n, 2), and displacement in px; default: exact interpolation without filters.
    gradient
        ``"own"``: the squared differences to the mean image are minimised. ``"mean"``: the differences are orthogonal
        to the gradient of the mean image times the position, as after Gauss-Newton steps with a common gradient
        (method ``refined``). Aliases partly cancel in the mean image, and with them the bias.

    Returns
    -------
    float
        Displacement per step in px, within 0.5 px of ``displacement_px``. The bias is the difference.

    See Also
    --------
    demosaic_wave : Computes the wave.

    Notes
    -----
    For exact interpolation, two images, a displacement d and a small bias b, with the power P and wave number κ of
    waves and aliases, and the wave number k of the texture: b = Σ P κ sin((k - κ) d) / Σ P κ² cos((k - κ) d). The bias
    repeats with every 2 px.

    Examples
    --------
    A grey wave of 4.5 px that moves by 0.5 px:

    >>> wave = demosaic_wave((2 * np.pi / 4.5, 0.0), [1, 1, 1], "RGGB", "bilinear")
    >>> round(predict_displacement([wave], 0.5), 4)
    0.2575
    """
    share = np.asarray(weights, dtype=np.float64)
    amplitudes = np.concatenate([wave.amplitudes for wave in waves])
    power = np.abs(amplitudes @ share / share.sum()) ** 2 if grey else np.abs(amplitudes) ** 2 @ share
    vectors = np.concatenate([wave.wave_vectors for wave in waves])
    own = np.repeat([wave.wave_vector[0] for wave in waves], len(_CARRIERS))
    at = np.asarray(positions, dtype=np.float64)
    turned = np.exp(-1j * displacement_px * np.outer(own, at))

    def images(found: float, offset: float = 0.0) -> Complex:
        return np.stack([response(vectors, float(found * place + offset)) for place in at], axis=1) * turned

    def mismatch(found: float) -> float:
        """Return the mean square difference to the mean image."""
        registered = images(found)
        return float(power @ np.mean(np.abs(registered - registered.mean(axis=1, keepdims=True)) ** 2, axis=1))

    def step(found: float) -> float:
        """Return the product of the differences and the gradient of the mean image."""
        slope = (images(found, _SMALL_PX) - images(found, -_SMALL_PX)).mean(axis=1)
        registered = images(found)
        left = (registered - registered.mean(axis=1, keepdims=True)) @ at
        return float(power @ (np.conj(slope) * left).real)

    if gradient == "own":
        return _minimum(mismatch, displacement_px)
    low, high = displacement_px - _SEARCH_PX, displacement_px + _SEARCH_PX
    for _ in range(_SECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if step(middle) < 0 else (low, middle)
    return float((low + high) / 2)


def quintic_spline_response(wave_vectors: Floats, displacement_px: float) -> Complex:
    """Return the response of the interpolation by quintic splines, of the method ``refined``, to waves.

    Parameters
    ----------
    wave_vectors
        Wave vectors (x, y) in rad/px, shape (n, 2).
    displacement_px
        Displacement along x in px.

    Returns
    -------
    NDArray
        Complex factors, shape (n,).

    See Also
    --------
    predict_displacement : Takes it as ``response``.

    Examples
    --------
    Between pixels, short waves are attenuated:

    >>> waves = 2 * np.pi / np.array([[16.0, np.inf], [2.5, np.inf]])
    >>> np.abs(quintic_spline_response(waves, 0.5)).round(3)
    array([1.   , 0.838])
    """
    k, whole = wave_vectors[:, 0], np.floor(displacement_px)
    taps = np.arange(-3, 5)
    weights = _quintic_spline(displacement_px - whole - taps)
    values = _quintic_spline(np.arange(3.0))
    prefilter = values[0] + 2 * values[1] * np.cos(k) + 2 * values[2] * np.cos(2 * k)
    return np.asarray(np.exp(1j * k * whole) * (np.exp(1j * np.outer(k, taps)) @ weights) / prefilter)


def _quintic_spline(at: Floats) -> Floats:
    """Return the quintic B-spline."""
    edges = np.maximum(np.array([3.0, 2.0, 1.0]) - np.abs(at)[:, None], 0.0) ** 5
    return np.asarray(edges @ np.array([1.0, -6.0, 15.0]) / 120)


def _minimum(function: Callable[[float], float], start: float) -> float:
    """Return the minimum of a function near a start, by golden sections after a search."""
    places = start + np.linspace(-_SEARCH_PX, _SEARCH_PX, _SEARCH_STEPS)
    best = int(np.argmin([function(float(place)) for place in places]))
    low, high = float(places[max(best - 1, 0)]), float(places[min(best + 1, len(places) - 1)])
    ratio = (5.0**0.5 - 1) / 2
    for _ in range(_SECTIONS):
        one, other = high - ratio * (high - low), low + ratio * (high - low)
        if function(one) < function(other):
            high = other
        else:
            low = one
    return float((low + high) / 2)
