"""The waves of textures that have no formula: painted once, and measured."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.predict.textures.base import Waves
from scenetruth.randomness import generator_for
from scenetruth.scene.item import SceneObject

__all__ = ["measured_waves"]

Array = NDArray[np.float64]

# Of a larger raster, the middle is measured.
_MOST_TEXELS = 1024
_RADII, _ANGLES = 24, 8
# Of the lengths of edges: a chart that fits the raster worse is not flat on it.
_MOST_BENT = 0.1


def measured_waves(item: SceneObject, seed: int, folder: Path) -> Waves:
    """Paint the texture of an object and measure its waves.

    Parameters
    ----------
    item
        The object.
    seed
        Of the scene.
    folder
        Where relative paths count from.

    Returns
    -------
    Waves
        Its spectrum in bins: each stands at the root mean square of its frequencies.

    Raises
    ------
    SceneError
        If the texture cannot be painted.
    """
    return _measured(_Key(item, seed, folder))


class _Key:
    """An object as far as its texture depends on it."""

    def __init__(self, item: SceneObject, seed: int, folder: Path) -> None:
        self.item, self.seed, self.folder = item, seed, folder
        parts = [item.mesh.model_dump(mode="json"), item.texture.model_dump(mode="json")]
        self._text = json.dumps([*parts, item.name, seed, str(folder)])

    def __hash__(self) -> int:
        return hash(self._text)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self._text == other._text


@lru_cache(maxsize=256)
def _measured(key: _Key) -> Waves:
    mesh = key.item.mesh.make(key.folder)
    painted = key.item.texture.paint(mesh, key.folder, generator_for(key.seed, "texture", key.item.name))
    raster = np.asarray(painted.texture.raster(), dtype=np.float64)
    rows, columns = raster.shape
    per_mm = _tiles_per_mm(mesh.chart_mm, painted.uv)
    part = raster[_middle(painted.uv[..., 1], rows), _middle(painted.uv[..., 0], columns)]
    mean = float(part.mean())
    window = np.outer(np.hanning(part.shape[0] + 2)[1:-1], np.hanning(part.shape[1] + 2)[1:-1])
    power = np.abs(np.fft.rfft2((part - mean) * window)) ** 2
    # Each but the first and the last column stands for two waves.
    power[:, 1:] *= 2.0
    power /= window.size * np.square(window).sum()
    across = np.fft.rfftfreq(part.shape[1]) * columns
    down = np.fft.fftfreq(part.shape[0]) * rows
    if painted.texture.cubic:
        # Coefficients of a cubic B-spline are more than its values.
        power *= np.square(np.outer(_spline(down / rows), _spline(across / columns)))
    f_u, f_v = np.meshgrid(across, down)
    return _binned(np.stack([f_u.ravel(), f_v.ravel()], axis=-1) @ per_mm, power.ravel(), mean)


def _middle(places: Array, texels: int) -> slice:
    """Return the middle of what a side of the mesh wears of a raster; the other side may wear another part."""
    low, high = (float(np.clip(end, 0.0, 1.0)) * texels for end in (places.min(), places.max()))
    first, count = round(low), max(round(high) - round(low), 1)
    if np.ptp(places) > 1.0:
        first, count = 0, texels
    first += max(count - _MOST_TEXELS, 0) // 2
    return slice(first, first + min(count, _MOST_TEXELS))


def _spline(frequency: Array) -> Array:
    return (2.0 + np.cos(2 * np.pi * frequency)) / 3.0


def _tiles_per_mm(chart_mm: Array, uv: Array) -> Array:
    """Return the matrix that makes steps in tiles of steps on the surface in mm."""
    steps, tiles = (np.diff(each, axis=1).reshape(-1, 2) for each in (chart_mm, uv))
    matrix = np.linalg.lstsq(steps, tiles, rcond=None)[0].T
    if np.square(tiles - steps @ matrix.T).sum() > _MOST_BENT**2 * np.square(tiles).sum():
        area, flat = (np.abs(np.linalg.det(each.reshape(-1, 2, 2))).sum() for each in (tiles, steps))
        matrix = np.sqrt(area / flat) * np.eye(2)
    return np.asarray(matrix)


def _binned(frequencies: Array, power: Array, mean: float) -> Waves:
    """Gather waves in bins of frequency and direction."""
    frequencies = frequencies * np.where(frequencies[:, 1] < 0, -1.0, 1.0)[:, None]
    size = np.hypot(*frequencies.T)
    kept = size > 0
    frequencies, power, size = frequencies[kept], power[kept], size[kept]
    least, most = size.min(), size.max() * (1 + 1e-9)
    ring = (_RADII * np.log(size / least) / np.log(most / least)).astype(np.int64)
    turn = np.minimum(
        (_ANGLES * np.arctan2(frequencies[:, 1], frequencies[:, 0]) / np.pi).astype(np.int64), _ANGLES - 1
    )
    place = ring * _ANGLES + turn
    total, squares = (np.bincount(place, part, _RADII * _ANGLES) for part in (power, power * size**2))
    used = total > 0
    angle = (np.arange(_RADII * _ANGLES) % _ANGLES + 0.5) * np.pi / _ANGLES
    length = np.sqrt(squares[used] / total[used])
    grid = length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)[used]
    return Waves(grid, np.asarray(total[used], dtype=np.float64), mean)
