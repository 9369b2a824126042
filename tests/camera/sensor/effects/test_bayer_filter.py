from __future__ import annotations

import numpy as np
import pytest

from scenetruth.camera.sensor.effects import BayerFilter, BayerOrder
from tests.sensors import applied

RED, GREEN, BLUE = 0.5, 0.8, 0.25
BLOCKS: dict[BayerOrder, list[list[float]]] = {
    "rggb": [[RED, GREEN], [GREEN, BLUE]],
    "grbg": [[GREEN, RED], [BLUE, GREEN]],
    "gbrg": [[GREEN, BLUE], [RED, GREEN]],
    "bggr": [[BLUE, GREEN], [GREEN, RED]],
}


@pytest.mark.parametrize("order", BLOCKS)
def test_filters_repeat_from_the_upper_left(order: BayerOrder) -> None:
    effect = BayerFilter(kind="bayer_filter", order=order, response=(RED, GREEN, BLUE))
    # An odd number of rows and columns: the last block is cut.
    passed = applied(effect, np.full((5, 7), 1000.0))
    for y, x in np.ndindex(passed.shape):
        assert passed[y, x] == 1000 * BLOCKS[order][y % 2][x % 2]
    assert effect.mean_response(1000.0, 1.0) == passed.max()
    assert effect.largest_input(800.0, 1.0) == 1000.0
