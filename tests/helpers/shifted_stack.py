"""Stacks of images of a fronto-parallel sheet that moves: every image is displaced as a whole."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import spline_filter

from scenetruth.estimators.refined import ImageStack, initial_parameters

__all__ = ["DISPARITY", "FLOW", "Array", "shifted_parameters", "shifted_stack"]

Array = NDArray[np.float64]
DISPARITY, FLOW = 6.3, (0.6, -0.3)


def shifted_stack(
    texture: Callable[[Array, Array], Array], shape: tuple[int, int] = (72, 96), noise: float = 0.0, cameras: int = 3
) -> ImageStack:
    """Return images of a texture, given by its values at columns and rows, of three frames."""
    positions = np.stack([np.arange(cameras) - cameras // 2, np.zeros(cameras)], axis=-1).astype(np.float64)
    times = np.array([-1.0, 0.0, 1.0])
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    generator = np.random.default_rng(4)
    coefficients = []
    for t in times:
        images = [texture(x + DISPARITY * s - FLOW[0] * t, y - FLOW[1] * t) for s, _ in positions]
        noisy = np.stack(images) + noise * generator.normal(size=(cameras, *shape))
        filtered = [spline_filter(image, 5, mode="mirror") for image in noisy]
        coefficients.append(np.stack(filtered).astype(np.float32)[None])
    centre = ((shape[1] - 1) / 2, (shape[0] - 1) / 2)
    return ImageStack(coefficients, positions, times, 1000.0, centre, np.zeros((3 * cameras, 4)))


def shifted_parameters(shape: tuple[int, int] = (72, 96), flow: tuple[float, float] = FLOW) -> Array:
    """Return the parameters of the fits around all pixels."""
    start = np.zeros((4, *shape))
    start[0] = DISPARITY
    start[1:3] = np.reshape(flow, (2, 1, 1)) / DISPARITY
    return initial_parameters(start, accelerated=False)
