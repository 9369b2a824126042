"""Mean radiance over footprints against the radiance at every sample."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.scene.mesh import MeshAppearance, TriangleMesh, make_plane
from scenetruth.scene.scene_object import Texture
from scenetruth.scene.texture import (
    EmbeddedTexture,
    NoiseTexture,
    Picture,
    PlaidTexture,
    SurfaceTexture,
    UniformTexture,
)


def appearance(mesh: TriangleMesh, colours: NDArray[np.float64]) -> MeshAppearance:
    return MeshAppearance(colours, None, (), np.full(len(mesh.faces), -1), None)


def made(kind: str) -> SurfaceTexture:
    generator = np.random.default_rng(5)
    mesh = make_plane((20, 30))
    if kind == "ramp":
        colours = generator.random((len(mesh.faces), 3, 3))
        return EmbeddedTexture(kind="embedded").paint(replace(mesh, appearance=appearance(mesh, colours)), Path(),
                                                      generator)[0]  # fmt: skip
    if kind in ("image", "bordered"):
        return Picture(generator.random((9, 14)).astype(np.float32), tiled=kind == "image")
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
