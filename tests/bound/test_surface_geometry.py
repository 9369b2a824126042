"""Principal growth as functions of a window's parameters: against derivatives of eigenvalues, and Rice's mean."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from scenetruth.bound.surface_geometry import ReferencePoints
from scenetruth.bound.unknowns import WindowUnknowns, add_error_products, compute_eigenvalue_bias, compute_functionals
from scenetruth.schema import Intrinsics

FOCAL, X, Y = 900.0, 130.0, -80.0
CAMERA = Intrinsics(focal_length_px=FOCAL, principal_point_px=(0.0, 0.0), baseline_mm=2.0)


def points_of(theta: np.ndarray) -> ReferencePoints:
    """One pixel's surface and motion: disparity, then q_X, q_Y, q_Z, each with its slopes along x and y."""
    value = theta.reshape(4, 3)[:, :, None]
    fields = (value[0, 0], value[0, 1], value[0, 2], value[1:, 0], value[1:, 1], value[1:, 2])
    return ReferencePoints(np.array([X]), np.array([Y]), *fields, FOCAL)


def growths(theta: np.ndarray) -> np.ndarray:
    """The larger and the lesser growth of length: eigenvalues of ½ dg/dt in the metric g."""
    points = points_of(theta)
    p = np.stack(points.tangents())[..., 0]
    q = np.stack([points.q_x, points.q_y])[..., 0]
    metric, mixed = p @ p.T, p @ q.T
    return np.sort(np.linalg.eigvals(np.linalg.solve(metric, 0.5 * (mixed + mixed.T))).real)[::-1]


@settings(deadline=None, max_examples=30)
@given(seed=some.integers(0, 10_000))
def test_derivatives_are_those_of_the_eigenvalues(seed: int) -> None:
    """Differences of second order with steps of 1e-6 are exact to about 1e-8 of the largest."""
    draw = np.random.default_rng(seed)
    scale = np.array([0.0, 2e-3, 2e-3, 0.1, 2e-3, 2e-3, 0.1, 2e-3, 2e-3, 0.1, 2e-3, 2e-3])
    theta = scale * draw.normal(size=12)
    theta[0] = 8.0
    found = compute_functionals(points_of(theta), CAMERA, WindowUnknowns("plane", "affine", moving=True, brightness=0))
    apart = float(np.diff(growths(theta))[0])
    if abs(apart) < 1e-3:
        return
    steps = np.diag(1e-6 * np.array([8.0, *[8.0 / FOCAL] * 2, *[1.0, 8.0 / FOCAL, 8.0 / FOCAL] * 3]))
    by_theta = np.array([(growths(theta + e) - growths(theta - e)) / (2 * e.sum()) for e in steps])
    told = np.zeros((2, 12))
    for k in range(2):
        for place, share in found[f"principal_growth_rates.{k}"]:
            told[k, place] += float(np.asarray(share).item())
    area = np.zeros(12)
    for place, share in found["growth_rate"]:
        area[place] += float(np.asarray(share).item())
    # Each parameter in its own unit, so that all weigh alike.
    unit = steps.sum(axis=0)
    largest = np.abs(by_theta * unit[:, None]).max()
    np.testing.assert_allclose(told * unit, by_theta.T * unit, atol=1e-5 * largest)
    np.testing.assert_allclose(area * unit, by_theta.sum(axis=1) * unit, atol=1e-5 * largest)


def test_noise_pushes_growths_apart() -> None:
    """Against the mean of 200,000 draws (0.3 % of the noise), and both limits of the formula."""
    draw = np.random.default_rng(5).normal(0.0, 2.0, (2, 200_000))
    for half in (0.0, 1.0, 3.0, 9.0):
        drawn = np.hypot(half + draw[0], draw[1]).mean() - half
        told = compute_eigenvalue_bias(np.array([half]), np.array([2.0]), np.array([2.0]))
        assert told[0] == pytest.approx(drawn, abs=0.02)
    none, far = compute_eigenvalue_bias(np.array([0.0, 200.0]), np.array([2.0, 2.0]), np.array([2.0, 2.0]))
    assert none == pytest.approx(2.0 * np.sqrt(np.pi / 2))
    assert far == pytest.approx(4.0 / 400.0, rel=1e-3)


def test_errors_of_inclination_and_turn_multiply() -> None:
    """Scatter of the growth of length where both are noisy, against 400,000 draws: variances of products add up."""
    tilt, turn = 0.07, 0.03
    std = {"growth_rate": 0.0, "growth_apart": 0.0, "growth_shear": 0.0, "principal_growth_rates.0": 1e-3}
    std |= {"principal_growth_rates.1": 0.0, "growth_tilt.0": tilt, "growth_tilt.1": 0.0, "growth_turn.0": turn}
    told = add_error_products({name: np.array([value]) for name, value in (std | {"growth_turn.1": 0.0}).items()})
    a, b, c = np.random.default_rng(6).normal(size=(3, 400_000))
    assert told["principal_growth_rates.0"][0] == pytest.approx(np.std(1e-3 * a + tilt * turn * b * c), rel=0.01)
    assert told["principal_growth_rates.1"][0] == 0
    assert not any(name.startswith(("growth_tilt", "growth_turn")) for name in told)
