"""Images of textured and bare boards that face a row of cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["BOARDS_SIZE", "GREY_NOISE", "Patch", "draw_patches"]

Map = NDArray[np.float64]

BOARDS_SIZE = (90, 140)
GREY_NOISE = 1.0
_FINE = 8  # samples of a pixel along x


@dataclass(frozen=True)
class Patch:
    """A board that faces the cameras: disparity, columns and rows in the reference, and grey value; NaN is textured."""

    disparity: float
    columns: tuple[float, float]
    rows: tuple[int, int]
    grey: float


def draw_patches(patches: list[Patch], s: float, seed: int) -> tuple[Map, Map]:
    """Return the image of a camera with noise, and the disparity of what it shows; patches from far to near."""
    height, width = BOARDS_SIZE
    generator = np.random.default_rng(3)
    texture = ndimage.gaussian_filter(generator.normal(size=(height, 6 * width)), (1.5, 3.0))
    texture *= 25.0 / texture.std()
    x = (np.arange(width * _FINE) + 0.5) / _FINE - 0.5
    y = np.arange(height)
    image, shown = np.zeros((height, len(x))), np.zeros((height, len(x)))
    for n, patch in enumerate(patches):
        place = x + patch.disparity * s
        inside = (place >= patch.columns[0]) & (place < patch.columns[1])
        where = inside[None] & ((y >= patch.rows[0]) & (y < patch.rows[1]))[:, None]
        columns = 2.0 * place + 2 * width + 17 * n
        sampled = np.stack([np.interp(columns, np.arange(6 * width), row) for row in texture])
        value = 120.0 + sampled if np.isnan(patch.grey) else np.full_like(image, patch.grey)
        image, shown = np.where(where, value, image), np.where(where, patch.disparity, shown)
    image = image.reshape(height, width, _FINE).mean(axis=2)
    noise = np.random.default_rng(seed).normal(0, GREY_NOISE, BOARDS_SIZE)
    return image + noise, shown[:, _FINE // 2 :: _FINE]
