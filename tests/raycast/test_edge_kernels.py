"""The kernel that cuts edges against a plain reading."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

from scenetruth.raycast.edge_kernels import cut_segments

Array = NDArray[np.float64]


def plain_cut(
    first: Array,
    last: Array,
    inverses: tuple[Array, Array],
    chosen: NDArray[np.int64],
    span: tuple[Array, Array],
    piece: float,
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Cut one segment after the other with NumPy's arange, linspace and sort."""
    (enter, leave), parts = span, []
    for n in chosen:
        step = last[n] - first[n]
        cuts = [np.array([enter[n], leave[n]])]
        if piece > 0:
            length = float(np.hypot(*step)) * (leave[n] - enter[n])
            cuts.append(np.linspace(enter[n], leave[n], int(np.ceil(length / piece)) + 1)[1:-1])
        for axis in () if piece > 0 else range(2):
            low, high = sorted((first[n, axis] + enter[n] * step[axis], first[n, axis] + leave[n] * step[axis]))
            borders = np.arange(np.ceil(low - 0.5), np.floor(high - 0.5) + 1) + 0.5
            if step[axis] != 0:
                cuts.append((borders - first[n, axis]) / step[axis])
        at = np.sort(np.clip(np.concatenate(cuts), enter[n], leave[n]))
        middle = (at[:-1] + at[1:]) / 2
        inverse = inverses[0][n] + middle * (inverses[1][n] - inverses[0][n])
        parts.append((inverse, first[n] + middle[:, None] * step, np.full(len(middle), n)))
    if not parts:
        return np.empty(0), np.empty((0, 2)), np.empty(0, dtype=np.int64)
    one, two, three = (np.concatenate(column) for column in zip(*parts, strict=True))
    return one, two, three


@pytest.mark.parametrize("piece", [0.0, 1 / 16])
@settings(max_examples=60, deadline=None)
@given(seed=some.integers(0, 10_000), count=some.integers(0, 12), size=some.sampled_from([0.01, 3.0, 200.0]))
def test_pieces_are_those_of_the_plain_reading_to_the_bit(piece: float, seed: int, count: int, size: float) -> None:
    generator = np.random.default_rng(seed)
    first, last = generator.uniform(-size, size, (2, count, 2))
    # Upright, level and empty segments, and ends exactly on borders and centres.
    snapped = generator.random((2, count, 2)) < 0.3
    first, last = np.where(snapped[0], np.rint(2 * first) / 2, first), np.where(snapped[1], np.rint(2 * last) / 2, last)
    level = generator.random((count, 2)) < 0.2
    last = np.where(level, first, last)
    inverses = generator.uniform(1e-3, 1e-2, (2, count))
    enter, leave = np.sort(generator.random((2, count)), axis=0)
    chosen = np.flatnonzero(generator.random(count) < 0.8)
    found = cut_segments(first, last, *inverses, chosen, enter, leave, piece)
    expected = plain_cut(first, last, (inverses[0], inverses[1]), chosen, (enter, leave), piece)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)
