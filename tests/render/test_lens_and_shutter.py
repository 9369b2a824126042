"""Blur, defocus, motion blur and rolling shutter of an edge, against what they must be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import erf

from scenetruth.camera import AiryPsf, GaussianPsf, Viewpoint
from scenetruth.errors import BackendUnavailableError, SceneError
from scenetruth.render import choose_renderer
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import build_scene
from tests.helpers.nightly import nightly

FOCAL, DEPTH = 500.0, 500.0


def edge(x_px: float, *, speed: float = 0.0, depth: float = DEPTH, **changes: Any) -> Scene:
    """Return a bright half plane whose left edge is imaged at x_px and moves by so many px per frame."""
    plain: dict[str, Any] = {
        "camera": {"width": 48, "height": 12, "focal_length_px": FOCAL, "principal_point_px": [0, 0]},
        "stage": {"positions": 1, "baseline_mm": 1.0},
        "frames": {"count": 1, "frame_interval_s": 0.1},
        "objects": [
            {
                "name": "plane",
                "mesh": {"kind": "plane", "size_mm": [1000, 1000]},
                "pose": {"position_mm": [500 + x_px * depth / FOCAL, 0, depth]},
                "texture": {"kind": "uniform", "radiance": 1.0},
                "motion": [{"kind": "velocity", "velocity_mm_per_frame": [speed * depth / FOCAL, 0, 0]}],
            }
        ],
        "render": {"backend": "raycast", "supersampling": 16},
    }
    return Scene.from_dict(plain | changes)


def image_of(scene: Scene, t: float = 0.0, x_mm: float = 0.0) -> NDArray[np.float32]:
    choice = choose_renderer(scene, build_scene(scene))
    with choice.renderer as renderer:
        return renderer.render(t, Viewpoint.on_axis(x_mm))


def spread(positions: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    """Return the distance from 10 % to 90 % of an edge."""
    low, high = np.interp([0.1, 0.9], values, positions)
    return float(high - low)


def expected_edge(psf: GaussianPsf | AiryPsf, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the edge behind the point spread function and the pixel, from its transfer function."""
    frequency = np.linspace(1e-6, 12, 60001)
    response = psf.transfer(frequency) * np.sinc(frequency) / (np.pi * frequency)
    return np.array([0.5 + np.trapezoid(response * np.sin(2 * np.pi * frequency * at), frequency) for at in x])


@pytest.mark.parametrize(
    "psf",
    [
        {"kind": "gaussian", "sigma_px": 0.35},
        {"kind": "gaussian", "sigma_px": 1.2},
        {"kind": "airy", "wavelength_um": 0.55, "f_number": 11, "pixel_pitch_um": 3.45},
        {"kind": "airy", "wavelength_um": 0.55, "f_number": 4, "pixel_pitch_um": 5.5},
    ],
)
def test_an_edge_is_as_wide_as_the_point_spread_function_makes_it(psf: dict[str, Any]) -> None:
    shifts = np.linspace(0, 1, 8, endpoint=False)
    columns = np.arange(48)
    positions, values = [], []
    for shift in shifts:
        image = image_of(edge(24 + shift, optics={"psf": psf}))
        positions.append(columns - (24 + shift))
        values.append(image[6])
    order = np.argsort(np.concatenate(positions))
    x, y = np.concatenate(positions)[order], np.concatenate(values)[order].astype(float)
    model = GaussianPsf(**psf) if psf["kind"] == "gaussian" else AiryPsf(**psf)
    expected = expected_edge(model, x)
    inner = np.abs(x) < 4
    assert spread(x[inner], y[inner]) == pytest.approx(spread(x[inner], expected[inner]), rel=0.02)
    # Samples stand 1/16 px apart, so that the edge is found to 1/32 px; its slope is below 1 / px.
    assert np.abs(y - expected).max() < 1 / 32


def test_the_gaussian_edge_in_closed_form() -> None:
    sigma = 0.9
    image = image_of(edge(24.0, optics={"psf": {"kind": "gaussian", "sigma_px": sigma}}))

    def integral(x: Any) -> Any:
        share = 0.5 * (1 + erf(x / (sigma * np.sqrt(2))))
        return x * share + sigma / np.sqrt(2 * np.pi) * np.exp(-0.5 * (x / sigma) ** 2)

    x = np.arange(48) - 24.0
    # The edge lies on a border between parts of pixels, where it aliases most: (w / 4)² of its spectrum, which
    # reaches to w = 1 / (2 π σ) = 0.18 per px.
    np.testing.assert_allclose(image[6], integral(x + 0.5) - integral(x - 0.5), atol=2e-3)


def test_light_is_neither_lost_nor_made() -> None:
    for optics in (
        {"psf": {"kind": "gaussian", "sigma_px": 2}},
        {"defocus": {"aperture_mm": 9, "focus_distance_mm": 400}},
    ):
        scene = edge(-400.0, optics=optics)
        np.testing.assert_allclose(image_of(scene), 1.0, rtol=1e-6)


