"""Fallback disparities where the fit failed: the plane sweep, and planes of neighbouring surfaces carried into holes.

Holes are filled from the pixels with a disparity: they are connected to surfaces, planes are fitted to these, and every
pixel of a hole takes the plane of the surface that is nearest along the image, where crossing an edge adds distance.
The standard deviations contain the errors of the planes, other surfaces nearby, and the probability of an unobserved
surface.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.bare_surfaces import find_bare_areas, fit_bare_surfaces
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.initialisation import InitialEstimate
from scenetruth.estimators.refined.kernels.geodesic_fill import (
    ExtensionRules,
    SurfacePlanes,
    carry_sources,
    extend_planes,
    fit_planes,
    fit_surfaces,
    label_surfaces,
    look_around,
)
from scenetruth.estimators.refined.other_views import OtherViews, match_views
from scenetruth.threads import in_bands

__all__ = ["FallbackValues", "Sources", "compute_fallback", "fill_holes", "recede"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SURFACES = 3  # surfaces considered at every pixel
_REACH_PX = 14  # radius of the neighbours of a plane
_LEAST_PIXELS = 16  # smaller surfaces are chance matches of the plane sweep
_JUMP_PX = 1.0  # largest step within a surface, in px of the farthest camera
_CONTRAST = 0.5  # length in px of a step of one grey value of 8 bits
_NOISE_GREY = 1.5  # noise of images of 8 bits; noisier images are scaled to it, as noise is no edge
_EDGE = 3.0 * 2**0.5  # differences of grey values up to three deviations of the noise of a difference are no edge
_TURNS = 3  # sweeps in each direction: longer detours are rare
# Error of a sweep in px of the farthest camera, and weight of a sweep pixel relative to a fitted one.
_SWEEP_PX, _SWEEP_WEIGHT = 0.1, 0.25
_SLOPE = 0.03  # prior deviation of slopes in px per px: surfaces turned by some 60 degrees
_CORRELATED = 100.0  # pixels whose errors are common: the census squares and windows overlap
_CLIP_PX = 1.0  # largest extrapolation beyond the disparities of the neighbours, in px per step
# A farther surface is preferred up to this additional distance in px, twice a window, and sum of edges in grey values,
# and from this difference in px per step.
_BEHIND = (12.0, 8.0, 0.25)
_SCALE_PX = 12.0  # difference of distances that makes a surface less probable by a factor of e
_MEDIAN_PX = 5
_LOCAL_PX = 7  # census square, within which the place of an outline is uncertain
_BEYOND_PX = 5
_OUTLINE = 0.5  # error of a sweep in units of the deviation of disparities within that square
# Probability that a pixel belongs to an unobserved surface: with the chosen surface on both sides along
# all four lines, on some, or on none, near its edge and far from it. Shares of wrong pixels on simulated scenes.
_UNSEEN = np.array([0.2, 0.1, 0.1, 0.1, 0.1])
_UNSEEN_FAR = 0.4
_UNSEEN_OF_AMBIGUOUS = 0.4  # the same of a pixel that another disparity fits as well
_DEPTHS = 0.3  # deviation of the disparity of an unknown background, between zero and the foreground, relative to that
_ANY_DEPTH = 3**-0.5  # the same of a background with any disparity between zero and the foreground
_LARGEST = 1.0  # largest standard deviation of a fallback disparity, relative to it
# Disparities of bare surfaces relative to the smallest and largest of the others.
_NEAREST_AND_FARTHEST = 0.5, 2.0
# Smallest fraction of the rows of a bare surface that end in its plane at both sides; probability of another surface,
# and root of its mean squared difference relative to the disparity, above this fraction and below: there the outlines
# may be those of objects before the surface.
_ENCLOSED, _UNSEEN_OF_PLANES = 0.25, ((0.05, _DEPTHS), (0.4, _ANY_DEPTH))
_OUTLINE_PX = 0.3  # error of the disparity of an outline, in px of the farthest camera
# Distance of the farther surface to which a swept pixel may belong, smallest squared difference from the other views of
# such a pixel, and largest ratio of that with the farther surface.
_BESIDE_PX, _DIFFERS, _AGREES = 4, 2.0, 0.3
# Smallest squared difference of pixels that are unlike the other views; probabilities that a swept pixel belongs to an
# unobserved surface: like the views, near a pixel that is unlike them, and unlike them.
_UNLIKE_FROM, _UNLIKE = 1.0, np.array([0.0, 0.05, 0.3])
_CONTRADICTION_PX = 1.0  # per step
_CLEAR_OF_ZERO_PX = 1.0  # smallest displacement in the farthest camera
# Windows in px for the texture of a pixel itself, and smallest ratio of its gradient to that of noise.
_OWN_PX, _CLOSE_PX, _OWN_GRADIENT = 2.0, 1.0, 2.0


@dataclass(frozen=True, eq=False)
class Sources:
    """Disparities in columns per step from which holes are filled, all of shape (y, x)."""

    disparity: Map
    """Disparity; used where one of the masks is set."""
    fitted: Mask
    """Where it is that of a valid fit, close to texture."""
    swept: Mask
    """Where it is that of the plane sweep."""
    bare: Mask
    """Where a bare surface is near, into which the squares of the sweep extend the disparity of an outline."""


@dataclass(frozen=True, eq=False)
class FallbackValues:
    """Fallback disparities, all of shape (y, x)."""

    where: Mask
    disparity: Map
    """In columns per step."""
    std: Map
    """Standard deviation, in columns per step."""
    swept: Mask | None = None
    """Textured pixels without a fit that have a disparity of the plane sweep."""


def compute_fallback(
    images: ImageStack,
    start: InitialEstimate,
    valid: Mask,
    disparity: Map,
    noise: float,
    ambiguous: Mask,
    kind: Literal["fill", "plane_sweep", "none"],
) -> FallbackValues:
    """Return the fallback disparities of a frame where the fit is not ``valid``.

    ``disparity``: That of the fit, in columns per step.
    ``ambiguous``: Pixels that another disparity fits as well: their standard deviations include it.
    ``noise``: Standard deviation of the grey values.
    """
    swept = np.zeros_like(valid)
    if kind == "none" or len(images.positions) == 1:
        return FallbackValues(swept, disparity, disparity, swept)
    frame, camera = images.reference()
    usable = images.usable(frame, camera)
    textured = _own_texture(images, noise, _OWN_PX)
    # Points at infinity have no depth.
    swept = start.known & ~valid & (np.abs(start.fields[0]) * images.farthest > _CLEAR_OF_ZERO_PX) & usable & textured
    if kind == "plane_sweep":
        return FallbackValues(swept & ~ambiguous, start.fields[0], np.full(images.shape, np.nan), swept)
    grey, own_noise = images.reference_grey(), noise / images.channels**0.5
    texture = _own_texture(images, noise, _CLOSE_PX)
    areas = find_bare_areas(grey, own_noise, texture)
    outside = areas == 0
    sources = Sources(
        np.where(valid & textured, disparity, start.fields[0]),
        valid & textured & outside,
        swept & outside,
        near_bare_surfaces(texture),
    )
    given = sources.fitted | sources.swept
    if not given.any():
        return FallbackValues(given, start.fields[0], np.zeros(images.shape), swept)
    views = match_views(images, grey, sources.disparity, given)
    sources, unlike = recede(sources, grey, own_noise, views)
    found = fill_holes(grey, own_noise, sources, ~valid & usable, images.farthest)
    # Swept pixels that differ from the other views belong to another surface, thinner than the squares of the sweep.
    spread = _spread(sources, found.disparity)
    square = found.std**2 + _UNLIKE[unlike] * spread + (views.uncertainty / images.farthest) ** 2
    found = replace(found, std=np.where(sources.swept, np.sqrt(square), found.std))
    found = _fill_bare_surfaces(grey, own_noise, sources, areas, views, found, ~valid & usable)
    contradicted = start.known & ~swept & outside & (np.abs(start.fields[0] - found.disparity) > _CONTRADICTION_PX)
    clear = np.abs(found.disparity) * images.farthest > _CLEAR_OF_ZERO_PX
    rival = np.where(ambiguous, _UNSEEN_OF_AMBIGUOUS * spread, 0.0)
    found = replace(found, std=np.sqrt(found.std**2 + rival))
    return replace(found, where=found.where & ~contradicted & clear, swept=swept)


def recede(sources: Sources, grey: Map, noise: float, views: OtherViews) -> tuple[Sources, NDArray[np.uint8]]:
    """Return sources whose swept pixels next to outlines may belong to the farther surface, and how unlike they are.

    The squares of the sweep extend the nearer surface beyond its outline. A pixel belongs to the farther one if it
    differs from the other views otherwise. It is unlike the other views (2), close to unlike pixels (1), or neither.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    given = sources.fitted | sources.swept
    size = np.abs(sources.disparity)
    farther = minimum_filter(np.where(given, size, np.inf), 2 * _BESIDE_PX + 1)
    farther = np.where(given, farther, size) * np.sign(sources.disparity)
    own, other = (views.compare(each, grey, noise) for each in (sources.disparity, farther))
    recede = sources.swept & (own > _DIFFERS) & (other < _AGREES * own)
    left = np.where(given, np.where(recede, other, own), 0.0)
    unlike = 2 * (left > _UNLIKE_FROM)
    near = (maximum_filter(left, 3) > _UNLIKE_FROM) | (maximum_filter(left, 5) > 2 * _UNLIKE_FROM)
    disparity = np.where(recede, farther, sources.disparity)
    return replace(sources, disparity=disparity), np.maximum(unlike, near).astype(np.uint8)


