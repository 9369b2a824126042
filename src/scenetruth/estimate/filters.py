"""The paper's separable filters and window (section 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["DERIVATIVE", "DERIVATIVE_MOMENT", "SMOOTHING", "gaussian_window", "transfer"]

DERIVATIVE = np.array([0.0838, 0.3324, 0.0, -0.3324, -0.0838])
"""D, the derivative as a convolution kernel."""

DERIVATIVE_MOMENT = -np.arange(-2, 3) * DERIVATIVE
"""M with M_m = -m D_m: D * (x g) = x (D * g) + M * g, what filtering x g adds to x times the filtered g."""

SMOOTHING = np.array([0.0234, 0.2416, 0.4700, 0.2416, 0.0234])
"""S, the smoothing in every direction in which the derivative is not taken."""


def gaussian_window(sigma: float, taps: int) -> NDArray[np.float64]:
    """Return a Gaussian sampled at ``taps`` (odd) points around its centre, with the sum 1."""
    offsets = np.arange(taps) - taps // 2
    weights = np.exp(-(offsets**2) / (2 * sigma**2))
    return np.asarray(weights / weights.sum())


def transfer(wave_number: float | NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the transfer functions (D̂, Ŝ) of the two filters at a wave number in radian per sample.

    The derivative filter multiplies exp(i w n) by i D̂(w), D̂(w) = 2 Σ d_j sin jw; the smoothing filter multiplies it by
    Ŝ(w) = s_0 + 2 Σ s_j cos jw. A pattern cos(k x) that moves by u per step is estimated to move by
    D̂(k u) Ŝ(k) / (D̂(k) Ŝ(k u)).
    """
    w = np.asarray(wave_number, dtype=np.float64)
    outward = DERIVATIVE[:2][::-1]
    derivative = sum(2 * weight * np.sin((j + 1) * w) for j, weight in enumerate(outward))
    smoothing = SMOOTHING[2] + sum(2 * weight * np.cos((j + 1) * w) for j, weight in enumerate(SMOOTHING[3:]))
    return np.asarray(derivative), np.asarray(smoothing)
