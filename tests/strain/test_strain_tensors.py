"""Sensitivities of strain to errors of the velocity."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from scenetruth.strain.strain_tensors import SurfaceStrain


@pytest.mark.parametrize("measure", ["green_lagrange", "hencky", "engineering"])
def test_sensitivities_of_a_steady_velocity_are_those_of_its_integral(measure: Any) -> None:
    """In exp(L), an error of a stretch by 30 % per frame counts exp(0.3) / 1.3 times as much as in 1 + L, and more."""
    rng = np.random.default_rng(3)
    points, moved, change = (rng.normal(size=(2, 3, 40)) for _ in range(3))
    moved = 0.3 * points + 0.2 * moved
    some = SurfaceStrain(points, moved, measure, steady=True)
    stated = np.einsum("micn,icn->mn", some.sensitivities(), change)
    # Errors of these differences (second order) and of those of the method (first order): below 1e-5 of the largest.
    step = 1e-5
    ahead, back = (SurfaceStrain(points, moved + sign * step * change, measure, steady=True) for sign in (1, -1))
    np.testing.assert_allclose(
        stated, (ahead.values() - back.values()) / (2 * step), rtol=0, atol=1e-5 * abs(stated).max()
    )
    # Those of 1 + L are others.
    assert abs(SurfaceStrain(points, moved, measure).sensitivities() - some.sensitivities()).max() > 0.1