def _spread(sources: Sources, disparity: Map, depths: float = _DEPTHS) -> Map:
    """Return the mean squared difference of an unobserved surface; ``depths``: that of a background, relative to it."""
    given = sources.fitted | sources.swept
    return np.asarray(float(np.var(sources.disparity[given])) + (depths * disparity) ** 2)


def _fill_bare_surfaces(
    grey: Map,
    noise: float,
    sources: Sources,
    areas: NDArray[np.int32],
    views: OtherViews,
    found: FallbackValues,
    wanted: Mask,
) -> FallbackValues:
    """Return the fallback disparities with the planes of bare surfaces, where their outlines determine them."""
    if not len(views.positions):
        return found
    farthest = float(np.abs(views.positions).max())
    labels, surfaces, whole = find_surfaces(sources, farthest)
    if not len(surfaces):
        return found
    known = sources.disparity[labels >= 0]
    sign = -1.0 if np.median(known) < 0 else 1.0
    numbers = np.where(labels >= 0, np.searchsorted(surfaces, labels), -1).astype(np.int32)
    # Planes about their centroids.
    planes = np.stack([whole[:, 2] - whole[:, 3] * whole[:, 0] - whole[:, 4] * whole[:, 1], *whole.T[3:5]], axis=1)
    limits = (
        _NEAREST_AND_FARTHEST[0] * float(np.abs(known).min()),
        _NEAREST_AND_FARTHEST[1] * float(np.abs(known).max()),
    )
    turned = replace(views, positions=sign * views.positions)
    value, std, where = found.disparity.copy(), found.std.copy(), found.where.copy()
    for each in fit_bare_surfaces(areas, grey, noise, turned, limits, numbers, sign * planes):
        rows, columns = each.rows, each.columns
        d = each.plane[0] + each.plane[1] * columns + each.plane[2] * rows
        value[rows, columns] = sign * d
        unseen, depths = _UNSEEN_OF_PLANES[0 if each.enclosed > _ENCLOSED else 1]
        square = (_OUTLINE_PX / farthest) ** 2 + each.error**2 + unseen * _spread(sources, d, depths)
        std[rows, columns] = np.sqrt(square)
        where[rows, columns] = wanted[rows, columns] & (square < (_LARGEST * d) ** 2)
    return FallbackValues(where, value, std)


