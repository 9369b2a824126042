"""Choice of rules and filtering, against plain readings of their definitions."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as some

from scenetruth.render.pixel_filter_kernels import NO_RULE, choose_rules, filter_samples, texture_ranges
from scenetruth.render.sampling_rules import FILTER_TAPS


@settings(deadline=None, max_examples=20)
@given(some.integers(0, 10_000))
def test_filter_samples_reads_whole_windows_of_one_body(seed: int) -> None:
    generator = np.random.default_rng(seed)
    shape = (24, 30)
    samples = generator.random(shape).astype(np.float32)
    usable = generator.random(shape) > 0.01
    body = np.where(np.arange(30) < generator.integers(3, 28), 0, 1)[None].repeat(24, axis=0).astype(np.int32)
    image, done = filter_samples(samples, usable, body, FILTER_TAPS)
    for y in range(24):
        for x in range(30):
            window = np.s_[y - 3 : y + 4, x - 3 : x + 4]
            whole = 3 <= y < 21 and 3 <= x < 27 and usable[window].all() and (body[window] == body[y, x]).all()
            assert done[y, x] == whole
            expected = FILTER_TAPS @ samples[window].astype(np.float64) @ FILTER_TAPS if whole else samples[y, x]
            np.testing.assert_allclose(image[y, x], expected, rtol=1e-6)


def test_rules_follow_the_step_to_the_neighbours() -> None:
    y, x = np.mgrid[:9, :12].astype(np.float64)
    body = np.zeros((9, 12), dtype=np.int32)
    mixed = np.zeros((9, 12), dtype=np.bool_)
    longest = np.array([[1.0, 2.0, 4.0]])
    texels = np.array([[10.0, 20.0]])
    for step, rule in ((0.9, 0), (1.1, 1), (3.9, 2), (4.1, 3)):
        uv = np.stack([x * step / 10, y * 0.5 / 20], axis=-1)
        rules, steps = choose_rules(uv, body, mixed, texels, longest)
        assert (rules == rule).all()
        np.testing.assert_allclose(steps, step, rtol=1e-6)
    # At a seam of the texture, the step is long; two pixels from it, it is not.
    uv = np.stack([np.where(x < 6, x, x + 30) * 0.09, y * 0.02], axis=-1)
    rules, _steps = choose_rules(uv, body, mixed, texels, longest)
    assert (rules[:, 5:7] == 3).all()
    assert (rules[:, :5] == 0).all()
    # Where the step changes between both sides of a pixel, samples at pixel centres are not filtered.
    uv = np.stack([np.where(x < 6, 0.5 * x, 0.9 * x - 2.4) * 0.1, 0 * y], axis=-1)
    rules, _steps = choose_rules(uv, body, mixed, texels, longest)
    assert (rules[:, 6] == 1).all()
    assert (np.delete(rules, 6, axis=1) == 0).all()


def test_mixed_pixels_and_background_have_no_rule_and_lonely_pixels_the_finest() -> None:
    uv = np.zeros((5, 5, 2))
    body = np.full((5, 5), -1, dtype=np.int32)
    body[2, 1:4] = 0
    mixed = np.zeros((5, 5), dtype=np.bool_)
    mixed[2, 1] = True
    rules, steps = choose_rules(uv, body, mixed, np.ones((1, 2)), np.array([[1.0, 2.0, 4.0]]))
    assert rules[2, 1] == NO_RULE
    assert rules[2, 2] == rules[2, 3] == 2
    assert (np.delete(rules, 2, axis=0) == NO_RULE).all()
    assert np.isinf(steps).all()


@settings(deadline=None, max_examples=20)
@given(some.integers(0, 10_000), some.booleans())
def test_texture_ranges_are_those_of_all_blocks_in_reach(seed: int, tiled: bool) -> None:
    generator = np.random.default_rng(seed)
    lowest = generator.random((5, 7)).astype(np.float32)
    highest = lowest + generator.random((5, 7)).astype(np.float32)
    places, reach = generator.uniform(-12, 12, (50, 2)), generator.uniform(0, 3, 50)
    found = texture_ranges(lowest, highest, tiled, places, reach)
    for (x, y), half, value in zip(places, reach, found, strict=True):
        rows, columns = (np.arange(np.floor(at - half), np.floor(at + half) + 1).astype(int) for at in (y, x))
        rows, columns = (rows % 5, columns % 7) if tiled else (np.clip(rows, 0, 4), np.clip(columns, 0, 6))
        part = np.ix_(rows, columns)
        assert value == float(highest[part].max()) - float(lowest[part].min())
    whole = float(highest.max()) - float(lowest.min())
    assert (texture_ranges(lowest, highest, tiled, places, np.full(50, np.inf)) == whole).all()
