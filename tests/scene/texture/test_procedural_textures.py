"""Checkerboards against their definition: the parity of squares, and the mean of footprints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.errors import SceneWarning
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.mesh import make_plane
from scenetruth.scene.scene_report import check_scene
from scenetruth.scene.texture import CheckerboardTexture, Painted
from tests.helpers.scenes import cube

SQUARE, DARK, BRIGHT = 3.0, 0.2, 0.7
ENTRY = CheckerboardTexture(kind="checkerboard", square_mm=SQUARE, radiances=(DARK, BRIGHT))


def painted() -> Painted:
    return ENTRY.paint(make_plane((40, 30)), Path(), np.random.default_rng(0))


def parity(places_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(np.floor(places_mm / SQUARE).sum(axis=1) % 2 == 0, DARK, BRIGHT)


def test_squares_stand_where_they_should() -> None:
    places = np.random.default_rng(1).uniform(-20, 20, (5000, 2))
    inside = (np.abs(places / SQUARE - np.rint(places / SQUARE)) > 1 / 256).all(axis=1)
    texture = painted().texture
    found = texture.radiance(places / (2 * SQUARE))
    np.testing.assert_allclose(found[inside], parity(places)[inside], atol=1e-6)
    assert inside.mean() > 0.95
    assert texture.tiled
    # Half-way on every border and on every corner of squares.
    borders = np.array([[0.0, 1.0], [SQUARE, 1.0], [1.0, -SQUARE], [0.0, 0.0], [SQUARE, 2 * SQUARE]])
    np.testing.assert_allclose(texture.radiance(borders / (2 * SQUARE)), (DARK + BRIGHT) / 2, atol=1e-6)


def test_texture_coordinates_are_places_on_the_surface() -> None:
    mesh = make_plane((40, 30))
    np.testing.assert_allclose(painted().uv * 2 * SQUARE, mesh.chart_mm, rtol=1e-14)
    assert painted().uv_back is None


@pytest.mark.parametrize(("width_mm", "tolerance"), [(0.5, 2e-3), (SQUARE, 2e-3), (2 * SQUARE, 2e-3)])
def test_means_of_footprints_are_shares_of_the_squares(width_mm: float, tolerance: float) -> None:
    """A square footprint about a corner or across a border; one that covers a whole period has the mean."""
    steps = (np.arange(64) + 0.5) / 64 - 0.5
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    weights = np.full(len(offsets), 1 / len(offsets))
    middles = np.random.default_rng(2).uniform(-10, 10, (200, 2))
    forms = np.zeros((len(middles), 3, 3))
    forms[:, :2, 0] = middles / (2 * SQUARE)
    forms[:, 0, 1] = forms[:, 1, 2] = width_mm / (2 * SQUARE)
    forms[:, 2, 0] = 1
    found = painted().texture.mean_radiance(forms, offsets, weights)
    # The signs +1 and -1 of columns and rows multiply: the mean is that of one times that of the other.
    signs = np.prod([_mean_sign(middles[:, k], width_mm) for k in range(2)], axis=0)
    expected = (DARK + BRIGHT) / 2 + (DARK - BRIGHT) / 2 * signs
    # Samples every 1/64 of the footprint, at most four borders in it.
    np.testing.assert_allclose(found, expected, atol=(BRIGHT - DARK) * 4 / 64)
    assert abs(float(np.mean(found - expected))) < tolerance
    if width_mm == 2 * SQUARE:
        np.testing.assert_allclose(found, (DARK + BRIGHT) / 2, atol=1e-3)


def _mean_sign(middle: NDArray[np.float64], width: float) -> Any:
    """The mean of a square wave of period two squares over an interval, from its integral, a triangle wave."""
    upper, lower = (SQUARE - np.abs(np.mod(middle + sign * width / 2, 2 * SQUARE) - SQUARE) for sign in (1, -1))
    return (upper - lower) / width


def test_a_scene_wears_it_and_too_fine_squares_are_warned_of() -> None:
    item = cube().to_dict()["objects"][0]
    scene = cube(objects=[{**item, "texture": {"kind": "checkerboard", "square_mm": 2}}])
    assert st.Scene.from_dict(scene.to_dict()) == scene
    assert ENTRY.shortest_and_longest_mm == pytest.approx((SQUARE * np.sqrt(2),) * 2)
    fine = cube(objects=[{**item, "texture": {"kind": "checkerboard", "square_mm": 0.6}}])
    # The diagonal of 0.85 mm is 1.4 px of the small camera where the cube is farthest.
    with pytest.warns(SceneWarning, match=r"wavelengths down to 1\.\d+ px"):
        check_scene(fine, build_scene(fine))
    with pytest.raises(st.SceneError, match=r"objects\.0\.texture\.radiances\.1: .*less than or equal to 1"):
        cube(objects=[{**item, "texture": {"kind": "checkerboard", "square_mm": 2, "radiances": [0, 2]}}])
