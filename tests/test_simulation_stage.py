"""What a real stage does to images: each is the analytic one from where, and when, the truth says it was taken."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import scenetruth as st
from scenetruth.errors import BackendUnavailableError
from scenetruth.scene import Scene
from scenetruth.storage import write_images
from tests.helpers.scenes import cube

Array = NDArray[np.float64]

VELOCITY = np.array([0.3, 0.2, -1.5])
WAVELENGTHS = np.array([8.0, 9.0])
FOCAL_PX, WIDTH, HEIGHT = 1254.0, 96, 72
STAGE = {"positions": 3, "baseline_mm": 5.0}
REAL: dict[str, Any] = {
    "scan": "bidirectional",
    "time_per_position_s": 0.25,
    "errors": {
        "repeatability_um": 50,
        "backlash_um": 200,
        "straightness_um": 300,
        "pitch_urad": 500,
        "yaw_urad": 500,
        "roll_urad": 5000,
    },
}


def plaid(stage: dict[str, Any], backend: str = "raycast", supersampling: int = 1, **changes: Any) -> Scene:
    """Return a moving plaid that fills the view of every camera."""
    item = {
        "name": "plaid",
        "mesh": {"kind": "plane", "size_mm": [400, 400]},
        "pose": {"position_mm": [0, 0, 660]},
        "texture": {"kind": "plaid", "wavelength_mm": WAVELENGTHS.tolist(), "amplitude": 0.4},
        "motion": [{"kind": "velocity", "velocity_mm_per_frame": VELOCITY.tolist()}],
    }
    plain: dict[str, Any] = {
        "camera": {"width": WIDTH, "height": HEIGHT, "focal_length_px": FOCAL_PX},
        "frames": {"count": 3},
        "objects": [item],
        "render": {"backend": backend, "supersampling": supersampling},
    }
    return cube(**(plain | changes), stage=STAGE | stage)


def analytic(position: Array, turn: Array, t: float) -> Array:
    """Return the pattern at the pixel centres, from the rays' intersections with the plane."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(x - (WIDTH - 1) / 2) / FOCAL_PX, (y - (HEIGHT - 1) / 2) / FOCAL_PX, np.ones(x.shape)], axis=-1)
    rays = rays @ Rotation.from_rotvec(turn).as_matrix().T
    origin = np.array([0, 0, 660]) + VELOCITY * t
    reach = (origin[2] - position[2]) / rays[..., 2]
    on_plane = position[:2] + rays[..., :2] * reach[..., None] - origin[:2]
    return np.asarray(0.5 + 0.4 * np.cos(2 * np.pi * on_plane / WAVELENGTHS).prod(axis=-1))


def real_image(truth: xr.Dataset, at: dict[str, int]) -> Array:
    here = truth.sel(at)
    time = float(here["image_time_s"]) / truth.attrs["frame_interval_s"]
    return analytic(here["camera_position_mm"].values, here["camera_rotation_rad"].values, time)


def test_every_image_is_what_the_real_camera_saw_then() -> None:
    recording, truth = st.simulate(
        plaid({**REAL, "rows": 2, "row_spacing_mm": 6}, frames={"count": 3, "frame_interval_s": 2.5})
    )
    assert recording["image"].dims == ("s_y", "s", "t", "y", "x")
    errors, planned_errors = [], []
    for s_y in (0, 1):
        for s in (-1, 0, 1):
            for t in (-1, 0, 1):
                at = {"s_y": s_y, "s": s, "t": t}
                image = recording["image"].sel(at).values
                errors.append(np.abs(image - real_image(truth, at)).max())
                planned = analytic(np.array([5.0 * s, 6.0 * s_y, 0.0]), np.zeros(3), t)
                planned_errors.append(np.abs(image - planned).max())
    # One sample a pixel is the value at its centre, in float32.
    assert max(errors) < 1e-6
    # The test would notice if the stage were perfect.
    assert min(planned_errors) > 1e-2


