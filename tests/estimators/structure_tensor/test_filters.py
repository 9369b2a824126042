from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from scenetruth.estimators.structure_tensor import (
    DERIVATIVE,
    PAPER,
    SMOOTHING,
    compact_pair,
    gaussian_window,
    least_squares_pair,
    pair_for,
    transfer,
)


@some.composite
def node_lists(draw: some.DrawFn, least: int = 2, most: int = 9) -> list[float]:
    """Return positions that differ by 0.5 to 1.5 steps, with 0 in their middle half."""
    gaps = draw(some.lists(some.floats(0.5, 1.5), min_size=least - 1, max_size=most - 1))
    nodes = np.concatenate([[0.0], np.cumsum(gaps)])
    return [float(node) for node in nodes - nodes.mean()]


def test_filters_reproduce_lines_and_constants() -> None:
    ramp = np.arange(20.0)
    # The derivative of the identity is 1, as far as the coefficients are rounded.
    assert np.convolve(ramp, DERIVATIVE, mode="valid") == pytest.approx(1, abs=1e-12)
    assert SMOOTHING.sum() == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("w", [0.05, 0.4, 1.0, 2.0, 3.0])
def test_transfer_functions_against_filtering_a_wave(w: float) -> None:
    wave = np.exp(1j * w * np.arange(-2, 3))
    derivative, smoothing = transfer(w)
    assert np.dot(DERIVATIVE[::-1], wave) == pytest.approx(1j * derivative, abs=1e-15)
    assert np.dot(SMOOTHING[::-1], wave) == pytest.approx(smoothing, abs=1e-15)
    of_pair = PAPER.transfer(w)
    assert of_pair[0] == pytest.approx(1j * derivative, abs=1e-12)
    assert of_pair[1] == pytest.approx(smoothing, abs=1e-12)


@pytest.mark.parametrize("count", range(2, 13))
def test_every_pair_keeps_constants_and_slopes(count: int) -> None:
    pair = pair_for(1.3 * (np.arange(count) - (count - 1) / 2))
    assert pair.smoothing.sum() == pytest.approx(1, abs=1e-12)
    assert pair.derivative.sum() == pytest.approx(0, abs=1e-12)
    assert pair.derivative @ pair.nodes == pytest.approx(1, abs=1e-12)
    # Symmetric: the estimate belongs to the middle.
    np.testing.assert_allclose(pair.smoothing, pair.smoothing[::-1], atol=1e-9)
    np.testing.assert_allclose(pair.derivative, -pair.derivative[::-1], atol=1e-9)


@pytest.mark.parametrize(
    ("count", "name", "mismatch"),
    [
        # Up to half a pixel per step of a texture of 6 px, w = 0.5; two samples cannot do better than w^2 / 12.
        (2, "compact", 0.022),
        (3, "compact", 4e-4),
        (4, "compact", 1e-5),
        (5, "Scharr", 2e-4),
        (7, "Farid", 6e-4),
        (9, "Farid", 3e-4),
    ],
)
def test_named_pairs_match(count: int, name: str, mismatch: float) -> None:
    pair = pair_for(np.arange(count) - (count - 1) / 2)
    assert name in pair.name
    w = np.linspace(0.02, 0.5, 25)
    derivative, smoothing = pair.transfer(w)
    np.testing.assert_allclose(derivative / (1j * w * smoothing), 1, atol=mismatch)


@given(nodes=node_lists())
def test_compact_pairs_are_exact_for_polynomials(nodes: list[float]) -> None:
    """Σ d f = Σ a f' up to degree 2 n - 2, the order of Hermite interpolation."""
    pair = compact_pair(nodes)
    assert (pair.smoothing > 0).all()
    scale = max(abs(node) for node in nodes)
    u = pair.nodes / scale
    for degree in range(2 * len(nodes) - 1):
        left = scale * np.sum(pair.derivative * u**degree)
        right = np.sum(pair.smoothing * degree * u ** max(degree - 1, 0))
        assert left == pytest.approx(right, abs=1e-8 * max(1.0, float(np.abs(pair.derivative).max() * scale)))


def test_compact_pairs_are_the_classical_ones() -> None:
    np.testing.assert_allclose(compact_pair([-1, 0, 1]).smoothing, [1 / 6, 4 / 6, 1 / 6], atol=1e-15)
    np.testing.assert_allclose(compact_pair([-1, 0, 1]).derivative, [-0.5, 0, 0.5], atol=1e-15)
    # Lele's pentadiagonal scheme of eighth order, 1/36 and 4/9 beside 1, 40/27 and 25/54.
    five = compact_pair([-2, -1, 0, 1, 2])
    np.testing.assert_allclose(five.smoothing / five.smoothing[2], [1 / 36, 4 / 9, 1, 4 / 9, 1 / 36], rtol=1e-12)
    np.testing.assert_allclose(five.derivative[3:] / five.smoothing[2], [40 / 27 / 2, 25 / 54 / 4], rtol=1e-12)


@given(nodes=node_lists(least=3))
def test_least_squares_pairs_match_in_their_band(nodes: list[float]) -> None:
    pair = least_squares_pair(nodes)
    assert pair.smoothing.sum() == pytest.approx(1, abs=1e-9)
    assert pair.smoothing @ pair.nodes == pytest.approx(0, abs=1e-9)
    assert pair.derivative @ pair.nodes == pytest.approx(1, abs=1e-9)
    gap = (nodes[-1] - nodes[0]) / (len(nodes) - 1)
    w = np.linspace(0.02, 0.9, 20) / gap
    derivative, smoothing = pair.transfer(w)
    # Of three samples at unequal distances the conditions leave two weights free.
    assert (np.abs(derivative - 1j * w * smoothing) <= (0.05 if len(nodes) == 3 else 0.02) * w).all()


@given(nodes=node_lists(least=4), scale=some.floats(0.1, 10))
def test_least_squares_pairs_scale_with_their_nodes(nodes: list[float], scale: float) -> None:
    one, other = least_squares_pair(nodes), least_squares_pair(np.array(nodes) * scale)
    np.testing.assert_allclose(other.smoothing, one.smoothing, atol=1e-7)
    np.testing.assert_allclose(other.derivative * scale, one.derivative, atol=1e-7)


def test_least_squares_pair_of_five_lets_less_noise_through_than_the_papers() -> None:
    ours = least_squares_pair(np.arange(5.0) - 2)
    assert np.sum(ours.derivative**2) < 0.5 * np.sum(DERIVATIVE**2)


def test_gaussian_window_is_symmetric_with_unit_sum_and_the_stated_ratio() -> None:
    window = gaussian_window(6.0, 25)
    assert window.sum() == pytest.approx(1, rel=1e-15)
    assert (window == window[::-1]).all()
    assert window[12 + 6] / window[12] == pytest.approx(np.exp(-0.5), rel=1e-14)