def _label_sources(sources: Sources, farthest: float) -> tuple[Map, NDArray[np.int32]]:
    """Return the disparity of the sources, else 0, and the labels of their surfaces, -1 for small surfaces."""
    given = sources.fitted | sources.swept
    disparity = np.where(given, sources.disparity, 0.0)
    labels = np.empty(given.shape, dtype=np.int32)
    label_surfaces(disparity, given, _JUMP_PX / farthest, labels)
    sizes = np.bincount(labels[given], minlength=labels.size)
    labels[given & (sizes[labels] < _LEAST_PIXELS)] = -1
    return disparity, labels


def find_surfaces(sources: Sources, farthest: float) -> tuple[NDArray[np.int32], NDArray[np.int64], Map]:
    """Return the label of the surface of every source, else -1; the labels; and planes as in `fit_surfaces`."""
    disparity, labels = _label_sources(sources, farthest)
    surfaces = np.unique(labels[labels >= 0]).astype(np.int64)
    numbers = np.zeros(labels.size, dtype=np.int32)
    numbers[surfaces] = np.arange(len(surfaces))
    whole = np.zeros((len(surfaces), 9))
    weight = np.where(sources.fitted, 1.0, _SWEEP_WEIGHT)
    fit_surfaces(disparity, weight, labels, numbers, (_SWEEP_PX / farthest) ** 2 / _SLOPE**2, whole)
    return labels, surfaces, whole


def near_bare_surfaces(textured: Mask) -> Mask:
    """Return what is within reach of a census square, and of the blur of an edge, from a bare area of such a square."""
    from scipy import ndimage

    areas, count = ndimage.label(~textured)
    large = np.concatenate([[False], np.bincount(areas.ravel(), minlength=count + 1)[1:] >= _LOCAL_PX**2])
    return np.asarray(ndimage.maximum_filter(large[areas], 2 * _BEYOND_PX + 1))


def _own_texture(images: ImageStack, noise: float, sigma_px: float) -> Mask:
    """Return where the reference image has twice the gradient due to noise, within a Gaussian window."""
    from scipy.ndimage import gaussian_filter

    square = np.zeros(images.shape)
    for channel in range(images.channels):
        square += sum(np.square(each) for each in np.gradient(images.grey(*images.reference(), channel)))
    # A central difference has half the variance of a pixel, along x and along y.
    return np.asarray(gaussian_filter(square, sigma_px) > (_OWN_GRADIENT * noise) ** 2 * images.channels)


