"""Points of plans fill the space evenly, and each dimension stays as it is whatever else varies."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.dataset.distributions import ConeDistribution, RandomDistribution, SamplingPlan, UniformDistribution
from scenetruth.dataset.sampler import UniformDraws


def one(plan: SamplingPlan) -> UniformDistribution:
    return UniformDistribution(low=0, high=1, sampling=plan)


def points(fields: dict[str, RandomDistribution], count: int, seed: int = 3, attempt: int = 0) -> NDArray[np.float64]:
    uniforms = UniformDraws(seed, count, fields)
    return np.array(
        [[u for key, field in fields.items() for u in uniforms.of(key, field, n, attempt)] for n in range(count)]
    )


def test_sobol_points_are_a_net() -> None:
    """Of 2^m points, every box of 2^-m has one (two dimensions): A digital shift keeps that."""
    found = points({"a": one("sobol"), "b": one("sobol")}, 64)
    for bits in range(7):
        boxes = np.floor(found * [2**bits, 2 ** (6 - bits)]).astype(int)
        assert len({tuple(box) for box in boxes.tolist()}) == 64


def test_a_latin_hypercube_has_one_point_in_every_stratum() -> None:
    fields: dict[str, RandomDistribution] = {
        "a": one("latin_hypercube"),
        "b": ConeDistribution(axis=(0, 0, 1), half_angle_deg=9, sampling="latin_hypercube"),
    }
    for attempt in (0, 3):
        found = points(fields, 50, attempt=attempt)
        assert (np.sort(np.floor(found * 50).astype(int), axis=0) == np.arange(50)[:, None]).all()


@pytest.mark.parametrize("plan", ["independent", "sobol", "latin_hypercube"])
def test_another_field_changes_no_number(plan: SamplingPlan) -> None:
    alone = points({"a": one(plan)}, 20)
    with_more = points({"a": one(plan), "b": one(plan), "c": one("independent")}, 20)
    assert (alone[:, 0] == with_more[:, 0]).all()
    assert not (with_more[:, 0] == with_more[:, 1]).any()


def test_numbers_depend_on_seed_sample_and_draw_alone() -> None:
    fields: dict[str, RandomDistribution] = {"a": one("independent")}
    uniforms = UniformDraws(3, 10, fields)
    backwards = [uniforms.of("a", fields["a"], n, 0)[0] for n in reversed(range(10))]
    assert backwards[::-1] == points(fields, 10)[:, 0].tolist()
    everything = np.concatenate([points(fields, 200, seed, attempt).ravel() for seed in (1, 2) for attempt in (0, 1)])
    assert len(set(everything.tolist())) == everything.size


def test_points_far_along_are_those_of_the_sequence() -> None:
    """Blocks are made apart; SciPy's own engine goes through all of them."""
    from scipy.stats import qmc

    fields: dict[str, RandomDistribution] = {"a": one("sobol"), "b": one("sobol")}
    uniforms = UniformDraws(3, 10_000, fields)
    engine = qmc.Sobol(2, scramble=False, bits=32).random(8192)
    shift = round(uniforms.of("b", fields["b"], 0, 0)[0] * 2**32 - 0.5) ^ int(engine[0, 1] * 2**32)
    for n in (1, 4095, 4096, 8191):
        expected = ((int(engine[n, 1] * 2**32) ^ shift) + 0.5) / 2**32
        assert uniforms.of("b", fields["b"], n, 0)[0] == pytest.approx(expected, abs=2**-50)
