"""Numbers that are kept where finding them anew would load a library."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from scipy.spatial.transform import Rotation

from scenetruth.scene.leaf import SHIFTS, solve_shift
from scenetruth.scene.plant import _matrix


@pytest.mark.parametrize("place", SHIFTS)
def test_exponents_are_those_that_are_found(place: tuple[float, float, float]) -> None:
    assert SHIFTS[place] == solve_shift(*place)


angles = some.floats(-7, 7) | some.floats(-1e-3, 1e-3) | some.just(0.0)


@given(some.tuples(angles, angles, angles), some.tuples(*3 * [some.floats(-100, 100)]))
def test_plants_turn_as_scipy_turns_them_to_the_bit(
    vector: tuple[float, float, float], point: tuple[float, float, float]
) -> None:
    turn = Rotation.from_rotvec(vector)
    np.testing.assert_array_equal(_matrix(np.array(vector)), turn.as_matrix())
    # Before SciPy 1.16, apply adds in another order: two roundings of three products, each no larger than a coordinate.
    turned, most = _matrix(np.array(vector)) @ np.array(point), 6 * np.finfo(float).eps * max(map(abs, point))
    np.testing.assert_allclose(turned, turn.apply(point), rtol=0, atol=most)
