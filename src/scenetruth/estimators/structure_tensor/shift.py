"""Shifting images by a fraction of a pixel, where positions of the stage need more than whole pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d, spline_filter1d

from scenetruth.estimators.structure_tensor.task import Task, columns_of_s

__all__ = ["registered"]


def registered(task: Task, disparity: int) -> NDArray[Any]:
    """Shift images by the fraction of a pixel that registration by whole columns leaves.

    Quintic splines interpolate the images. Cameras at whole steps of s need no shift.

    Parameters
    ----------
    task
        The images and the rig.
    disparity
        Disparity of the working point in px per step of s.

    Returns
    -------
    numpy.ndarray
        Images, shape (channel, s, t, y, x): as recorded if no camera needs a shift, else float32.
    """
    part = -disparity * task.rig.positions - columns_of_s(task.rig, disparity)
    if np.all(np.abs(part) < 1e-9):
        return task.images
    images = task.images.astype(np.float32)
    for s in np.flatnonzero(np.abs(part) >= 1e-9):
        spline = spline_filter1d(images[:, s].astype(np.float64), order=5, axis=-1, mode="mirror")
        images[:, s] = correlate1d(spline, _quintic(part[s]), axis=-1, mode="mirror")
    return images


def _quintic(part: float) -> NDArray[np.float64]:
    """Return the weights of the quintic B-spline's coefficients at ``part`` of a pixel to the right of a sample."""
    distance = np.abs(np.arange(-3, 4) - part)
    edges = np.maximum(np.array([3.0, 2.0, 1.0]) - distance[:, None], 0.0) ** 5
    return np.asarray(edges @ np.array([1.0, -6.0, 15.0]) / 120)