def test_images_and_truth_follow_listed_poses() -> None:
    generator = np.random.default_rng(5)
    scale = np.array([100, 300, 400, 4e3, 5e3, 2e4])
    off = scale * generator.uniform(-1, 1, (3, 6))
    visits = scale * generator.uniform(-1, 1, (3, 2, 6))
    names = ("x_um", "y_um", "z_um", "pitch_urad", "yaw_urad", "roll_urad")
    poses = [dict(zip(names, row.tolist(), strict=True)) for row in off]
    listed = [
        {**pose, "visits": [dict(zip(names, row.tolist(), strict=True)) for row in rows]}
        for pose, rows in zip(poses, visits, strict=True)
    ]
    tilt = [3e3, -2e4]
    scene = plaid({"poses": listed, "axis_tilt_urad": tilt}, frames={"count": 2})
    recording, truth = st.simulate(scene, truth_views="all")
    for s in (-1, 0, 1):
        for t in (0, 1):
            total = off[s + 1] + visits[s + 1, t]
            position = np.array([5.0 * s, 5e-6 * s * tilt[0], 5e-6 * s * tilt[1]]) + 1e-3 * total[:3]
            turn = 1e-6 * total[3:]
            np.testing.assert_allclose(recording["image"].sel(s=s, t=t), analytic(position, turn, t), atol=1e-6)
            # A point of the plane, projected with these poses, has the depth that the truth states at its pixel.
            axes, depth = Rotation.from_rotvec(turn).as_matrix(), truth["depth"].sel(s=s, t=t).values
            y, x = 11, 70
            ray = axes @ [(x - (WIDTH - 1) / 2) / FOCAL_PX, (y - (HEIGHT - 1) / 2) / FOCAL_PX, 1]
            point = position + ray * (660 + VELOCITY[2] * t - position[2]) / ray[2]
            assert depth[y, x] == pytest.approx(float((axes.T @ (point - position))[2]), abs=1e-9)
    assert recording["stage_x_mm"].values.tolist() == [-5, 0, 5]


def test_the_opengl_backend_puts_turned_cameras_in_the_same_place() -> None:
    scene = plaid(REAL, backend="pyrender", supersampling=4)
    try:
        recording, truth = st.simulate(scene)
    except BackendUnavailableError as error:
        pytest.skip(str(error))
    for s in (-1, 0, 1):
        for t in (-1, 0, 1):
            image, here = recording["image"].sel(s=s, t=t).values, truth.sel(s=s, t=t)
            position, turn = here["camera_position_mm"].values, here["camera_rotation_rad"].values
            time = float(here["image_time_s"])
            expected = analytic(position, turn, time)
            # Derivatives by yaw, pitch and roll, in px of the image's centre and of its corner.
            steps = np.diag([1, 1, FOCAL_PX / (WIDTH / 2)]) / FOCAL_PX
            slopes = [
                (analytic(position, turn + 1e-3 * step, time) - analytic(position, turn - 1e-3 * step, time)) / 2e-3
                for step in steps
            ]
            design = np.column_stack([expected.ravel() - 0.5, *(slope.ravel() for slope in slopes)])
            _, *shifts = np.linalg.lstsq(design, (image - expected).ravel(), rcond=None)[0]
            # As for cameras that are not turned (test_backends).
            assert np.abs(shifts).max() < 1e-3


def still_plaid(stage: dict[str, Any], **changes: Any) -> Scene:
    item = {**plaid({}).to_dict()["objects"][0], "motion": []}
    return plaid({"positions": 1, **stage}, objects=[item], frames={"count": 1}, **changes)


def centred_pixels() -> Array:
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([x - (WIDTH - 1) / 2, y - (HEIGHT - 1) / 2], axis=-1)


def pattern(pixels: Array) -> Array:
    """Return the plaid at rest as the perfect camera sees it, at positions from the principal point in px."""
    return np.asarray(0.5 + 0.4 * np.cos(2 * np.pi * pixels * 660 / FOCAL_PX / WAVELENGTHS).prod(axis=-1))


def registered_shift(image: Array) -> Array:
    """Register the middle of an image to the perfect one: where there it reads, in px to the right and down."""

    def residual(shift: Array) -> Array:
        return np.asarray((pattern(centred_pixels() + shift) - image)[20:-20, 30:-30].ravel())

    return np.asarray(least_squares(residual, np.zeros(2), xtol=1e-12).x)


