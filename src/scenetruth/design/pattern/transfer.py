"""How much contrast lens and pixels leave of the waves of a pattern."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.pattern.rig import Rig

__all__ = ["transfer_of"]

Array = NDArray[np.float64]


def transfer_of(rig: Rig, along_x: Array, along_y: Array) -> Array:
    """Return the modulation transfer of a rig: lens in focus, blur disc out of focus, and the pixel's aperture.

    Parameters
    ----------
    rig
        The rig; it is in focus if it has no ``defocus``.
    along_x, along_y
        Spatial frequencies in periods per px; they are broadcast.

    Returns
    -------
    numpy.ndarray
        Contrast that is left; negative where a blur disc reverses it. A disc of diameter b px leaves 2 J1(π b f) / (π b
        f), a square pixel sin(π f) / (π f) along each axis.
    """
    from scipy.special import j1

    radial = np.hypot(along_x, along_y)
    left = np.sinc(along_x) * np.sinc(along_y)
    if rig.psf is not None:
        left = left * rig.psf.transfer(radial)
    if rig.defocus is not None:
        blur = float(rig.defocus.blur_diameter_px(np.array(rig.distance_mm), rig.focal_length_px))
        angle = np.pi * blur * radial
        left = left * np.where(angle > 1e-6, 2 * j1(angle) / np.maximum(angle, 1e-6), 1.0)
    return np.asarray(left)
