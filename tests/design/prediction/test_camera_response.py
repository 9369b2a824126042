"""Grey values and noise against images that sensors take, and what is left of waves against sampled ones."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from scipy.interpolate import make_interp_spline
from scipy.special import j1

import scenetruth as st
from scenetruth.camera import LinearImage, build_sensor_chain
from scenetruth.design.prediction import (
    compute_blur_px,
    compute_derivative_response,
    compute_grey_levels,
    compute_irradiance,
    compute_transfer,
)
from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene
from tests.helpers.nightly import by_night
from tests.helpers.prediction_scenes import wall

SIDE, IMAGES = 100, 10
SENSORS: list[dict[str, Any]] = [
    {"noise_std": 0.01, "bit_depth": 8},
    {"noise_std": 0.002, "bit_depth": 6, "full_scale_radiance": 0.9},
    {"kind": "emva1288", "preset": "industrial_cmos"},
    {"kind": "emva1288", "preset": "ccd_2002", "gamma": 0.6},
]


@pytest.mark.parametrize("given", SENSORS, ids=lambda given: str(list(given.values())))
def test_level_noise_and_pattern_are_those_of_flat_images(given: dict[str, Any]) -> None:
    """10,000 pixels in 10 images: 0.24 % of the noise, 0.7 % of the pattern; sensors without formula 2 % more."""
    sensor = Scene.from_dict(wall(sensor=given)).sensor
    chain = build_sensor_chain(sensor)
    opened = chain.open((SIDE, SIDE), partial(generator_for, 5, "sensor"))
    # Rounding is even noise where light changes from pixel to pixel.
    ramp = np.tile(np.linspace(0.35, 0.45, SIDE), (SIDE, 1)).astype(np.float32)
    images = np.array([opened.read(LinearImage(ramp, 0, 0, t)) for t in range(IMAGES)]) / chain.full_scale
    slope = np.polyfit(ramp[0], images.mean(axis=(0, 1)), 1)
    left = images - np.polyval(slope, ramp)
    told = compute_grey_levels(sensor, np.array([0.4]))
    assert told.level[0] == pytest.approx(images.mean(), rel=0.01)
    assert told.gain[0] == pytest.approx(slope[0], rel=0.06)
    whole = np.hypot(told.noise[0], told.pattern[0])
    assert whole == pytest.approx(left.std(), rel=0.04)
    assert (told.pattern[0] > 0) == ("kind" in given)


def test_the_ideal_sensor_has_no_noise() -> None:
    told = compute_grey_levels("ideal", np.array([0.2, 0.7]))
    assert (told.noise == 0).all()
    assert told.level.tolist() == [0.2, 0.7]


LAMP = {"position_mm": [60, 0, 300], "irradiance": 0.9, "reference_distance_mm": 300}
LIGHTS: list[dict[str, Any]] = [
    {"ambient": 0.3},
    {"ambient": 0.1, "lights": [{"kind": "directional", "direction": [0.5, 0.2, 1.0], "irradiance": 0.8}]},
    {"lights": [{"kind": "point", "position_mm": [60, 0, 300], "irradiance": 0.9, "reference_distance_mm": 300}]},
    {
        "lights": [
            {
                "kind": "spot",
                "position_mm": [60, 0, 300],
                "target_mm": [0, 0, 600],
                "inner_angle_deg": 2,
                "outer_angle_deg": 9,
                "irradiance": 0.9,
                "reference_distance_mm": 300,
            }
        ]
    },
    {"lights": [LAMP | {"kind": "disc", "target_mm": [-20, 30, 600], "radius_mm": 1}]},
    {"lights": [LAMP | {"kind": "sphere", "radius_mm": 1}]},
]


@pytest.mark.parametrize(
    "lighting",
    [*LIGHTS[:4], *by_night(*LIGHTS[4:])],
    ids=["ambient", "directional", "point", "spot", "disc", "sphere"],
)
def test_light_is_that_of_rendered_images(lighting: dict[str, Any]) -> None:
    """Of a surface of radiance 1, images are the light itself: to float32 and the curvature of light in a pixel."""
    plain = wall(
        texture={"kind": "uniform", "radiance": 1.0},
        lighting=lighting,
        sensor="ideal",
        frames={"count": 1},
        stage={"positions": 1, "baseline_mm": 1.0},
        camera={"width": 24, "height": 18, "focal_length_px": 300},
    )
    scene = Scene.from_dict(plain)
    recording, _ = st.simulate(scene)
    rays = scene.camera.ray_directions(scene.camera.pixel_grid()).reshape(-1, 3)
    found = compute_irradiance(scene, 600.0 * rays, np.tile([0.0, 0.0, -1.0], (len(rays), 1)))
    np.testing.assert_allclose(found.reshape(18, 24), recording["image"].values[0, 0], rtol=2e-3, atol=1e-5)


def left_of(scene: Scene, frequency: tuple[float, float], moved: tuple[float, float] = (0.0, 0.0)) -> float:
    found = compute_transfer(np.array([[frequency]]), scene, np.array([600.0]), np.array([moved]))
    return float(found[0, 0])


@given(frequency=some.floats(0.01, 0.4))
def test_derivative_is_that_of_the_quintic_spline(frequency: float) -> None:
    """Far from the ends of a long line of samples, where the spline does not know of them."""
    at = np.arange(-40.0, 41.0)
    spline = make_interp_spline(at, np.sin(2 * np.pi * frequency * at), k=5)
    assert compute_derivative_response(np.array(frequency)) == pytest.approx(float(spline.derivative()(0.0)), abs=1e-6)


@given(x=some.floats(-0.45, 0.45), y=some.floats(-0.45, 0.45))
def test_pixels_are_means_over_their_samples(x: float, y: float) -> None:
    scene = Scene.from_dict(wall(render={"backend": "raycast", "supersampling": 3}))
    at = (np.arange(3) - 1) / 3
    mean = np.cos(2 * np.pi * (x * at[:, None] + y * at)).mean()
    assert left_of(scene, (x, y)) == pytest.approx(mean, abs=1e-12)


def test_waves_finer_than_two_pixels_are_lost() -> None:
    scene = Scene.from_dict(wall())
    assert left_of(scene, (0.51, 0.0)) == 0.0
    assert left_of(scene, (0.0, 0.49)) > 0.5


def test_lens_and_aperture_are_those_of_the_scene() -> None:
    """A disc has 2 J1(z) / z; the point spread function tells its own."""
    plain = Scene.from_dict(wall(optics={"defocus": {"aperture_mm": 4.0, "focus_distance_mm": 500.0}}))
    argument = np.pi * 0.2 * float(plain.optics.defocus.blur_diameter_px(np.array(600.0), 1200.0))  # type: ignore[union-attr]
    sharp = left_of(Scene.from_dict(wall()), (0.2, 0.0))
    assert left_of(plain, (0.2, 0.0)) == pytest.approx(sharp * 2 * j1(argument) / argument, abs=1e-9)
    blurred = Scene.from_dict(wall(optics={"psf": {"kind": "gaussian", "sigma_px": 0.7}}))
    assert left_of(blurred, (0.12, 0.16)) == pytest.approx(
        left_of(Scene.from_dict(wall()), (0.12, 0.16)) * np.exp(-2 * (np.pi * 0.7 * 0.2) ** 2)
    )


def test_motion_is_a_mean_along_a_line() -> None:
    scene = Scene.from_dict(wall())
    along = (np.arange(4000) + 0.5) / 4000 - 0.5
    mean = np.cos(2 * np.pi * (0.1 * 3.0 + 0.05 * 1.0) * along).mean()
    assert left_of(scene, (0.1, 0.05), (3.0, 1.0)) == pytest.approx(mean * left_of(scene, (0.1, 0.05)), rel=1e-4)


def test_surface_and_stage_move_together_while_an_image_is_taken() -> None:
    shutter = {"exposure_time_s": 0.5, "stage_speed_mm_per_s": 2.0}
    scene = Scene.from_dict(wall(shutter=shutter, frames={"count": 3, "frame_interval_s": 2.0}))
    found = compute_blur_px(scene, np.array([600.0]), np.array([[3.0, -1.0]]))
    # 1200 px / 600 mm times 1 mm of travel, to the left.
    assert found[0] == pytest.approx([0.25 * 3.0 - 2.0, -0.25])
