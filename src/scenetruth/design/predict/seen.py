"""What images show of a scene's points: the waves of their texture in pixels and grey values, and the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.predict.grey import grey_of
from scenetruth.design.predict.look import Look
from scenetruth.design.predict.textures.base import Waves, spectra
from scenetruth.design.predict.textures.measured import measured_waves
from scenetruth.design.predict.transfer import blur_px, derivative_response, transfer_of
from scenetruth.resources import Part
from scenetruth.scene import Scene
from scenetruth.scene.texture import TextureModel

__all__ = ["Seen", "seen_of"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Seen:
    """The texture of points as images have it, and the noise of the images there; grey values count in full scales.

    Parameters
    ----------
    frequency
        Waves in periods per px along x and y, shape (n, w, 2).
    variance
        Variance of the grey value by each of them, shape (n, w).
    surface_variance
        The same without lens, pixels and motion.
    response
        What a derivative along x and along y makes of each wave, in radian per px, shape (n, w, 2).
    level, white, noise, pattern
        Mean grey value, that of a texture of 1 in the same light, and standard deviations of the noise that is new in
        every image and of the one that stays, shape (n,).
    blur_px
        How far points move while an image is taken, shape (n,).
    """

    frequency: Array
    variance: Array
    surface_variance: Array
    response: Array
    level: Array
    white: Array
    noise: Array
    pattern: Array
    blur_px: Array


def seen_of(scene: Scene, look: Look, parts: Sequence[Part], folder: Path = Path(), *, painting: bool = True) -> Seen:
    """Return what images show of points.

    Parameters
    ----------
    scene, look
        The scene, and the points.
    parts
        Its objects.
    folder
        Where relative paths in it count from.
    painting
        Whether textures whose waves have no exact formula are painted and measured; else what is known of them counts.

    Raises
    ------
    SceneError
        If a texture that has no formula cannot be painted.
    """
    items = {part.item.name: part.item for part in parts}
    present = np.unique(look.body)
    waves: dict[int, Waves] = {}
    for number in present.tolist():
        item = items[look.names[number]]
        known = spectra().get(item.texture.kind)
        if known is not None and (known.exact or not painting):
            waves[number] = _by_formula(item.texture)
        else:
            waves[number] = measured_waves(item, scene.seed, folder)
    most = max((len(one.variances) for one in waves.values()), default=0)
    frequency, variance = np.zeros((len(look), most, 2)), np.zeros((len(look), most))
    mean = np.zeros(len(look))
    for number, one in waves.items():
        at, count = look.body == number, len(one.variances)
        frequency[at, :count] = np.einsum("wc,pck->pwk", one.frequencies_per_mm, look.chart[at])
        variance[at, :count] = one.variances
        mean[at] = one.mean
    light = look.light * _vignetting(scene, look)
    grey = grey_of(scene.sensor, mean * light)
    variance *= ((grey.gain * light) ** 2)[:, None]
    moved = blur_px(scene, look.depth_mm, flow_of(look))
    passed = transfer_of(frequency, scene, look.depth_mm, moved)
    return Seen(
        frequency=frequency,
        variance=variance * passed**2,
        surface_variance=variance,
        response=derivative_response(frequency),
        level=grey.level,
        white=grey_of(scene.sensor, light).level,
        noise=grey.noise,
        pattern=grey.pattern,
        blur_px=np.hypot(*moved.T),
    )


def flow_of(look: Look) -> Array:
    """Return the optical flow of points in px per frame, shape (n, 2)."""
    points = look.points
    places = (points.x, points.y)
    return np.column_stack([points.d * (points.q[k] - places[k] / points.focal * points.q[2]) for k in range(2)])


@lru_cache(maxsize=1024)
def _by_formula(texture: TextureModel) -> Waves:
    return spectra()[texture.kind].waves(texture)


def _vignetting(scene: Scene, look: Look) -> Array:
    vignetting = scene.optics.vignetting
    if vignetting is None:
        return np.ones(len(look))
    c_x, c_y = scene.camera.principal_point
    factor = vignetting.factor(scene.camera.without_distortion())
    column = np.clip(np.rint(look.points.x + c_x), 0, scene.camera.width - 1).astype(np.int64)
    row = np.clip(np.rint(look.points.y + c_y), 0, scene.camera.height - 1).astype(np.int64)
    return np.asarray(factor[row, column])
