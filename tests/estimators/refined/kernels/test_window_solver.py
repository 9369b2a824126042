"""What a surface element is and does: the kernel beside differential geometry, and estimates beside analysis."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import scenetruth
from scenetruth.estimators.refined.kernels.window_solver import FUNCTIONALS, VALUES, describe_element
from tests.helpers.curved_surface import curved
from tests.helpers.nightly import by_night, nightly
from tests.helpers.wavy_plane import MovingPlane, turning

Array = NDArray[np.float64]
FOCAL = 300.0
MONOMIALS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))


def described(theta: Array, x: float, y: float, surface: int = 6, gradient: int = 3) -> tuple[Array, Array]:
    values, gradients = np.empty(VALUES), np.empty((FUNCTIONALS, 15))
    describe_element(surface, gradient, theta, x, y, FOCAL, values, gradients)
    return values, gradients


def points(theta: Array, x: float, y: float, across: Array, down: Array) -> Array:
    """Return the surface around a pixel in baselines, shape (3, ...)."""
    monomials = np.array([across**j * down**k for j, k in MONOMIALS])
    d = np.tensordot(theta[:6], monomials, 1)
    return np.asarray(np.stack([x + across, y + down, np.full_like(across, FOCAL)]) / d)


def principal_curvatures(theta: Array, x: float, y: float) -> Array:
    """Return both by a paraboloid over the tangent plane, fitted to points of the surface; the larger first."""
    span = np.linspace(-0.5, 0.5, 9)
    across, down = np.meshgrid(span, span)
    around = points(theta, x, y, across, down).reshape(3, -1)
    middle = points(theta, x, y, np.zeros(()), np.zeros(()))
    step = 1e-4
    sides = [
        points(theta, x, y, np.array(step * a), np.array(step * b))
        - points(theta, x, y, np.array(-step * a), np.array(-step * b))
        for a, b in ((1, 0), (0, 1))
    ]
    normal = np.cross(sides[0], sides[1])
    normal *= -np.sign(normal @ middle) / np.linalg.norm(normal)
    basis = np.linalg.qr(np.stack([normal, *sides], axis=1))[0][:, 1:]
    u, v = basis.T @ (around - middle[:, None])
    height = normal @ (around - middle[:, None])
    terms = [u**j * v**k for j in range(5) for k in range(5 - j) if j + k]
    powers = [(j, k) for j in range(5) for k in range(5 - j) if j + k]
    scale = np.array([np.abs(term).max() for term in terms])
    found = np.linalg.lstsq(np.array(terms).T / scale, height, rcond=None)[0] / scale
    at = dict(zip(powers, found, strict=True))
    # A surface that bulges falls away from its tangent plane.
    hessian = -np.array([[2 * at[2, 0], at[1, 1]], [at[1, 1], 2 * at[0, 2]]])
    return np.linalg.eigvalsh(hessian)[::-1]


def drawn(seed: int) -> tuple[Array, float, float, Array]:
    """Return a curved surface that moves with a random gradient: parameters, pixel and gradient."""
    generator = np.random.default_rng(seed)
    x, y = generator.uniform(-60, 60, 2)
    theta = np.zeros(15)
    theta[:6] = [6.0, *generator.uniform(-0.02, 0.02, 2), *generator.uniform(-1e-3, 1e-3, 3)]
    gradient = generator.uniform(-0.01, 0.01, (3, 3))
    h = 1e-3
    for side, (a, b) in enumerate(((h, 0.0), (0.0, h))):
        tangent = points(theta, x, y, np.array(a), np.array(b)) - points(theta, x, y, np.array(-a), np.array(-b))
        theta[[7 + side, 10 + side, 13 + side]] = gradient @ tangent / (2 * h)
    return theta, float(x), float(y), gradient


@given(st.integers(0, 10_000))
def test_curvatures_are_those_of_paraboloids(seed: int) -> None:
    theta, x, y, _ = drawn(seed)
    values, _ = described(theta, x, y)
    largest, least = principal_curvatures(theta, x, y)
    # Fits of fourth order over half a pixel.
    scale = max(abs(largest), abs(least))
    assert values[2] == pytest.approx(0.5 * (largest + least), abs=1e-5 * scale)
    assert values[3] == pytest.approx(largest * least, abs=2e-5 * scale**2)


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (20.0, -15.0)])
@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
def test_curvature_of_a_sphere_and_of_a_cylinder(kind: str, x: float, y: float) -> None:
    """1 / R and 1 / R² of a sphere in front, 1 / 2 R and 0 of a cylinder, from exact disparities by differences."""
    radius, centre = 8.0, np.array([0.4, -0.2, 60.0])

    def disparity(across: float, down: float) -> float:
        ray = np.array([x + across, y + down, FOCAL])
        free = np.array([1.0, 1.0 if kind == "sphere" else 0.0, 1.0])
        # Nearer of both places where the ray meets the body; p = (x, y, f) / d.
        square, along, rest = free * ray @ ray, free * ray @ centre, free * centre @ centre - radius**2
        return float(square / (along - np.sqrt(along**2 - square * rest)))

    h = 0.02
    theta = np.zeros(15)
    theta[0] = disparity(0, 0)
    theta[1] = (disparity(h, 0) - disparity(-h, 0)) / (2 * h)
    theta[2] = (disparity(0, h) - disparity(0, -h)) / (2 * h)
    theta[3] = (disparity(h, 0) - 2 * theta[0] + disparity(-h, 0)) / (2 * h**2)
    theta[5] = (disparity(0, h) - 2 * theta[0] + disparity(0, -h)) / (2 * h**2)
    corners = [disparity(h, h), disparity(h, -h), disparity(-h, h), disparity(-h, -h)]
    theta[4] = (corners[0] - corners[1] - corners[2] + corners[3]) / (4 * h**2)
    values, _ = described(theta, x, y, gradient=0)
    expected = (1 / radius, 1 / radius**2) if kind == "sphere" else (0.5 / radius, 0.0)
    # Differences over 0.02 px err by the fourth order and by rounding of 1e-15 over h².
    np.testing.assert_allclose(values[2:4], expected, rtol=1e-5, atol=1e-6)
    assert np.isnan(values[4:]).all()


@given(st.integers(0, 10_000))
def test_slopes_rotation_and_growth_are_those_of_a_moved_element(seed: int) -> None:
    theta, x, y, gradient = drawn(seed)
    values, _ = described(theta, x, y)
    h = 1e-3
    tangents = np.stack(
        [
            points(theta, x, y, np.array(a), np.array(b)) - points(theta, x, y, np.array(-a), np.array(-b))
            for a, b in ((h, 0.0), (0.0, h))
        ],
        axis=1,
    )
    basis = np.linalg.qr(tangents)[0]
    normal = np.cross(*basis.T)
    np.testing.assert_allclose(values[:2], -normal[:2] / normal[2], atol=1e-7)
    inner = basis.T @ gradient @ basis
    rates, ways = np.linalg.eigh(0.5 * (inner + inner.T))
    np.testing.assert_allclose(values[8:10], rates[::-1], atol=1e-8)
    assert values[7] == pytest.approx(np.trace(inner), abs=1e-8)
    assert abs(values[10:] @ basis @ ways[:, 1]) == pytest.approx(1.0, abs=1e-6)
    # The normal turns with the moved tangents, and the element about it by half of the curl.
    k = 1e-5
    turned = [np.cross(*((np.eye(3) + sign * k * gradient) @ basis).T) for sign in (1, -1)]
    rate = (turned[0] / np.linalg.norm(turned[0]) - turned[1] / np.linalg.norm(turned[1])) / (2 * k)
    spin = 0.5 * (inner[1, 0] - inner[0, 1])
    np.testing.assert_allclose(values[4:7], np.cross(normal, rate) + spin * normal, atol=1e-8)


@given(st.integers(0, 10_000))
def test_a_rotation_is_found_whatever_the_surface(seed: int) -> None:
    theta, x, y, _ = drawn(seed)
    axis = np.random.default_rng(seed).uniform(-0.01, 0.01, 3)
    h = 1e-3
    for side, (a, b) in enumerate(((h, 0.0), (0.0, h))):
        tangent = points(theta, x, y, np.array(a), np.array(b)) - points(theta, x, y, np.array(-a), np.array(-b))
        theta[[7 + side, 10 + side, 13 + side]] = turning(*axis) @ tangent / (2 * h)
    values, _ = described(theta, x, y)
    np.testing.assert_allclose(values[4:7], axis, atol=1e-9)
    np.testing.assert_allclose(values[7:10], 0.0, atol=1e-9)


@given(st.integers(0, 10_000))
def test_derivatives_are_those_of_the_values(seed: int) -> None:
    """By differences; where velocity's slopes are what is fitted, those of the surface change them along."""
    theta, x, y, _ = drawn(seed)
    values, gradients = described(theta, x, y)
    steps = np.array([1e-5, *[1e-7] * 2, *[1e-8] * 3, *[1e-6] * 9])
    expected = np.zeros_like(gradients)
    second = np.cross(np.cross(*tangents(theta, x, y)), values[10:])
    second /= np.linalg.norm(second)
    for p, step in enumerate(steps):
        change = np.zeros(15)
        change[p] = step
        after, before = (described(theta + sign * change, x, y)[0] for sign in (1, -1))
        expected[:10, p] = (after[:10] - before[:10]) / (2 * step)
        # Either sign of a direction is the same.
        ways = [way * np.sign(way @ values[10:]) for way in (after[10:], before[10:])]
        expected[10, p] = second @ (ways[0] - ways[1]) / (2 * step)
    scale = np.abs(expected).max(axis=1, keepdims=True)
    # Close to equal growth in all directions, a direction changes faster than its differences.
    blunt = 1e-5 + 1e-9 / (values[8] - values[9]) ** 2
    np.testing.assert_allclose(gradients / scale, expected / scale, atol=blunt)
    bound = described(theta, x, y, gradient=2)[1]
    assert (bound[4:, :6] == 0).all()
    np.testing.assert_array_equal(bound[4:8, 6:], gradients[4:8, 6:])


