from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as some

from scenetruth.estimators.structure_tensor.registration import CELL, Rectangle, split_into_tiles


@given(
    area=some.tuples(some.integers(0, 200), some.integers(0, 400), some.integers(0, 200), some.integers(0, 1500)),
    threads=some.integers(1, 16),
)
def test_tiles_cover_an_area_once(area: tuple[int, int, int, int], threads: int) -> None:
    counted = np.zeros((400, 1500), dtype=int)
    for top, bottom, left, right in split_into_tiles(Rectangle(*area), None, threads):
        assert top < bottom
        assert left < right
        counted[top:bottom, left:right] += 1
    expected = np.zeros_like(counted)
    if area[0] < area[1] and area[2] < area[3]:
        expected[area[0] : area[1], area[2] : area[3]] = 1
    assert (counted == expected).all()


@given(
    area=some.tuples(some.integers(0, 60), some.integers(0, 170), some.integers(0, 60), some.integers(0, 260)),
    seed=some.integers(0, 999),
    share=some.floats(0, 1),
)
def test_tiles_of_cells_cover_all_that_is_wanted_and_nothing_twice(
    area: tuple[int, int, int, int], seed: int, share: float
) -> None:
    rows, columns = 11, 17
    cells = np.random.default_rng(seed).random((rows, columns)) < share
    counted = np.zeros((rows * CELL, columns * CELL), dtype=int)
    for top, bottom, left, right in split_into_tiles(Rectangle(*area), cells, 2):
        assert area[0] <= top < bottom <= area[1]
        assert area[2] <= left < right <= area[3]
        counted[top:bottom, left:right] += 1
    assert counted.max() <= 1
    wanted = np.kron(cells, np.ones((CELL, CELL), dtype=bool))
    inside = np.zeros_like(wanted)
    inside[area[0] : max(area[1], area[0]), area[2] : max(area[3], area[2])] = True
    assert (counted[wanted & inside] == 1).all()