@pytest.mark.parametrize("kind", ["pitch_urad", "yaw_urad", "straightness_um"])
def test_images_shift_as_a_small_error_predicts(kind: str) -> None:
    recording, truth = st.simulate(still_plaid({"errors": {kind: 800}}, seed=3))
    (pitch, yaw, roll), (_, down, forward) = (
        truth[name].sel(s=0, t=0).values for name in ("camera_rotation_rad", "camera_position_mm")
    )
    assert roll == 0
    image = recording["image"].sel(s=0, t=0).values.astype(np.float64)
    # A camera that looks farther right, or up, or stands lower, reads the reference's image there.
    expected = [FOCAL_PX * np.tan(yaw), -FOCAL_PX * np.tan(pitch) + FOCAL_PX * down / (660 - forward)]
    assert np.abs(expected).max() > 0.2
    # The shift grows as 1 + (x² or y²) / f², and by x y / f² across: below 3e-4 of it in the central window. A camera
    # that leaves its line along Z magnifies by 1e-3, which is even about the centre.
    np.testing.assert_allclose(registered_shift(image), expected, atol=5e-4)


def test_images_turn_as_a_roll_predicts() -> None:
    recording, truth = st.simulate(still_plaid({"errors": {"roll_urad": 2e4}}))
    roll = float(truth["camera_rotation_rad"].sel(s=0, t=0)[2])
    assert abs(roll) > 5e-3
    image = recording["image"].sel(s=0, t=0).values
    residuals = []
    for turn in (roll, -roll):
        cos, sin = np.cos(turn), np.sin(turn)
        # What lies on the camera's x axis lies, for X turned towards Y, below that of the perfect one.
        rolled = centred_pixels() @ np.array([[cos, sin], [-sin, cos]])
        residuals.append(np.abs(pattern(rolled) - image).max())
    # One sample a pixel is the value at its centre, in float32; the wrong sense of the turn is far from it.
    assert residuals[0] < 1e-6 < 1e-2 < residuals[1]


def test_images_of_a_grid_are_files_of_their_own(tmp_path: Path) -> None:
    recording, _ = st.simulate(plaid({"rows": 2, "row_spacing_mm": 3}, frames={"count": 1}))
    write_images(recording, tmp_path / "images", "tiff")
    names = sorted(path.name for path in (tmp_path / "images").iterdir())
    assert names == sorted(f"r{s_y:+d}_s{s:+d}_t+0.tiff" for s_y in (0, 1) for s in (-1, 0, 1))
    stored = imageio.imread(tmp_path / "images" / "r+1_s-1_t+0.tiff")
    np.testing.assert_array_equal(stored, recording["image"].sel(s_y=1, s=-1, t=0))


def test_invalid_pixels_are_black_in_pictures(tmp_path: Path) -> None:
    images = np.full((2, 1, 3, 4), 0.5, dtype=np.float32)
    images[0, 0, :, 0] = np.nan
    recording = st.make_recording(images, focal_length_px=100, baseline_mm=5, full_scale=1)
    for form, expected in (("png", 0), ("tiff", np.nan)):
        write_images(recording, tmp_path / form, form)  # type: ignore[arg-type]
        stored = imageio.imread(tmp_path / form / f"s+0_t+0.{form}")
        np.testing.assert_array_equal(stored[:, 0], expected)
        assert np.unique(stored[:, 1:]).size == 1


def test_rows_do_not_share_noise() -> None:
    sensor = {"bit_depth": None, "noise_std": 0.1}
    noisy, _ = st.simulate(plaid({"rows": 3, "row_spacing_mm": 3}, sensor=sensor), save_radiance=True)
    noise = (noisy["image"] - noisy["radiance"]).values.reshape(27, -1)
    correlation = np.corrcoef(noise) - np.eye(27)
    # 6912 pixels: chance goes beyond five standard errors once in a million.
    assert np.abs(correlation).max() < 5 / np.sqrt(noise.shape[1])
