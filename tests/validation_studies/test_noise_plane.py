"""The exact image of a noise plane: its pixel integral, gradient and statistics."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.texture import NoiseTexture
from scenetruth.validation_studies.noise_plane import PlaneImage, noise_plane, reference_image


@pytest.fixture(scope="module")
def exact() -> PlaneImage:
    return reference_image(noise_plane((6.0, 30.0), (50, 75)))


def test_pixel_integral_is_what_64_x_64_samples_of_the_texture_converge_to() -> None:
    # The texture's spline at points laid out from the projection alone: neither the Fourier series nor a renderer.
    scene = noise_plane((1.0, 30.0), (24, 20))
    item = scene.objects[0]
    assert item.mesh.kind == "plane"
    assert isinstance(item.texture, NoiseTexture)
    body = build_scene(scene).bodies[0]
    pitch, n, shift = 660 / 5016, 64, 0.3
    corners = body.vertices_mm[body.faces].reshape(-1, 3)[:, :2]
    design = np.column_stack([corners, np.ones(len(corners))])
    to_uv = np.linalg.lstsq(design, body.uv.reshape(-1, 2), rcond=None)[0]
    x, y = ((np.arange(side * n) + 0.5) / n - side / 2 for side in (20, 24))
    across, down = np.meshgrid((x - shift) * pitch, y * pitch)
    uv = np.column_stack([across.ravel(), down.ravel(), np.ones(across.size)]) @ to_uv
    samples = body.texture.radiance(uv).reshape(24, n, 20, n).mean(axis=(1, 3), dtype=np.float64)
    std = item.texture.mean * item.texture.rms_contrast
    # Midpoints amplify a wave of 1 px by (π/64)² / 6 = 4e-4, the spline of 16 points a wavelength errs by 1e-4 or less.
    assert np.abs(samples - reference_image(scene).values(shift)).max() < 5e-4 * std


def footprint_mean(exact: PlaneImage, shift_px: float, down_px: float = 0.0) -> NDArray[np.float64]:
    """Average points of footprints moved down, by Gauss's rule: exact to rounding for waves from 6 px."""
    steps, weights = np.polynomial.legendre.leggauss(8)
    parts = [
        a * b / 4 * exact.points(shift_px, (u / 2, v / 2 + down_px))
        for u, a in zip(steps, weights, strict=True)
        for v, b in zip(steps, weights, strict=True)
    ]
    return np.asarray(np.sum(parts, axis=0))


def test_points_average_to_the_pixel_integral(exact: PlaneImage) -> None:
    np.testing.assert_allclose(exact.values(0.4), footprint_mean(exact, 0.4), atol=1e-13)


def test_gradient_is_the_derivative_of_the_pixel_integral(exact: PlaneImage) -> None:
    h = 1e-4
    across, down = exact.gradient(0.2)
    # Central differences leave h² / 6 times the third derivative, below 1e-8.
    np.testing.assert_allclose(across, (exact.values(0.2 - h) - exact.values(0.2 + h)) / (2 * h), atol=1e-8)
    difference = footprint_mean(exact, 0.2, h) - footprint_mean(exact, 0.2, -h)
    np.testing.assert_allclose(down, difference / (2 * h), atol=1e-8)


def test_mean_and_spread_are_those_of_the_scene(exact: PlaneImage) -> None:
    values = exact.points()
    assert values.mean() == pytest.approx(0.5, abs=0.02)
    assert values.std() == pytest.approx(0.125, rel=0.1)
