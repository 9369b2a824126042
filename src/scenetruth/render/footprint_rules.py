"""Rules of every order for pixel footprints, and their errors for textures that are interpolated bilinearly."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenetruth.render.sampling_rules import (
    GAUSS_ORDERS,
    WIDE_ORDERS,
    Rule,
    even_rule,
    gauss_rule,
    lattice_rule,
    square_rule,
)
from scenetruth.scene.texture import Picture, SurfaceTexture, TintedTexture

if TYPE_CHECKING:
    from scenetruth.render.footprint_kernels import Raster

__all__ = [
    "ALONE", "BLOCK", "FINE", "UNCUT", "WIDE", "all_rules", "bend_errors", "block_bends", "cell_orders", "gauss_tables",
    "raster_of", "rule_table",
]  # fmt: skip

_LATTICES = (67, 257, 1021)  # samples of the lattices for textures with steps
_SQUARES = (16, 32)  # orders of the equally spaced rules for bilinear textures
FINE = 1 + len(GAUSS_ORDERS)
"""Index of the first lattice among the rules; the first rule is the filter."""
WIDE = FINE + len(_LATTICES) + len(_SQUARES)
"""Index of the first of the Gauss rules for pixels with many texels."""
ALONE = WIDE + len(WIDE_ORDERS)
"""Index of the rule of pixels without a neighbour on their surface along an axis: they may contain many texels."""
_ALONE_ORDER = 24  # Gauss points along each axis of these few pixels
BLOCK = 8
"""Texels along a side of the blocks whose bends are kept."""
_BAND = 64 * BLOCK  # rows of a texture whose bends are computed together


@lru_cache(maxsize=1)
def all_rules() -> list[Rule]:
    """Return the rules from the first Gauss rule on."""
    gauss = [square_rule(*gauss_rule(order)) for order in GAUSS_ORDERS]
    wide = [square_rule(*gauss_rule(order)) for order in (*WIDE_ORDERS, _ALONE_ORDER)]
    return [*gauss, *map(lattice_rule, _LATTICES), *(square_rule(*even_rule(order)) for order in _SQUARES), *wide]


@lru_cache(maxsize=1)
def bend_errors() -> list[tuple[int, float]]:
    """Return the rules for bilinear textures, with the error of each at a unit change of the slope.

    A bilinear texture is bent at the lines through texel centres. The error is the RMS over the places of one such
    line along an axis of the pixel.
    """
    bends = (np.arange(4096) + 0.5) / 4096 - 0.5
    ramps = [*map(gauss_rule, GAUSS_ORDERS), *map(even_rule, _SQUARES)]
    numbers = [*range(1, FINE), *range(FINE + len(_LATTICES), FINE + len(_LATTICES) + len(_SQUARES))]
    exact = (0.5 - bends) ** 2 / 2
    return [
        (number, float(np.sqrt(np.mean((np.maximum(nodes - bends[:, None], 0) @ weights - exact) ** 2))))
        for number, (nodes, weights) in zip(numbers, ramps, strict=True)
    ]


UNCUT = 255
"""Order of cells in mixed pixels whose textures have steps, or waves too short for any."""


@lru_cache(maxsize=1)
def cell_orders() -> NDArray[np.uint8]:
    """Return the order of the Gauss points in the cells of mixed pixels for every rule around, shape (256,).

    The first orders are one less per axis than inside surfaces, because cells are smaller than pixels. Those of pixels
    with many texels are higher, because small numbers of points resolve fewer waves per point.
    """
    orders = np.full(256, UNCUT, dtype=np.uint8)
    orders[:FINE] = 2, 2, 2, 3, 4, 4
    # Lattices serve textures whose waves are too short for any of the orders inside surfaces as well.
    orders[FINE : FINE + 2] = WIDE_ORDERS[-1]
    wide = np.array(WIDE_ORDERS)
    # The step from pixels with few to those with many texels is gradual.
    orders[WIDE:ALONE] = np.minimum(wide + np.clip(wide - 6, -1, 1) + 1, WIDE_ORDERS[-1])
    # Pixels around them may contain fewer texels.
    orders[ALONE] = orders[FINE - 1]
    # Pixels without a surface, and mixed pixels.
    orders[255] = 0
    return orders


@lru_cache(maxsize=1)
def rule_table() -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return first sample and number of samples of every rule, from an empty one, and all offsets and weights."""
    count = np.array([0, *(len(weights) for _, weights in all_rules())])
    ordered = []
    for offsets, weights in all_rules():
        # Rows of samples in turn to the right and to the left, so that walks seldom change faces.
        row = np.floor((offsets[:, 1] + 0.5) * np.sqrt(len(weights))).astype(np.int64)
        order = np.lexsort((np.where(row % 2, -offsets[:, 0], offsets[:, 0]), row))
        ordered.append((offsets[order], weights[order]))
    offsets, weights = (np.concatenate(part) for part in zip(*ordered, strict=True))
    return np.cumsum(count) - count, count, offsets, weights


