"""Kernels of the fallback values against shortest paths and connected components of SciPy, and exact planes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from scenetruth.estimators.refined.kernels.geodesic_fill import (
    carry_sources,
    fit_planes,
    fit_surfaces,
    label_surfaces,
    look_around,
)

SHAPE = (19, 23)


@pytest.fixture(scope="module")
def labels() -> np.ndarray:
    """Three surfaces of one to some tens of pixels, labelled by their first pixels."""
    found = np.full(SHAPE, -1, dtype=np.int32)
    found[2:5, 3:9], found[12, 18], found[15:, :3] = 2 * SHAPE[1] + 3, 12 * SHAPE[1] + 18, 15 * SHAPE[1]
    return found


def test_surfaces_are_connected_pixels() -> None:
    generator = np.random.default_rng(1)
    source = generator.random(SHAPE) < 0.7
    disparity = np.where(generator.random(SHAPE) < 0.5, 3.0, 7.0) + generator.uniform(-0.2, 0.2, SHAPE)
    found = np.empty(SHAPE, dtype=np.int32)
    label_surfaces(disparity, source, 0.5, found)
    expected, count = ndimage.label(source & (disparity < 5))
    other, more = ndimage.label(source & (disparity > 5))
    expected = np.where(other > 0, other + count, expected)
    assert ((found >= 0) == source).all()
    pairs = {(int(a), int(b)) for a, b in zip(found[source], expected[source], strict=True)}
    assert len(pairs) == count + more == len(np.unique(found[source]))


def test_costs_are_those_of_shortest_paths(labels: np.ndarray) -> None:
    """Of each surface, the least cost; sources are the ends of paths and not crossed."""
    generator = np.random.default_rng(2)
    grey = generator.normal(0.0, 6.0, SHAPE).astype(np.float32)
    height, width = SHAPE
    costs = np.full((*SHAPE, 3), np.inf, dtype=np.float32)
    sources = np.full((*SHAPE, 3), -1, dtype=np.int32)
    source = labels >= 0
    costs[source, 0], sources[source, 0] = 0.0, np.flatnonzero(source)
    edges = np.zeros_like(costs)
    carry_sources(grey, labels.ravel(), 0.5, 4.0, 50, costs, edges, sources)
    rows, columns, lengths = [], [], []
    for y, x in np.ndindex(SHAPE):
        for v, u in ((y + j, x + i) for j in (-1, 0, 1) for i in (-1, 0, 1) if (j, i) != (0, 0)):
            if 0 <= v < height and 0 <= u < width and not source[v, u]:
                rows.append(y * width + x)
                columns.append(v * width + u)
                lengths.append(np.hypot(v - y, u - x) + 0.5 * abs(float(grey[y, x]) - float(grey[v, u])))
    # Older versions of SciPy search graphs with 32-bit indices only.
    ends = np.array(rows, dtype=np.int32), np.array(columns, dtype=np.int32)
    graph = coo_array((lengths, ends), shape=(labels.size, labels.size)).tocsr()
    each = [dijkstra(graph, indices=np.flatnonzero(labels == n), min_only=True) for n in np.unique(labels[source])]
    expected = np.sort(np.reshape(each, (3, *SHAPE)), axis=0)
    np.testing.assert_allclose(np.moveaxis(costs, -1, 0)[:, ~source], expected[:, ~source], rtol=1e-4)
    surfaces = np.sort(labels.ravel()[sources[~source]], axis=-1)
    assert (surfaces == np.unique(labels[source])).all()
    assert (edges[~source] < 2 * costs[~source]).all()


def test_planes_are_recovered(labels: np.ndarray) -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    disparity = 5.0 + 0.02 * x - 0.03 * y
    weight = np.random.default_rng(3).uniform(0.2, 1.0, SHAPE)
    places = np.flatnonzero(labels == labels[3, 5])
    near = np.zeros((len(places), 11))
    fit_planes(0, len(places), places, disparity, weight, labels, 14, 1e-9, near)
    at = near[:, 2] + near[:, 3] * (10 - near[:, 0]) + near[:, 4] * (11 - near[:, 1])
    np.testing.assert_allclose(at, disparity[11, 10], atol=1e-6)
    np.testing.assert_allclose(near[:, 9], disparity[2:5, 3:9].min(), atol=1e-12)
    surfaces = np.unique(labels[labels >= 0])
    numbers = np.zeros(labels.size, dtype=np.int32)
    numbers[surfaces] = np.arange(3)
    whole = np.zeros((3, 9))
    fit_surfaces(disparity, weight, labels, numbers, 1e-9, whole)
    np.testing.assert_allclose(whole[0, 3:5], (0.02, -0.03), atol=1e-6)
    # One pixel has no slope.
    np.testing.assert_allclose(whole[1, 2:6], (disparity[12, 18], 0, 0, 0), atol=1e-12)


def test_lines_end_at_the_chosen_surface() -> None:
    labels = np.full(SHAPE, -1, dtype=np.int32)
    labels[5, 5:16], labels[15, 5:16], labels[5:16, 5], labels[5:16, 15] = 0, 0, 0, 0
    labels[10, 5] = 7
    chosen = np.where(labels < 0, 0, labels).astype(np.int32)
    pairs = np.zeros(SHAPE, dtype=np.uint8)
    look_around(labels, chosen, 100, pairs)
    # A square around its middle, but for one pixel in its row.
    assert pairs[10, 10] == 3
    assert pairs[9, 10] == 4
    assert pairs[1, 10] == pairs[10, 2] == 0
