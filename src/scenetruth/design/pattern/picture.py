"""Photographs of patterns, as linear grey values without uneven light."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.pattern.errors import PatternError
from scenetruth.errors import Problem, SceneError
from scenetruth.scene.texture.image import header_of, luminance

__all__ = ["grey_values", "without_shading"]

Array = NDArray[np.float64]

_MOST_SIDE = 2048


def grey_values(picture: str | Path | NDArray[Any], encoding: str) -> Array:
    """Return the linear grey values of a photograph, from 0 to 1; of a large one, its middle.

    Parameters
    ----------
    picture
        An image file, or an array of grey values (y, x) or colours (y, x, channel): integers up to the largest of their
        type, or floats in [0, 1].
    encoding
        ``"linear"``: proportional to light; ``"srgb"``: as cameras write JPEG files.

    Raises
    ------
    PatternError
        If it is no such image.
    """
    if encoding not in ("linear", "srgb"):
        raise PatternError([Problem("encoding", "must be linear or srgb", encoding)])
    image = _read(Path(picture)) if isinstance(picture, str | Path) else np.asarray(picture)
    told = str(picture) if isinstance(picture, str | Path) else f"shape {image.shape}, {image.dtype}"
    if image.ndim not in (2, 3) or 0 in image.shape or (image.ndim == 3 and image.shape[2] > 4):
        raise PatternError([Problem("picture", "must be one picture in grey or in colours", told)])
    if image.dtype.kind not in "uifb" or not np.isfinite(image).all():
        raise PatternError([Problem("picture", "must hold numbers, all of them finite", told)])
    slices = tuple(slice(max((side - _MOST_SIDE) // 2, 0), None) for side in image.shape[:2])
    image = image[slices][:_MOST_SIDE, :_MOST_SIDE]
    return luminance(image, encoding).astype(np.float64)


def without_shading(grey: Array) -> Array:
    """Return a picture without uneven light: divided by the quadratic surface through it, its mean kept."""
    rows, columns = grey.shape
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j]
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).reshape(-1, 6)
    fitted = terms @ np.linalg.lstsq(terms, grey.ravel(), rcond=None)[0]
    mean = float(grey.mean())
    surface = np.maximum(fitted.reshape(grey.shape), 0.05 * mean)
    return np.asarray(grey / surface * mean) if mean > 0 else grey


def _read(file: Path) -> NDArray[Any]:
    import imageio.v3 as imageio

    try:
        header_of(file)
    except SceneError as error:
        raise PatternError([Problem("picture", problem.message, str(file)) for problem in error.problems]) from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = np.asarray(imageio.imread(file.read_bytes(), extension=file.suffix))
    except Exception as error:  # the readers of imageio's plugins raise whatever they like
        told = " ".join(str(error).split())[:200] or type(error).__name__
        raise PatternError([Problem("picture", f"cannot be read as an image: {told}", str(file))]) from error
    return image[0] if image.ndim > 2 and image.shape[0] == 1 else image