def tangents(theta: Array, x: float, y: float) -> tuple[Array, Array]:
    h = 1e-3
    first, second = (
        points(theta, x, y, np.array(a), np.array(b)) - points(theta, x, y, np.array(-a), np.array(-b))
        for a, b in ((h, 0.0), (0.0, h))
    )
    return first, second


INSIDE = {"y": slice(14, -14), "x": slice(34, -34)}


def test_growth_along_two_directions_is_found_in_images() -> None:
    """A tilted plane that turns and grows by 4e-3 along one direction and shrinks by 1e-3 along the other."""
    normal = np.array([0.3, -0.2, -1.0])
    first = np.cross(normal, [0.2, 1.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    second /= np.linalg.norm(second)
    spin = (2e-3, -1e-3, 3e-3)
    gradient = 4e-3 * np.outer(first, first) - 1e-3 * np.outer(second, second) + turning(*spin)
    plane = MovingPlane(gradient=gradient)
    # Without noise, fewer frames would be significantly better.
    settings = {"window_sigma_px": 4, "motion": "affine", "surface": "plane", "acceleration": False}
    found = scenetruth.estimate(plane.recording(), "refined", settings)
    inside = found.sel(t=0).isel(INSIDE)
    # 1e-4 px over a window of 4 px and four frames are 6e-6 per frame; directions follow from rates 5e-3 apart.
    rates = inside["principal_growth_rates"].values - np.reshape([4e-3, -1e-3], (2, 1, 1))
    assert np.abs(rates).max() < 1e-4
    along = np.abs(np.einsum("k,kyx->yx", first, inside["principal_growth_direction"].values))
    assert np.degrees(np.arccos(np.minimum(along, 1.0))).max() < 2.0
    assert (inside["principal_growth_direction"].values[0] >= 0).all()
    turned = inside["rotation_rate"].values - np.reshape(spin, (3, 1, 1))
    assert np.abs(turned).max() < 2e-4
    assert (inside["surface_model"] == 2).all()
    assert (inside["image_count"] == 45).all()


@nightly
def test_error_bars_of_the_element_are_those_of_its_errors() -> None:
    """White noise, as in the tests of the plane: some 20 windows that share none, ten quantities and two seeds.

    So little noise that products of errors, of slopes and of velocities, are small beside the errors themselves.
    """
    spin, stretch = np.array([4e-3, -3e-3, 5e-3]), np.diag([6e-3, -4e-3, 0.0])
    ratios: dict[str, list[Array]] = {}
    for seed in (1, 2):
        plane = MovingPlane(slopes=(0.0, 0.0), gradient=turning(*spin) + stretch, seed=seed, size=(96, 128))
        recording = plane.recording(noise_std=0.002, seed=seed)
        found = scenetruth.estimate(
            recording, "refined", window_sigma_px=4, discontinuity_refit=False, motion="affine", surface="plane"
        ).sel(t=0)
        inside = found.isel(INSIDE)
        right = {
            "slope": np.zeros((2, 1, 1)),
            "rotation_rate": spin.reshape(3, 1, 1),
            "growth_rate": np.array(2e-3),
            "principal_growth_rates": np.reshape([6e-3, -4e-3], (2, 1, 1)),
        }
        for name, exact in right.items():
            ratios.setdefault(name, []).append(((inside[name] - exact) / inside[f"{name}_std"]).values)
        way = inside["principal_growth_direction"].values
        angle = np.arctan2(way[1], way[0]) / inside["principal_growth_direction_std"].values
        ratios.setdefault("principal_growth_direction", []).append(angle)
    for name, each in ratios.items():
        # 40 windows and two or three components; of one component, the root mean square scatters by 11 %.
        assert np.sqrt(np.mean(np.square(each))) == pytest.approx(1.0, abs=0.3), name
    every = np.concatenate([np.ravel(each) for each in ratios.values()])
    assert np.sqrt(np.mean(every**2)) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("surface", ["auto", "plane", *by_night("curved")])
def test_curvature_is_found_in_images(surface: str) -> None:
    """Disparity 8 + c x² / 2: along X the plane curve p = (x, f) / d, whose curvature is (p_x × p_xx) / |p_x|³."""
    recording, disparity = curved(-4e-3, 0.003)
    found = scenetruth.estimate(recording, "refined", window_sigma_px=5, surface=surface).isel(t=0)
    if surface == "plane":
        assert "mean_curvature" not in found
        assert (found["surface_model"].isel(INSIDE) == 2).all()
        return
    inside = found.isel(INSIDE)
    x = np.arange(disparity.shape[1]) - (disparity.shape[1] - 1) / 2
    d, d_x, focal, baseline = disparity[0], -4e-3 * x, 1000.0, 4.0
    first = np.stack([d - x * d_x, -focal * d_x]) / d**2
    own = 2 * d_x**2 / d**3 + 4e-3 / d**2
    bend = np.stack([x * own - 2 * d_x / d**2, focal * own])
    size = np.linalg.norm(first, axis=0)
    along = (first[0] * bend[1] - first[1] * bend[0]) / size**3 / baseline
    # It bulges: depth is least in the middle. Across, lines through the camera's centre are straight.
    expected = 0.5 * along[INSIDE["x"]]
    assert (expected > 0).all()
    known = np.isfinite(inside["mean_curvature"].values)
    assert ((inside["surface_model"].values == 3) == known).all()
    assert known.mean() > 0.95
    ratio = ((inside["mean_curvature"] - expected) / inside["mean_curvature_std"]).values[known]
    # Windows of 5 px in 44 x 52 px: some 30 independent numbers.
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.35)
    sure = known & (expected > 5 * inside["mean_curvature_std"].values)
    assert sure.mean() > 0.2
    assert np.median(np.abs(inside["mean_curvature"].values / expected - 1)[sure]) < 0.1
    # Lines through the camera's centre are straight.
    flat = (inside["gaussian_curvature"] / inside["gaussian_curvature_std"]).values[known]
    assert np.sqrt(np.mean(flat**2)) < 1.5


def test_where_the_plane_is_taken_no_curvature_is_told() -> None:
    recording, _ = curved(0.0, 0.01)
    found = scenetruth.estimate(recording, "refined", window_sigma_px=5).isel({"t": 0, **INSIDE})
    flat, valid = found["surface_model"].values == 2, found["valid"].values
    assert flat.mean() > 0.8
    assert valid.mean() > 0.99
    for name in ("mean_curvature", "gaussian_curvature_std"):
        np.testing.assert_array_equal(np.isnan(found[name].values), flat | ~valid)


def test_a_baseline_to_the_left_changes_nothing() -> None:
    """The same images, with cameras counted from the other side."""
    recording, _ = curved(-4e-3, 0.01)
    mirrored = recording.isel(s=slice(None, None, -1))
    mirrored = mirrored.assign_coords(s=recording["s"], stage_x_mm=mirrored["stage_x_mm"].variable)
    mirrored = mirrored.assign_attrs(baseline_mm=-recording.attrs["baseline_mm"])
    one, other = (
        scenetruth.estimate(each, "refined", window_sigma_px=5, surface="curved", discontinuity_refit=False).isel(
            {"t": 0, **INSIDE}
        )
        for each in (recording, mirrored)
    )
    for name in ("depth", "mean_curvature", "mean_curvature_std", "gaussian_curvature", "gaussian_curvature_std"):
        np.testing.assert_allclose(one[name], other[name], rtol=1e-3, atol=1e-6)
