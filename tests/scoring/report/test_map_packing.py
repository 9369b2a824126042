"""Packed maps come back as they were, but for a rounding that is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from scenetruth.scoring.report import LEVELS, RELATIVE_ROUNDING, pack_map, unpack_map

SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=12)
ANYTHING = st.floats(allow_nan=True, allow_infinity=True)


@given(hnp.arrays(np.float64, SHAPES, elements=ANYTHING), st.floats(-1e6, 1e6), st.floats(0, 1e6))
def test_values_are_rounded_by_half_a_step_at_most(values: NDArray[np.float64], low: float, size: float) -> None:
    packed = pack_map(values, (low, low + size))
    back = unpack_map(packed)
    assert back.shape == values.shape
    np.testing.assert_array_equal(np.isnan(back), np.isnan(values))
    infinite = np.isinf(values)
    np.testing.assert_array_equal(back[infinite], values[infinite])
    finite = np.isfinite(values)
    # Half a step, and the rounding of float64 in low + n step, of numbers not larger than the value and both limits.
    slack = 8 * np.finfo(np.float64).eps * (np.abs(values[finite]) + abs(low) + 8 * size)
    assert (np.abs(back[finite] - values[finite]) <= packed.rounding + slack).all()
    assert packed.rounding <= RELATIVE_ROUNDING * ((low + size) - low) * (1 + 1e-12)


@given(hnp.arrays(np.float64, SHAPES, elements=ANYTHING))
def test_without_limits_the_range_is_that_of_the_values(values: NDArray[np.float64]) -> None:
    packed = pack_map(values)
    finite = np.isfinite(values)
    np.testing.assert_array_equal(np.isnan(unpack_map(packed)), np.isnan(values))
    if finite.any():
        least, most = values[finite].min(), values[finite].max()
        bound = RELATIVE_ROUNDING * (most / 2 - least / 2) * 2 + 8 * np.finfo(np.float64).eps * max(
            abs(least), abs(most)
        )
        assert (np.abs(unpack_map(packed)[finite] - values[finite]) <= bound).all()


@given(
    st.one_of(
        hnp.arrays(np.uint8, SHAPES),
        hnp.arrays(np.int64, SHAPES, elements=st.integers(-5, 60_000)),
        hnp.arrays(np.bool_, SHAPES),
    )
)
def test_whole_numbers_are_exact(values: NDArray[np.generic]) -> None:
    np.testing.assert_array_equal(unpack_map(pack_map(values, (0.0, 1.0))), values.astype(np.float64))


@pytest.mark.parametrize("predictor", [0, 1, 2])
def test_every_predictor_is_used_where_it_fits(predictor: int) -> None:
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:40, :50]
    # Few pixels that are known, rows of their own height, and a plane.
    values = (
        np.where((x % 5 == 2) & (y % 5 == 2), 4 * rng.random((40, 50)), np.nan) if predictor == 0
        else (rng.random((40, 1)) * 7.9 + 1e-4 * x) if predictor == 1
        else 0.05 * x + 0.03 * y
    )  # fmt: skip
    packed = pack_map(values, (0.0, 4.0))
    assert packed.predictor == predictor
    np.testing.assert_allclose(unpack_map(packed), values, rtol=0, atol=packed.rounding * (1 + 1e-9))


def test_smooth_maps_take_few_bytes_and_far_values_are_exact() -> None:
    y, x = np.mgrid[:120, :160]
    values = 660 + 0.1 * x + 0.05 * y + np.sin(x / 9)
    values[:30] = np.nan
    values[60, 80] = 1e7 / 3
    packed = pack_map(values, (660.0, 682.0))
    assert packed.exact == 1
    assert unpack_map(packed)[60, 80] == 1e7 / 3
    # 16 bits would be 2 bytes for a pixel.
    assert len(packed.data) < 0.5 * values.size
    assert packed.rounding == pytest.approx(22 / LEVELS / 2)


def test_a_map_of_one_value_is_exact() -> None:
    values = np.full((5, 7), 1.0 / 3.0)
    values[2, 3] = np.nan
    np.testing.assert_array_equal(unpack_map(pack_map(values)), values)
