"""Exact means of bilinear textures over pixels, against closed forms and many samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

from scenetruth.render.bilinear_mean_kernels import MOST_TEXELS, bilinear_means
from scenetruth.render.sampling_rules import even_rule, square_rule
from scenetruth.scene.texture import Picture

SHAPE = (40, 50)


def footprints(seed: int, step: float, perspective: float) -> NDArray[np.float64]:
    """Return forms of 60 footprints at random places, some of them beyond the texture."""
    generator = np.random.default_rng(seed)
    forms = np.zeros((60, 3, 3))
    forms[:, :2, 0] = generator.uniform(-0.2, 1.2, (60, 2))
    forms[:, :2, 1:] = generator.standard_normal((60, 2, 2)) * step / np.array([SHAPE[1], SHAPE[0]])[:, None]
    forms[:, 2, 0], forms[:, 2, 1:] = 1.0, generator.uniform(-0.5, 0.5, (60, 2)) * perspective
    # The sign of all forms is arbitrary.
    forms[::2] *= -1
    return forms


@pytest.mark.parametrize("tiled", [True, False])
@given(seed=some.integers(0, 1000), step=some.sampled_from([0.03, 0.4, 1.0, 3.0]))
@settings(max_examples=8, deadline=None)
def test_means_agree_with_many_samples(tiled: bool, seed: int, step: float) -> None:
    texture = Picture(np.random.default_rng(seed).random(SHAPE).astype(np.float32), tiled)
    forms = footprints(seed, step, 1e-3)
    done, means = bilinear_means(texture.values, tiled, forms)
    assert done.all()
    count = 64
    samples = texture.mean_radiance(forms, *square_rule(*even_rule(count)))
    # Bends of the texture and their samples, see `_bend_errors`; the change of the depth acts on the last term.
    slope = step * np.sqrt(max(step, 1.0))
    assert np.sqrt(np.mean((means - samples) ** 2)) < 3 * slope / (21 * count**2) + 1e-3 * 0.05 * slope + 1e-6


def test_means_of_an_axis_parallel_footprint_follow_from_sums() -> None:
    """Squares of whole texels, without rotation: sums of texels with weights of the trapezoidal rule."""
    values = np.random.default_rng(5).random(SHAPE).astype(np.float32)
    forms = np.zeros((1, 3, 3))
    forms[0, 0], forms[0, 1], forms[0, 2] = [20 / 50, 6 / 50, 0], [15 / 40, 0, 4 / 40], [1, 0, 0]
    done, means = bilinear_means(values, False, forms)
    # From 17 to 23 columns and 13 to 17 rows, in coordinates with texel centres at half integers.
    across = np.array([0.125, 0.875, 1, 1, 1, 1, 0.875, 0.125])
    down = np.array([0.125, 0.875, 1, 1, 0.875, 0.125])
    expected = down @ values[12:18, 16:24].astype(np.float64) @ across / 24
    assert done.all()
    assert means[0] == pytest.approx(expected, abs=1e-7)


@given(seed=some.integers(0, 1000), turn=some.floats(0, 6.3), u=some.floats(0.2, 0.8), v=some.floats(0.2, 0.8))
@settings(max_examples=20, deadline=None)
def test_means_of_a_linear_texture_are_its_value_at_the_centre(seed: int, turn: float, u: float, v: float) -> None:
    x, y = np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0]))
    across, down = np.random.default_rng(seed).uniform(-0.01, 0.01, 2)
    forms = np.zeros((1, 3, 3))
    sine, cosine = 1.7 * np.sin(turn), 1.7 * np.cos(turn)
    forms[0] = [[u, cosine / 50, sine / 50], [v, -sine / 40, cosine / 40], [1, 0, 0]]
    values = (0.5 + across * x + down * y).astype(np.float32)
    done, means = bilinear_means(values, False, forms)
    assert done.all()
    assert means[0] == pytest.approx(0.5 + across * (u * 50 - 0.5) + down * (v * 40 - 0.5), abs=1e-6)


def test_wide_thin_and_grazing_footprints_are_left_out() -> None:
    values = np.ones(SHAPE, dtype=np.float32)
    forms = footprints(1, 0.5, 0.0)[:4]
    forms[0, 0, 1] = (MOST_TEXELS + 1) / SHAPE[1] * forms[0, 2, 0]
    forms[1, :2, 2] = forms[1, :2, 1]
    forms[2, 2, 1] = 0.1 * forms[2, 2, 0]
    done, means = bilinear_means(values, True, forms)
    assert done.tolist() == [False, False, False, True]
    assert means[3] == pytest.approx(1.0, abs=1e-6)
