"""Imaged texture of surface points, and the Fisher information from its spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.fisher_information import (
    compute_sensitivity,
    compute_window_deviations,
    index_pairs,
    window_weights,
)
from scenetruth.bound.surface_geometry import ImageTimes
from scenetruth.bound.unknowns import WindowUnknowns
from scenetruth.design.prediction.camera_response import (
    compute_blur_px,
    compute_derivative_response,
    compute_grey_levels,
    compute_transfer,
)
from scenetruth.design.prediction.surface_samples import SurfaceSamples
from scenetruth.design.prediction.texture_spectra import SpectralComponents, analytic_spectra, measure_spectrum
from scenetruth.resources import ObjectWorkload
from scenetruth.scene import Scene
from scenetruth.scene.texture import TextureModel
from scenetruth.schema import Intrinsics

__all__ = ["ImagedTexture", "compute_deviations", "compute_imaged_texture", "compute_moments"]


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ImagedTexture:
    """Imaged texture of n points, and the noise of the images; grey values are fractions of full scale."""

    frequency: Array  # of w waves in periods per px along x and y, shape (n, w, 2)
    variance: Array  # of the grey value per wave with blur, shape (n, w)
    surface_variance: Array  # without blur, shape (n, w)
    response: Array  # of the derivatives along x and y to each wave, in radian per px, shape (n, w, 2)
    level: Array  # mean grey value
    white: Array  # grey value of a texture of 1 in the same light
    mean: Array  # mean of the texture
    gain: Array  # derivative of the grey value by the radiance of the surface
    noise: Array  # standard deviation of temporal noise
    pattern: Array  # standard deviation of fixed-pattern noise
    blur_px: Array


def compute_imaged_texture(
    scene: Scene, look: SurfaceSamples, parts: Sequence[ObjectWorkload], folder: Path = Path(), *, painting: bool = True
) -> ImagedTexture:
    """Return the imaged texture of points."""
    items = {part.item.name: part.item for part in parts}
    present = np.unique(look.body)
    waves: dict[int, SpectralComponents] = {}
    for number in present.tolist():
        item = items[look.names[number]]
        known = analytic_spectra().get(item.texture.kind)
        if known is not None and (known.exact or not painting):
            waves[number] = _by_formula(item.texture)
        else:
            waves[number] = measure_spectrum(item, scene.seed, folder)
    most = max((len(one.variances) for one in waves.values()), default=0)
    frequency, variance = np.zeros((len(look), most, 2)), np.zeros((len(look), most))
    mean = np.zeros(len(look))
    for number, one in waves.items():
        at, count = look.body == number, len(one.variances)
        frequency[at, :count] = np.einsum("wc,pck->pwk", one.frequencies_per_mm, look.chart[at])
        variance[at, :count] = one.variances
        mean[at] = one.mean
    passes = _vignetting(scene, look)
    light, gloss = look.light * passes, look.gloss * passes
    grey = compute_grey_levels(scene.sensor, mean * light + gloss)
    variance *= ((grey.gain * light) ** 2)[:, None]
    moved = compute_blur_px(scene, look.depth_mm, compute_flow(look))
    passed = compute_transfer(frequency, scene, look.depth_mm, moved)
    return ImagedTexture(
        frequency=frequency,
        variance=variance * passed**2,
        surface_variance=variance,
        response=compute_derivative_response(frequency),
        level=grey.level,
        white=compute_grey_levels(scene.sensor, light + gloss).level,
        mean=mean,
        gain=grey.gain * passes,
        noise=grey.noise,
        pattern=grey.pattern,
        blur_px=np.hypot(*moved.T),
    )


def compute_flow(look: SurfaceSamples) -> Array:
    """Return the optical flow of points in px per frame, shape (n, 2)."""
    points = look.points
    places = (points.x, points.y)
    return np.column_stack([points.d * (points.q[k] - places[k] / points.focal * points.q[2]) for k in range(2)])


@lru_cache(maxsize=1024)
def _by_formula(texture: TextureModel) -> SpectralComponents:
    return analytic_spectra()[texture.kind].waves(texture)


def _vignetting(scene: Scene, look: SurfaceSamples) -> Array:
    vignetting = scene.optics.vignetting
    if vignetting is None:
        return np.ones(len(look))
    c_x, c_y = scene.camera.principal_point
    factor = vignetting.factor(scene.camera.without_distortion())
    column = np.clip(np.rint(look.points.x + c_x), 0, scene.camera.width - 1).astype(np.int64)
    row = np.clip(np.rint(look.points.y + c_y), 0, scene.camera.height - 1).astype(np.int64)
    return np.asarray(factor[row, column])


Mask = NDArray[np.bool_]
Moments = dict[tuple[int, int], Array]

_ACROSS = 15  # samples along each side of a window; for wider windows, pixels are grouped
# Least fraction of a window on the surface: a strip along an edge does not determine slope or motion.
_LEAST_SHARE = 0.1
_LITTLE_PATTERN = 0.05  # fixed-pattern noise below this fraction of the temporal noise is neglected
_POINTS_AT_ONCE = 16  # their phases stay in the cache
_HIGHEST_POWER = 2  # slopes are linear in the distance, and their products quadratic


def compute_moments(look: SurfaceSamples, sigma_px: float, highest: int) -> tuple[Moments, Moments]:
    """Return sums over windows of the weights, and of their squares, times powers of the distance, on the own segment.

    Returns: The sums by the powers along x and y; NaN where too little of the window is on the segment.
    """
    line = window_weights("gaussian", sigma_px)[0]
    reach = len(line) // 2
    at = np.arange(-reach, reach + 1, dtype=np.float64)
    # In wide windows, groups of pixels are tested at their centre; sums over whole windows remain exact.
    every = -(-len(line) // _ACROSS)
    group = np.rint(at / every).astype(np.int64)
    group -= group[0]
    middles = every * np.unique(np.rint(at / every))
    across, down = (each.ravel() for each in np.meshgrid(middles, middles))
    own = look.own_around(np.stack([across, down], axis=-1))
    powers = [(j, i) for j in range(highest + 1) for i in range(highest + 1 - j)]
    found, known = [], None
    for weights in (line, line**2):
        along = [np.bincount(group, weights * at**j) for j in range(highest + 1)]
        terms = np.stack([np.outer(along[i], along[j]).ravel() for j, i in powers], axis=-1)
        sums = own @ terms
        if known is None:
            known = np.where(sums[:, 0] >= _LEAST_SHARE * terms[:, 0].sum(), 1.0, np.nan)
        found.append(dict(zip(powers, (sums * known[:, None]).T, strict=True)))
    return found[0], found[1]


def factorise_gradients(variance: Array, response: Array) -> Array:
    """Return two gradients for each point whose products have the same sum as the mean products of its texture."""
    xx, xy, yy = ((variance * response[..., k] * response[..., m]).sum(axis=1) for k, m in ((0, 0), (0, 1), (1, 1)))
    first = np.sqrt(np.maximum(xx, 1e-300))
    slant = xy / first
    return np.array([[first, slant], [np.zeros_like(first), np.sqrt(np.maximum(yy - slant**2, 0.0))]])


def compute_deviations(
    look: SurfaceSamples,
    views: ImageTimes,
    shown: Mask,
    seen: ImagedTexture,
    sigma_px: float,
    model: WindowUnknowns,
    intrinsics: Intrinsics,
    *,
    biased: bool = False,
) -> dict[str, Array]:
    """Return the lowest standard deviations of a fit in windows, averaged over textures; see `cramer_rao_bound`.

    ``biased``: Whether to add the bias of isotropic growth.

    Returns: As in `compute_functionals`, each of shape (n,); not finite where undetermined.
    """
    points = look.points
    s, s_y, t = (each[:, None] for each in (views.s, views.s_y, views.t))
    inverse, moves = compute_sensitivity(points, s, s_y, t, shown)
    sides = []
    # For a unit gradient along x, and along y.
    for along, down in ((inverse[0], inverse[2]), (inverse[1], inverse[3])):
        own = [along * moves[0] + down * moves[1]]
        if model.moving:
            own += [along * moves[2], down * moves[2], along * moves[3] + down * moves[4]]
        sides.append(own)
    change = np.array(sides)  # side, field, image, point
    count = np.maximum(shown.sum(axis=0), 1)
    change = np.where(shown, change - change.sum(axis=2, keepdims=True) / count, 0.0)
    a = np.einsum("lsn,sfvn->lfvn", factorise_gradients(seen.variance, seen.response), change)
    products = np.einsum("lkvn,lmvn->kmn", a, a)
    scatter = products.copy()
    if (seen.pattern > _LITTLE_PATTERN * seen.noise).any():
        scatter += (seen.pattern / seen.noise) ** 2 * _pattern_products(look, views, seen, change, sigma_px)
    moments, new = compute_moments(look, sigma_px, _HIGHEST_POWER), seen.noise
    normal, squared = (
        {
            (number, j, i): part[k, m] / new**2 * moment[j, i]
            for (k, m), number in index_pairs(model.fields).items()
            for j in range(model.get_degree(k) + model.get_degree(m) + 1)
            for i in range(model.get_degree(k) + model.get_degree(m) + 1 - j)
        }
        for part, moment in ((products, moments[0]), (scatter, moments[1]))
    )
    disturbed = _highlight_products(look, views, shown, seen, change, sigma_px, model)
    return compute_window_deviations(normal, squared, points, intrinsics, model, biased=biased, disturbed=disturbed)


def _highlight_products(
    look: SurfaceSamples,
    views: ImageTimes,
    shown: Mask,
    seen: ImagedTexture,
    change: Array,
    sigma_px: float,
    model: WindowUnknowns,
) -> Array | None:
    """Return the contribution of highlights to the scatter of fits, see `HighlightWindows.errors`."""
    if look.reflection is None or not look.reflection.glossy[look.body].any():
        return None
    from scenetruth.design.prediction.surface_light import TextureStatistics

    inside = look.own_around(look.reflection.nodes(sigma_px))
    windows = look.reflection.windows((look.points.x, look.points.y), inside, look.body, views, sigma_px)
    texture = TextureStatistics(seen.mean, seen.gain, seen.noise, seen.frequency, seen.variance, seen.response)
    return windows.errors(len(look), shown, texture, change, model)


def _pattern_products(
    look: SurfaceSamples, views: ImageTimes, seen: ImagedTexture, change: Array, sigma_px: float
) -> Array:
    """Return the contribution of fixed-pattern noise to the scatter of fits.

    Images that show the surface displaced by Δ share this noise by the autocorrelation at Δ of the texture gradient and
    of the window. For waves of the texture this gives Σ_waves |Σ_i a_i exp(i k x_i)|². The autocorrelation of the
    window, exp(-Δ² / 4σ²), is that of waves with a scatter of 1 / (√2 σ).
    """
    place = look.points.place(*(each[:, None] for each in (views.s, views.s_y, views.t)))
    # A fixed seed: predictions are deterministic.
    scatter = np.random.default_rng(0).normal(0.0, 1.0 / (np.sqrt(8.0) * np.pi * sigma_px), seen.frequency.shape)
    turns = seen.frequency + scatter
    at = np.stack([place.x.T, place.y.T], axis=-1)
    # A phase that all images have in common does not change the products.
    at -= at.mean(axis=1, keepdims=True)
    sides, fields, images, count = change.shape
    factors = change.transpose(3, 0, 1, 2).reshape(count, sides * fields, images).astype(np.float32)
    amplitude = np.sqrt(seen.variance)[..., None] * seen.response
    found = np.zeros((fields, fields, count))
    for first in range(0, count, _POINTS_AT_ONCE):
        own = slice(first, first + _POINTS_AT_ONCE)
        phase = at[own] @ turns[own].swapaxes(1, 2)
        # Reduced to ± half a turn, a phase has 1e-7 rad in single precision.
        angle = (2 * np.pi * (phase - np.rint(phase))).astype(np.float32)
        for part in (np.cos(angle), np.sin(angle)):
            total = (factors[own] @ part).astype(np.float64).reshape(len(part), sides, fields, -1)
            waves = np.einsum("nws,nsfw->nfw", amplitude[own], total)
            found[..., own] += np.moveaxis(waves @ waves.swapaxes(1, 2), 0, -1)
    return found
