"""Factors between estimate and truth, and the units that they tell of."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as some

from scenetruth.scoring.convention_hypotheses import LEAST_RATIO, SCALE_HYPOTHESES, nearest_scale
from scenetruth.scoring.convention_samples import AcquisitionParameters

FACTS = AcquisitionParameters(
    focal_length_px=500.0, baseline_mm=5.0, frame_interval_s=0.04, positions=5, step_px=2.0, width_px=640.0
)
KNOWN = [
    (scale, quantity, factor)
    for scale in SCALE_HYPOTHESES
    for quantity in scale.quantities
    for factor in scale.factors(FACTS)
]


@given(some.sampled_from(KNOWN), some.floats(-0.02, 0.02))
def test_bias_of_a_method_does_not_hide_a_unit(known: tuple[object, str, float], bias: float) -> None:
    _, quantity, factor = known
    found = nearest_scale(quantity, (1 + bias) * factor, FACTS)
    assert found is not None
    # Whole numbers above ten are told to the bias only, and a unit before whole numbers.
    assert abs(math.log(found.factor / factor)) <= (0.001 if factor <= 10 else 0.2)


@given(some.sampled_from(["depth", "disparity", "flow", "velocity"]), some.floats(1 / LEAST_RATIO, LEAST_RATIO))
def test_factors_near_one_are_no_units(quantity: str, factor: float) -> None:
    assert nearest_scale(quantity, factor, FACTS) is None


@pytest.mark.parametrize("factor", [0.0, -1.0, -1e-3, math.nan, math.inf])
def test_what_is_no_factor_is_no_unit(factor: float) -> None:
    assert all(nearest_scale(quantity, factor, FACTS) is None for quantity in ("depth", "velocity"))


def test_messages_tell_the_remedy_in_numbers() -> None:
    for scale, quantity, factor in KNOWN:
        found = nearest_scale(quantity, factor, FACTS)
        assert found is not None
        message = found.message(quantity)
        assert quantity in message
        assert "{" not in message
        if found.scale.whole:
            assert f"{factor:.4g}" in message
        assert scale.kind