@nightly
def test_an_edge_out_of_focus_is_blurred_by_a_disc() -> None:
    lens = {"aperture_mm": 8.0, "focus_distance_mm": 500.0, "samples": 400}
    scene = edge(24.0, depth=800.0, optics={"defocus": lens})
    diameter = scene.optics.defocus.blur_diameter_px(np.array(800.0), FOCAL)  # type: ignore[union-attr]
    assert diameter == pytest.approx(500 * 8 * (1 / 500 - 1 / 800))
    x = np.clip(np.linspace(-12, 12, 24001), -diameter / 2, diameter / 2) / (diameter / 2)
    share = 0.5 + (x * np.sqrt(1 - x**2) + np.arcsin(x)) / np.pi  # of a disc beyond a chord
    grid = np.linspace(-12, 12, 24001)
    expected = [share[(grid >= at - 0.5) & (grid <= at + 0.5)].mean() for at in np.arange(48) - 24.0 if abs(at) < 8]
    inner = np.abs(np.arange(48) - 24.0) < 8
    # 400 points on the disc: an edge across it counts some of sqrt(400) along it in or out.
    np.testing.assert_allclose(image_of(scene)[6][inner], expected, atol=0.01)
    sharp = image_of(edge(24.0, optics={"defocus": lens}))
    np.testing.assert_allclose(sharp, image_of(edge(24.0)), atol=1e-6)


@pytest.mark.parametrize("backend", ["raycast", "pyrender"])
def test_a_moving_edge_is_a_ramp(backend: str) -> None:
    # 50 px per frame of 0.1 s, over 0.02 s: 10 px.
    shutter = {"exposure_time_s": 0.02, "samples": 160}
    try:
        image = image_of(edge(24.0, speed=50.0, shutter=shutter, render={"backend": backend, "supersampling": 4}))
    except BackendUnavailableError as error:
        pytest.skip(str(error))
    x = np.arange(48) - 24.0
    grid = np.linspace(-0.5, 0.5, 1001)
    expected = np.clip((x[:, None] + grid + 5) / 10, 0, 1).mean(axis=1)
    # 160 moments and 4 samples per pixel: steps of 1/160 and 1/4 px / 10 px, halved.
    np.testing.assert_allclose(image[6], expected, atol=0.5 / 160 + 0.125 / 10)


def test_a_moving_camera_blurs_as_a_moving_object_does() -> None:
    shutter = {"exposure_time_s": 0.02, "samples": 32}
    moving = image_of(edge(24.0, speed=50.0, shutter=shutter))
    speed = -50.0 * DEPTH / FOCAL / 0.1
    carried = image_of(edge(24.0, shutter=shutter | {"stage_speed_mm_per_s": speed}))
    np.testing.assert_allclose(moving, carried, atol=1e-6)


def test_moments_follow_the_motion() -> None:
    scene = edge(24.0, speed=50.0, shutter={"exposure_time_s": 0.02})
    few = edge(24.0, speed=50.0, shutter={"exposure_time_s": 0.02, "samples": 40})
    np.testing.assert_array_equal(image_of(scene), image_of(few))  # 4 for each of 10 px
    still = edge(24.0, shutter={"exposure_time_s": 0.02})
    np.testing.assert_array_equal(image_of(still), image_of(edge(24.0)))


@pytest.mark.parametrize("optics", [{}, {"psf": {"kind": "gaussian", "sigma_px": 0.5}}])
def test_a_rolling_shutter_leans_a_moving_edge(optics: dict[str, Any]) -> None:
    # 20 px per frame of 0.1 s, 0.05 s from the first to the last row: 10 px.
    scene = edge(24.0, speed=20.0, shutter={"readout_time_s": 0.05}, optics=optics)
    image = image_of(scene).astype(float)
    found = 47.5 - image.sum(axis=1)  # where the edge is in every row
    expected = 24.0 + 10 * (np.arange(12) - 5.5) / 11
    # Coverage counts in steps of 1/16 px.
    np.testing.assert_allclose(found, expected, atol=1 / 32 + 1e-6)


def test_what_opengl_cannot_render_is_ray_cast_or_refused() -> None:
    scene = edge(24.0, shutter={"readout_time_s": 0.05}, render={"backend": "auto"})
    choice = choose_renderer(scene, build_scene(scene))
    assert choice.renderer.name == "raycast"
    assert "rolling shutter" in choice.fallback_reason
    from scenetruth.simulation import simulate

    for part in (
        {"shutter": {"readout_time_s": 0.05}},
        {"camera": scene.camera.model_dump() | {"distortion": {"k1": -1}}},
    ):
        with pytest.raises(SceneError, match=r"render\.backend.*raycast"):
            simulate(edge(24.0, **(part | {"render": {"backend": "pyrender"}})))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"optics": {"psf": {"kind": "gaussian", "sigma_px": 9}}}, r"optics\.psf.*wider than the image"),
        ({"shutter": {"exposure_time_s": 0.2}}, r"shutter\.exposure_time_s.*frame_interval_s"),
        (
            {"shutter": {"exposure_time_s": 0.06, "readout_time_s": 0.06}},
            r"shutter\.readout_time_s.*frame_interval_s",
        ),
    ],
)
def test_optics_that_do_not_fit_the_scene_are_refused(changes: dict[str, Any], message: str) -> None:
    from scenetruth.simulation import simulate

    with pytest.raises(SceneError, match=message):
        simulate(edge(24.0, **changes))


def test_truth_of_a_rolling_shutter_is_where_its_images_show_the_edge() -> None:
    from scenetruth.simulation import simulate

    shutter = {"readout_time_s": 0.05, "stage_speed_mm_per_s": -100.0}
    recording, truth = simulate(edge(24.0, speed=20.0, shutter=shutter))
    # 10 px from the first to the last row by the object's motion, 5 px by the camera's.
    expected = 24.0 + 15 * (np.arange(12) - 5.5) / 11
    seen = 48 - np.isfinite(truth["depth"].values[0]).sum(axis=1)
    np.testing.assert_array_equal(seen, np.ceil(expected))
    found = 47.5 - recording["image"].values[0, 0].sum(axis=1, dtype=float)
    np.testing.assert_allclose(found, expected, atol=1 / 32 + 1e-6)
