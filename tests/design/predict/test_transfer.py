"""What is left of waves: against waves that are sampled, averaged and differentiated."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from scipy.interpolate import make_interp_spline
from scipy.special import j1

from scenetruth.design.prediction.camera_response import compute_blur_px, compute_derivative_response, compute_transfer
from scenetruth.scene import Scene
from tests.design.predict.scenes import wall


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