def raster_of(texture: SurfaceTexture) -> Raster | None:
    """Return the raster of a texture whose radiance is its interpolation, else None."""
    from scenetruth.render.footprint_kernels import Raster

    if isinstance(texture, TintedTexture):
        found = raster_of(texture.untinted)
        factor = texture.factor
        return None if found is None else found._replace(gain=found.gain * factor, mean=found.mean * factor)
    if isinstance(texture, Picture):
        return Raster(texture.values, False, texture.tiled, 1.0, 0.0)
    coefficients = getattr(texture, "coefficients", None)
    if coefficients is None:
        return None
    gain, mean = getattr(texture, "std", 1.0), getattr(texture, "mean", 0.0)
    return Raster(coefficients, True, True, float(gain), float(mean))


_bends: WeakKeyDictionary[SurfaceTexture, NDArray[np.float32]] = WeakKeyDictionary()


def block_bends(texture: SurfaceTexture) -> NDArray[np.float32]:
    """Return the RMS second differences of a bilinear texture in blocks of `BLOCK` texels, along the worse axis."""
    found = _bends.get(texture)
    if found is None:
        values, parts = texture.raster(), []
        rows, columns = values.shape

        def inside(index: NDArray[np.int64], size: int) -> NDArray[np.int64]:
            return index % size if texture.tiled else np.clip(index, 0, size - 1)

        across = inside(np.arange(-1, columns + 1), columns)
        for first in range(0, rows, _BAND):
            band = values[inside(np.arange(first - 1, min(first + _BAND, rows) + 1), rows)]
            wide = band[1:-1, across]
            bends = np.abs(wide[:, 2:] - 2 * wide[:, 1:-1] + wide[:, :-2])
            np.maximum(bends, np.abs(band[2:] - 2 * band[1:-1] + band[:-2]), out=bends)
            parts.append(_blocks_along(np.square(bends).T, tiled=texture.tiled).T)
        squares = _blocks_along(np.concatenate(parts), tiled=texture.tiled)
        found = _bends[texture] = np.sqrt(np.ascontiguousarray(squares))
    return found


def _blocks_along(values: NDArray[np.float32], *, tiled: bool) -> NDArray[np.float32]:
    """Return the means of blocks along the first axis, each with the first value of the next block.

    Between texels of two blocks, the texture is interpolated.
    """
    size = len(values)
    count = -(-size // BLOCK)
    index = np.arange(count * BLOCK + 1)
    padded = values[index % size if tiled else np.minimum(index, size - 1)]
    inside = padded[:-1].reshape(count, BLOCK, -1).sum(axis=1)
    blocks = (inside + padded[BLOCK::BLOCK]) / (BLOCK + 1)
    if tiled and size % BLOCK:
        # Beyond the border, blocks do not begin at multiples of their size.
        blocks = np.maximum(np.maximum(np.roll(blocks, 1, axis=0), blocks), np.roll(blocks, -1, axis=0))
    return np.asarray(blocks)


@lru_cache(maxsize=4)
def gauss_tables(most: int = GAUSS_ORDERS[-1]) -> Rule:
    """Return nodes and weights along one axis of all orders up to the largest, shape (orders, most)."""
    nodes, weights = np.zeros((2, most + 1, most))
    for order in range(1, most + 1):
        nodes[order, :order], weights[order, :order] = gauss_rule(order)
    return nodes, weights
