"""Images of a straight, blurred edge by numerical integration, and the displacement of an edge in another image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

Array = NDArray[np.float64]


def edge_normal(angle_deg: float) -> Array:
    """Return the normal of an edge, from black to white."""
    return np.array([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))])


def blurred_edge(normal: Array, distance_px: float, sigma_px: float, size: int) -> tuple[Array, Array]:
    """Return the means over pixels of an edge at a distance from the image centre, and their derivative by it.

    The edge is blurred by a Gaussian, so that Gauss's rule of order 14 is exact to 1e-9.
    """
    nodes, weights = np.polynomial.legendre.leggauss(14)
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    mean, slope = np.zeros((size, size)), np.zeros((size, size))
    for a, w_a in zip(nodes / 2, weights / 2, strict=True):
        for b, w_b in zip(nodes / 2, weights / 2, strict=True):
            d = (normal[0] * (x + a) + normal[1] * (y + b) - distance_px) / sigma_px
            mean += w_a * w_b * ndtr(d)
            slope -= w_a * w_b * np.exp(-(d**2) / 2) / np.sqrt(2 * np.pi) / sigma_px
    return mean, slope


def edge_displacement(
    image: Array, normal: Array, distance_px: float, sigma_px: float, radius_px: float = np.inf
) -> float:
    """Return the displacement in px along the normal that explains the error of an image best, within a radius."""
    mean, slope = blurred_edge(normal, distance_px, sigma_px, len(image))
    y, x = np.mgrid[: len(image), : len(image)] - (len(image) - 1) / 2
    slope = np.where(np.hypot(x, y) < radius_px, slope, 0.0)
    return float(((image - mean) * slope).sum() / (slope**2).sum())
