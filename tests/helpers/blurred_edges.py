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

    The edge is blurred by a Gaussian, so that Gauss's rule of order 14 is exact to 1e-9. Beyond six standard deviations
    from a pixel, the blur changes its mean by less than 1e-9.
    """
    nodes, weights = np.polynomial.legendre.leggauss(14)
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    d = normal[0] * x + normal[1] * y - distance_px
    mean, slope = (d > 0).astype(np.float64), np.zeros((size, size))
    near = np.abs(d) < np.sqrt(0.5) + 6 * sigma_px
    places = normal[0] * nodes[:, None] / 2 + normal[1] * nodes / 2
    shares = (weights[:, None] * weights / 4).ravel()
    steps = (d[near][:, None] + places.ravel()) / sigma_px
    mean[near] = ndtr(steps) @ shares
    slope[near] = np.exp(-(steps**2) / 2) @ -shares / (np.sqrt(2 * np.pi) * sigma_px)
    return mean, slope


def edge_displacement(
    image: Array, normal: Array, distance_px: float, sigma_px: float, radius_px: float = np.inf
) -> float:
    """Return the displacement in px along the normal that explains the error of an image best, within a radius."""
    return displacement_from(image, *blurred_edge(normal, distance_px, sigma_px, len(image)), radius_px)


def displacement_from(image: Array, mean: Array, slope: Array, radius_px: float = np.inf) -> float:
    """Return the displacement in px that explains best how an image differs from that of a given edge."""
    y, x = np.mgrid[: len(image), : len(image)] - (len(image) - 1) / 2
    slope = np.where(np.hypot(x, y) < radius_px, slope, 0.0)
    return float(((image - mean) * slope).sum() / (slope**2).sum())
