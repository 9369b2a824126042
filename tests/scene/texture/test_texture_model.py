"""Mean radiance over footprints against the radiance at every sample."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from scenetruth.scene.mesh import TriangleMesh, make_plane
from scenetruth.scene.scene_object import Texture
from scenetruth.scene.texture import NoiseTexture, PlaidTexture, SurfaceTexture, UniformTexture
from scenetruth.scene.texture.image_textures import EmbeddedTexture
from scenetruth.scene.texture.texture_kernels import linear_lookup, spline_lookup


def made(kind: str) -> SurfaceTexture:
    generator = np.random.default_rng(5)
    mesh = make_plane((20, 30))
    if kind == "ramp":
        colours = generator.integers(0, 256, (len(mesh.vertices_mm), 3), dtype=np.uint8)
        mesh = TriangleMesh(mesh.vertices_mm, mesh.faces, mesh.chart_mm, vertex_colours=colours)
        return EmbeddedTexture(kind="embedded").paint(mesh, Path(), generator)[0]
    if kind in ("image", "bordered"):
        picture = generator.random((9, 14, 3)).astype(np.float32)
        mesh = TriangleMesh(
            mesh.vertices_mm, mesh.faces, mesh.chart_mm, uv=mesh.uv, image=picture, tiled=kind == "image"
        )
        return EmbeddedTexture(kind="embedded").paint(mesh, Path(), generator)[0]
    entries: dict[str, Texture] = {
        "noise": NoiseTexture(kind="noise", wavelength_mm=(3.0, 9.0)),
        "plaid": PlaidTexture(kind="plaid", wavelength_mm=(4.0, 5.0)),
        "uniform": UniformTexture(kind="uniform", radiance=0.3),
    }
    return entries[kind].paint(mesh, Path(), generator)[0]


def footprints(count: int) -> NDArray[np.float64]:
    """Return forms whose denominators change over the footprint, with coordinates within a tile and far outside."""
    generator = np.random.default_rng(8)
    forms = np.empty((count, 3, 3))
    depth = generator.uniform(0.5, 2, count) * generator.choice([-1, 1], count)
    forms[:, :2, 0] = generator.uniform(-2.5, 2.5, (count, 2)) * depth[:, None]
    forms[:, :2, 1:] = generator.normal(size=(count, 2, 2)) * 0.05
    forms[:, 2, 0] = depth
    forms[:, 2, 1:] = generator.normal(size=(count, 2)) * 0.05
    return forms


@pytest.mark.parametrize("kind", ["noise", "plaid", "uniform", "image", "bordered", "ramp"])
@pytest.mark.parametrize("samples", [1, 3])
def test_means_are_those_of_all_samples(kind: str, samples: int) -> None:
    texture = made(kind)
    steps = (np.arange(samples) + 0.5) / samples - 0.5
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    weights = np.random.default_rng(3).uniform(0.5, 1.5, len(offsets))
    weights /= weights.sum()
    forms = footprints(700)
    values = np.einsum("nij,mj->nmi", forms, np.column_stack([np.ones(len(offsets)), offsets]))
    uv = values[..., :2] / values[..., 2:]
    expected = texture.radiance(uv.reshape(-1, 2)).reshape(len(forms), -1) @ weights
    found = texture.mean_radiance(forms, offsets, weights)
    assert found.dtype == np.float32
    # Two roundings to float32 of values below 1, and float32 arithmetic of the spline.
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert kind == "uniform" or np.ptp(found) > 0.05


def test_spline_lookup_is_scipys_periodic_spline() -> None:
    generator = np.random.default_rng(1)
    coefficients = generator.normal(size=(11, 17)).astype(np.float32)
    uv = generator.uniform(-1.5, 2.5, (500, 2))
    at = np.stack([uv[:, 1] * 11 - 0.5, uv[:, 0] * 17 - 0.5])
    expected = map_coordinates(coefficients.astype(np.float64), at, order=3, mode="grid-wrap", prefilter=False)
    # Sixteen products of float32.
    np.testing.assert_allclose(spline_lookup(coefficients, uv), expected, atol=5e-6)


@pytest.mark.parametrize(("tiled", "mode"), [(True, "grid-wrap"), (False, "nearest")])
def test_linear_lookup_is_scipys(tiled: bool, mode: str) -> None:
    generator = np.random.default_rng(2)
    values = generator.random((11, 17)).astype(np.float32)
    uv = generator.uniform(-1.5, 2.5, (500, 2))
    at = np.stack([uv[:, 1] * 11 - 0.5, uv[:, 0] * 17 - 0.5])
    expected = map_coordinates(values.astype(np.float64), at, order=1, mode=mode, prefilter=False)
    np.testing.assert_allclose(linear_lookup(values, uv, tiled), expected, atol=1e-6)
