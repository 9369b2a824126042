"""Images, a view of them, and their warp by the kernel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from scenetruth.estimators.refined import NO_DEFECTS, NO_OCCLUSION
from scenetruth.estimators.refined.kernels import warp

__all__ = ["COUNT", "HEIGHT", "VIEW", "WIDTH", "Array", "Warped", "warped_by"]

Array = NDArray[np.float64]
Warped = tuple[NDArray[np.float32], NDArray[np.float32]]
HEIGHT, WIDTH, COUNT = 40, 56, 9
VIEW = warp.ImageView(
    np.tile([-1.0, 0.0, 1.0], 3),
    np.array([0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, -0.5]),
    np.repeat([0.0, 1.0, -1.0], 3),
    np.zeros((9, 4)),
    200.0,
    26.5,
    18.0,
)


def warped_by(images: Array, fields: Array, order: int = 5) -> Warped:
    coefficients = np.array([ndimage.spline_filter(image, order, mode="mirror") for image in images], dtype=np.float32)
    values = np.empty((COUNT, HEIGHT, WIDTH), dtype=np.float32)
    gradient = np.empty((2, HEIGHT, WIDTH), dtype=np.float32)
    view = VIEW._replace(spline=order)
    warp.warp_rows(coefficients, view, fields, NO_OCCLUSION, NO_DEFECTS, 0, values, gradient, (0, HEIGHT))
    return values, gradient
