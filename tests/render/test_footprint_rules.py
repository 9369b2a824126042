"""Bends of textures in blocks, against second differences of their samples; orders of cells."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.render.footprint_rules import FINE, UNCUT, block_bends, cell_orders
from scenetruth.scene.texture import Picture


@pytest.mark.parametrize("tiled", [True, False])
@pytest.mark.parametrize("shape", [(16, 24), (13, 30), (521, 9)])
def test_bends_of_blocks_are_rms_second_differences(shape: tuple[int, int], tiled: bool) -> None:
    texture = Picture(np.random.default_rng(shape[0]).random(shape).astype(np.float32), tiled)
    found = block_bends(texture)
    assert found.shape == (-(-shape[0] // 8), -(-shape[1] // 8))
    for row, column in np.ndindex(found.shape):
        # Texels of the block and the first of the next, which may lie beyond the border.
        y, x = np.meshgrid(8 * row + np.arange(9), 8 * column + np.arange(9), indexing="ij")
        if not tiled:
            y, x = np.minimum(y, shape[0] - 1), np.minimum(x, shape[1] - 1)

        def at(down: int, right: int, y: Any = y, x: Any = x) -> NDArray[np.float64]:
            uv = np.stack([(x + right + 0.5) / shape[1], (y + down + 0.5) / shape[0]], axis=-1)
            return texture.radiance(uv.reshape(-1, 2)).astype(np.float64)

        bends = [at(-dy, -dx) - 2 * at(0, 0) + at(dy, dx) for dy, dx in ((0, 1), (1, 0))]
        expected = float(np.sqrt(np.mean(np.square(np.max(np.abs(bends), axis=0)))))
        if tiled and (shape[0] % 8 or shape[1] % 8):
            # Blocks beyond the border of a tile are between two blocks.
            assert found[row, column] >= expected - 1e-5
        else:
            assert found[row, column] == pytest.approx(expected, abs=1e-5)


def test_mixed_pixels_of_any_smooth_texture_are_cut() -> None:
    # The finest textures have lattices inside surfaces, and cells with as many points in mixed pixels.
    orders = cell_orders()[: FINE + 2].astype(np.int64)
    assert (orders != UNCUT).all()
    assert (np.diff(orders) >= 0).all()
    assert orders[-1] ** 2 >= 256
