"""Light of sampled points against rendered images; errors by highlights in closed form and against simulations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.bound.unknowns import WindowUnknowns
from scenetruth.design.prediction import HighlightWindows, SurfaceLight, TextureStatistics, predict
from scenetruth.resources import Limits, limited_objects
from scenetruth.scene import Scene
from tests.helpers.nightly import by_night, nightly
from tests.helpers.prediction_scenes import wall

Floats = NDArray[np.float64]

NEAR = {"position_mm": [20, 10, 480], "irradiance": 0.5, "reference_distance_mm": 120}
RING = {"kind": "ring", "position_mm": [0, 0, 100], "direction": [0, 0, 1], "inner_radius_mm": 30, "radius_mm": 50}
LIGHTS: dict[str, dict[str, Any]] = {
    "point": {"kind": "point", **NEAR},
    "sphere": {"kind": "sphere", "radius_mm": 12, **NEAR},
    "ring": RING | {"irradiance": 0.8, "reference_distance_mm": 500},
    "behind": {"kind": "directional", "direction": [0.1, 0.2, -1.0], "irradiance": 0.7},
}
MATERIALS: dict[str, dict[str, Any]] = {
    "gloss": {"refractive_index": 1.5, "roughness": 0.15},
    "metal": {"metallic": 1.0, "roughness": 0.3},
    "sheet": {"reflectance": 0.4, "transmittance": 0.5},
    "matt": {},
}


def lit(lamp: dict[str, Any], material: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """A surface of radiance 1 in the light of a lamp."""
    plain = wall(
        texture={"kind": "uniform", "radiance": 1.0},
        lighting={"ambient": 0.1, "lights": [lamp], "shadows": False},
        sensor={"full_scale_radiance": 4.0},
        frames={"count": 1},
        stage={"positions": 1, "baseline_mm": 1.0},
        camera={"width": 24, "height": 18, "focal_length_px": 200},
        **changes,
    )
    plain["objects"][0]["material"] = material
    return plain


def at_pixels(plain: dict[str, Any]) -> tuple[Floats, Floats]:
    """The light by the coarse mesh, and the image, at the pixels of the object."""
    scene = Scene.from_dict(plain)
    light = SurfaceLight(scene, limited_objects(scene, Limits()))
    c_x, c_y = scene.camera.principal_point
    x, y = np.meshgrid(np.arange(scene.camera.width) - c_x, np.arange(scene.camera.height) - c_y)
    factor, gloss = light.at(x.ravel(), y.ravel())
    recording, truth = st.simulate(scene, save_radiance=True)
    inside = truth["boundary_distance"].values.squeeze() > 2
    return (factor + gloss).reshape(inside.shape)[inside], recording["radiance"].values.squeeze()[inside]


@pytest.mark.parametrize("lamp", LIGHTS)
@pytest.mark.parametrize("material", ["gloss", *by_night("metal", "sheet", "matt")])
def test_light_of_a_plane_is_that_of_its_image(lamp: str, material: str) -> None:
    """To the curvature of the light in a pixel of 3 mm, 1/24 of its second difference, in a highlight of 30 mm."""
    found, image = at_pixels(lit(LIGHTS[lamp], MATERIALS[material]))
    np.testing.assert_allclose(found, image, rtol=4e-3, atol=1e-5)


@nightly
def test_light_of_a_curved_surface_is_that_of_its_image() -> None:
    """A ball of 1000 triangles of 8 degrees: smoothed normals differ by a tenth of that, and highlights are 17 wide."""
    ball = lit(LIGHTS["point"], {"refractive_index": 1.5, "roughness": 0.3}, mesh={"kind": "sphere", "radius_mm": 40})
    found, image = at_pixels(ball)
    assert image.max() > 1.5 * np.median(image)
    np.testing.assert_allclose(found, image, atol=0.03 * image.max())
    assert np.sqrt(np.mean((found - image) ** 2)) < 0.01 * image.max()


def test_beyond_surfaces_there_is_no_light() -> None:
    scene = Scene.from_dict(lit(LIGHTS["point"], {}))
    factor, gloss = SurfaceLight(scene, limited_objects(scene, Limits())).at(np.array([0.0, 400.0]), np.zeros(2))
    assert np.isfinite([factor[0], gloss[0]]).all()
    assert np.isnan([factor[1], gloss[1]]).all()


SIGMA, SLIDE, BEND = 4.0, 0.7, 0.003
S = np.arange(5.0) - 2.0


def slid(frequency: tuple[float, float] | None) -> tuple[Floats, Floats]:
    """Products of a window in which a parabola of light slides along x, and the offsets of its pixels."""
    line = np.linspace(-2 * SIGMA, 2 * SIGMA, 9)
    x, y = np.meshgrid(line, line)
    weights = np.exp(-0.5 * (x**2 + y**2) / SIGMA**2)[None]
    gloss = np.stack([0.5 * BEND * (x + SLIDE * s) ** 2 for s in S])[:, None]
    windows = HighlightWindows(np.array([0]), line, weights, np.zeros_like(gloss), gloss)
    wave = np.array([[frequency or (0.1, 0.0)]])
    # Without a wave, the texture has only contrast that gains could follow.
    response = np.zeros((1, 1, 2)) if frequency is None else 2 * np.pi * wave
    one = np.ones(1)
    seen = TextureStatistics(0.5 * one, 2.0 * one, 0.01 * one, wave, np.full((1, 1), 0.04), response)
    # Images move by -s for a disparity of 1: gradients along x alone count.
    change = np.zeros((2, 1, len(S), 1))
    change[0, 0, :, 0] = -S
    model = WindowUnknowns("plane", "translation", moving=False, brightness=0)
    found = windows.errors(1, np.ones((len(S), 1), dtype=bool), seen, change, model)
    return found[..., 0], line


def test_light_that_slides_pulls_by_its_own_gradient() -> None:
    """Σ w ∂L/∂x Σ -s δ, of the parabola c (x + u s)² / 2: -c² u Σ s² Σ w x², to the width of the trapezoids."""
    found, line = slid(None)
    x, y = np.meshgrid(line, line)
    weights = np.exp(-0.5 * (x**2 + y**2) / SIGMA**2)
    step = line[1] - line[0]
    # Grey values are twice the radiance, and the noise 0.01.
    pull = (2 * BEND / 0.01) ** 2 * SLIDE * (S**2).sum() * (weights * x**2).sum() * step**2
    # Gradients of parabolas are exact but for the borders, which have exp(-2) of the weight.
    assert np.sqrt(found[0, 0]) == pytest.approx(pull, rel=0.15)
    # A symmetrical window: no slope.
    assert abs(found[1, 1]) < 1e-6 * found[0, 0] * SIGMA**2


def test_light_that_slides_is_taken_for_texture_with_similar_waves() -> None:
    """The mean square of sums over the pixels, for random phases; windows end 0.2 px earlier, at exp(-2): 4 %."""
    frequency = (0.05, 0.02)
    found, _ = slid(frequency)
    plain, _ = slid(None)
    at = np.arange(-8.0, 9.0)
    x, y = np.meshgrid(at, at)
    weights = np.exp(-0.5 * (x**2 + y**2) / SIGMA**2)
    driven = -(S**2).sum() * 2 * BEND * SLIDE * x / 0.01
    sums = []
    for phase in np.arange(64) / 64 * 2 * np.pi:
        gradient = -2 * np.pi * frequency[0] * np.sin(2 * np.pi * (frequency[0] * x + frequency[1] * y) + phase)
        sums.append(np.sum(weights * driven * np.sqrt(2 * 0.04) * gradient / 0.01) ** 2)
    assert found[0, 0] - plain[0, 0] == pytest.approx(np.mean(sums), rel=0.05)


def glossy(roughness: float, lamp: dict[str, Any]) -> dict[str, Any]:
    plain = wall(
        frames={"count": 3},
        lighting={"ambient": 0.15, "lights": [lamp]},
        sensor={"noise_std": 0.004, "bit_depth": 12, "full_scale_radiance": 2.0},
        motion=[{"kind": "velocity", "velocity_mm_per_frame": [0.3, 0.1, -0.2]}],
    )
    plain["objects"][0]["material"] = {"refractive_index": 1.5, "roughness": roughness}
    return plain


@nightly
def test_sharp_highlights_that_slide_cost_depth_and_smooth_highlights_nothing() -> None:
    lamp = {"kind": "point", "position_mm": [0, 0, 480], "irradiance": 0.6, "reference_distance_mm": 120}
    errors = {
        roughness: predict(glossy(roughness, lamp), method="refined").precision("depth", "object_wall").rmse
        for roughness in (0.08, 0.6, 1.0)
    }
    assert errors[0.08] > 1.5 * errors[1.0]
    assert errors[0.6] == pytest.approx(errors[1.0], rel=0.1)


@nightly
@pytest.mark.parametrize("roughness", [0.08, 0.1, 0.15, 0.3])
@pytest.mark.parametrize("model", ["analytic", "maps"])
def test_errors_in_highlights_are_not_larger_than_predicted(roughness: float, model: Any) -> None:
    """Beside the bias at borders of the image that no prediction includes: that of a matt surface, 1.7 at most."""
    lamp = {"kind": "point", "position_mm": [0, 0, 480], "irradiance": 0.6, "reference_distance_mm": 120}
    plain = glossy(roughness, lamp)
    recording, truth = st.simulate(plain)
    estimate = st.estimate(recording, "refined").isel(t=0)
    inner = truth["boundary_distance"].sel(t=0).values > 10
    valid = estimate["valid"].values.astype(bool) & inner
    error = (estimate["depth"] - truth["depth"].sel(t=0)).values[valid]
    predicted = predict(plain, method="refined", model=model).precision("depth", "object_wall").rmse
    assert np.sqrt(np.mean(error**2)) < 1.7 * predicted
