from __future__ import annotations

import numpy as np
import pytest

from scenetruth.estimators.structure_tensor.execution import carry_to_reference


@pytest.mark.parametrize(("right", "down"), [(0.0, 0.0), (0.4, -0.3), (-1.2, 0.7)])
def test_linear_maps_are_carried_exactly(right: float, down: float) -> None:
    y, x = np.mgrid[:20, :30].astype(np.float64)
    moved = np.stack([right + 0.01 * x, down - 0.02 * y])
    # The value of a point is linear where it is seen by the reference.
    value = 2.0 * (x + moved[0]) - 3.0 * (y + moved[1])
    carried, _ = carry_to_reference(moved, value[None], np.ones((1, 20, 30), dtype=np.uint8))
    inner = np.s_[3:-3, 3:-3]
    np.testing.assert_allclose(carried[0][inner], (2 * x - 3 * y)[inner], atol=1e-5)


def test_pixels_next_to_unknown_ones_are_unknown() -> None:
    moved = np.full((2, 9, 9), 0.5)
    moved[:, 4, 4] = np.nan
    flags = np.full((1, 9, 9), 2, dtype=np.uint8)
    carried, kinds = carry_to_reference(moved, np.ones((1, 9, 9)), flags)
    assert np.isnan(carried[0, 4:6, 4:6]).all()
    assert (kinds[0, 4:6, 4:6] == 0).all()
    assert np.isfinite(carried[0, 1:4, 1:4]).all()
    assert (kinds[0, 1:4, 1:4] == 2).all()


def test_what_comes_from_outside_is_unknown() -> None:
    moved = np.full((2, 8, 8), 3.0)
    carried, _ = carry_to_reference(moved, np.ones((1, 8, 8)), np.ones((1, 8, 8), dtype=np.uint8))
    assert np.isnan(carried[0, :3]).all()
    assert np.isnan(carried[0, :, :3]).all()
    assert np.isfinite(carried[0, 3:, 3:]).all()