def fill_holes(grey: Map, noise: float, sources: Sources, wanted: Mask, farthest: float) -> FallbackValues:
    """Return fallback disparities at the ``wanted`` pixels: those of swept sources, and of planes elsewhere.

    ``grey``: Reference image.
    ``noise``: Standard deviation of its noise.
    ``farthest``: Distance of the farthest camera, in steps.
    """
    from scipy import ndimage

    height, width = grey.shape
    nothing = np.zeros(grey.shape, dtype=np.bool_)
    disparity, labels = _label_sources(sources, farthest)
    source = labels >= 0
    if not source.any():
        return FallbackValues(nothing, disparity, disparity)
    low, high = np.percentile(grey, (1, 99))
    unit = max((high - low) / 255.0, noise / _NOISE_GREY, 1e-30)
    costs = np.full((height, width, _SURFACES), np.inf, dtype=np.float32)
    edges = np.zeros_like(costs)
    nearest = np.full(costs.shape, -1, dtype=np.int32)
    costs[source, 0] = 0.0
    nearest[source, 0] = np.flatnonzero(source)
    scaled = np.asarray(grey / unit, dtype=np.float32)
    carry_sources(scaled, labels.ravel(), _CONTRAST, _EDGE * noise / unit, _TURNS, costs, edges, nearest)
    value, variance = disparity.copy(), np.zeros(grey.shape)
    chosen = np.where(source, nearest[:, :, 0], -1).astype(np.int32)
    least = (_SWEEP_PX / farthest) ** 2
    weight = np.where(sources.fitted, 1.0, _SWEEP_WEIGHT)
    prior = least / _SLOPE**2
    places = np.unique(nearest[~source])
    places = places[places >= 0].astype(np.int64)
    near, near_of = np.zeros((len(places), 11)), np.zeros(labels.size, dtype=np.int32)
    near_of[places] = np.arange(len(places))
    in_bands(fit_planes, len(places), places, disparity, weight, labels, _REACH_PX, prior, near, least=64)
    surfaces = np.unique(labels[source])
    numbers = np.zeros(labels.size, dtype=np.int32)
    numbers[surfaces] = np.arange(len(surfaces))
    whole = np.zeros((len(surfaces), 9))
    fit_surfaces(disparity, weight, labels, numbers, prior, whole)
    planes = SurfacePlanes(near, near_of, whole, numbers)
    rules = ExtensionRules(least, _CORRELATED, _CLIP_PX, *_BEHIND, _SCALE_PX)
    paths = (costs, edges, nearest)
    in_bands(extend_planes, height, paths, labels, planes, rules, value, variance, chosen, least=16)
    filled = chosen >= 0
    value = np.where(source, disparity, ndimage.median_filter(value, _MEDIAN_PX))
    surface = np.where(filled, labels.ravel()[np.maximum(chosen, 0)], -1).astype(np.int32)
    lines = np.zeros(grey.shape, dtype=np.uint8)
    look_around(labels, surface, max(height, width), lines)
    # From the distance to the source, or in the middle of the hole.
    apart, within = (part / (part + _SCALE_PX) for part in (costs[:, :, 0].astype(np.float64), _depths_of_holes(costs)))
    unseen = _UNSEEN[lines] * np.where(lines == 0, 1.0, within)
    unseen += np.where(lines == 0, (_UNSEEN_FAR - _UNSEEN[0]) * apart, 0.0)
    spread = float(np.var(disparity[source])) + (np.where(lines == 0, _ANY_DEPTH, _DEPTHS) * value) ** 2
    swept = least + _OUTLINE**2 * _local_variance(value) + np.where(sources.bare, _UNSEEN[0] * spread, 0.0)
    std = np.sqrt(np.where(source, swept, variance + least + unseen * spread))
    where = wanted & filled & (std < _LARGEST * np.abs(value))
    return FallbackValues(where, value, std)


def _depths_of_holes(costs: NDArray[np.float32]) -> Map:
    """Return the largest least cost within each connected hole."""
    from scipy import ndimage

    cost = np.where(np.isfinite(costs[:, :, 0]), costs[:, :, 0], 0.0)
    holes, count = ndimage.label(cost > 0)
    largest = np.concatenate([[0.0], np.atleast_1d(ndimage.maximum(cost, holes, np.arange(1, count + 1)))])
    return np.asarray(largest[holes], dtype=np.float64)


def _local_variance(values: Map) -> Map:
    """Return the variance of a map within squares."""
    from scipy.ndimage import uniform_filter

    middle = float(np.mean(values))
    mean = uniform_filter(values - middle, _LOCAL_PX)
    return np.asarray(np.maximum(uniform_filter((values - middle) ** 2, _LOCAL_PX) - mean**2, 0.0))
