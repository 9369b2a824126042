"""The contrast of the texture around every pixel."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["local_contrast", "reference_images"]

Map = NDArray[np.float64]


def local_contrast(image: Map, window_px: float) -> Map:
    """Return the rms contrast: the standard deviation of the grey values in a Gaussian window around every pixel.

    Noise of the images is part of it, and adds its variance. Images end at their border; the window is reflected there.

    Parameters
    ----------
    image
        Grey values, shape (..., y, x); the images are independent.
    window_px
        Standard deviation of the window, in px.

    Returns
    -------
    numpy.ndarray
        In the units of the grey values, same shape.
    """
    # Without the mean, the difference of squares keeps its digits.
    centred = image - image.mean(axis=(-2, -1), keepdims=True)
    sigma = (*(0.0,) * (image.ndim - 2), window_px, window_px)
    mean = ndimage.gaussian_filter(centred, sigma)
    variance = ndimage.gaussian_filter(centred**2, sigma) - mean**2
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def reference_images(recording: xr.Dataset, frames: NDArray[np.integer]) -> Map:
    """Return the reference camera's images at some frames, as fractions of full scale; of colours the mean.

    Returns
    -------
    numpy.ndarray
        float64, shape (t, y, x).
    """
    image = recording["image"].sel({dim: 0 for dim in ("s_y", "s") if dim in recording["image"].dims} | {"t": frames})
    values = image.values.astype(np.float64) / float(recording.attrs["full_scale"])
    return np.asarray(values.mean(axis=-1) if "channel" in image.dims else values)
