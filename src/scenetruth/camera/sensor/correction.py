"""Two-point correction of a sensor's fixed pattern, as a laboratory does it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["two_point_correction"]


def two_point_correction(images: ArrayLike, dark: ArrayLike, flat: ArrayLike) -> NDArray[np.float32]:
    """Take the fixed pattern out of images, with a dark and a flat-field image of the same sensor.

    (image - dark) / (flat - dark), times the mean of (flat - dark): every pixel then has the mean response and no
    offset.

    Parameters
    ----------
    images
        Digital numbers, shape (..., y, x).
    dark, flat
        Means of many images without light and of a uniformly bright surface, shape (y, x), below saturation.

    Returns
    -------
    numpy.ndarray
        float32, the shape of ``images``; NaN where the flat field is not brighter than the dark one.

    Raises
    ------
    ValueError
        If the shapes do not match, or no pixel is brighter in the flat field.

    See Also
    --------
    scenetruth.simulate : Images of a sensor with a fixed pattern (``dsnu_e``, ``prnu``).

    References
    ----------
    EMVA Standard 1288, Standard for Characterization of Image Sensors and Cameras: the nonuniformities of dark signal
    and photo response (DSNU, PRNU) are what is taken out.

    Examples
    --------
    The second pixel is twice as sensitive as the first and has an offset of 10:

    >>> two_point_correction([[[5.0, 20.0]], [[10.0, 30.0]]], dark=[[0.0, 10.0]], flat=[[20.0, 50.0]]).tolist()
    [[[7.5, 7.5]], [[15.0, 15.0]]]
    """
    values = np.asarray(images)
    low, high = np.asarray(dark, dtype=np.float64), np.asarray(flat, dtype=np.float64)
    if not low.shape == high.shape == values.shape[-2:]:
        msg = f"dark and flat must have the shape (y, x) of the images, {values.shape[-2:]}: {low.shape}, {high.shape}"
        raise ValueError(msg)
    span = np.where(high > low, high - low, np.nan)
    if np.isnan(span).all():
        msg = "flat must be brighter than dark: no pixel responds to light"
        raise ValueError(msg)
    return np.asarray((values - low) / span * np.nanmean(span), dtype=np.float32)
