"""Lenses: positions and derivatives as of the camera model, and estimates at the pixels of the distorted images."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.camera import Distortion
from scenetruth.estimators.refined import (
    ImageView,
    Lens,
    compute_jacobian,
    corrected,
    distort,
    lens_problems,
    straightened,
    undistort,
)
from tests.helpers.nightly import by_night
from tests.helpers.scanned_plane import ScannedPlane

Array = NDArray[np.float64]
LENS = Distortion(k1=-0.3, k2=0.08, p1=2e-3, p2=-1e-3, k3=0.01, k4=0.02, k5=-0.01, k6=0.003)
COEFFICIENTS = np.array(LENS.coefficients)
POINTS = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 300))
SETTINGS = {"window_sigma_px": 4.0, "window_frames": 5, "surface": "plane", "discontinuity_refit": False}


def test_positions_and_jacobian_are_those_of_the_camera() -> None:
    np.testing.assert_allclose(distort(COEFFICIENTS, POINTS), LENS.distort(POINTS.T).T, rtol=0, atol=1e-15)
    np.testing.assert_allclose(undistort(COEFFICIENTS, distort(COEFFICIENTS, POINTS)), POINTS, rtol=0, atol=1e-12)
    expected = LENS.jacobian(POINTS.T)
    for values, (i, j) in zip(compute_jacobian(COEFFICIENTS, POINTS), ((0, 0), (0, 1), (1, 1)), strict=True):
        np.testing.assert_allclose(values, expected[:, i, j], rtol=0, atol=1e-14)


def test_kernels_agree_with_the_model() -> None:
    lens = Lens(COEFFICIENTS, 150.0, (50.5, 39.0), (81, 101))
    nothing = np.zeros(1)
    view = ImageView(nothing, nothing, nothing, np.zeros((1, 4)), 150.0, 50.5, 39.0, lens=lens.kernel)
    for x, y in ((-40.0, 30.0), (0.0, 0.0), (35.5, -20.25)):
        point = np.array([x, y]) / 150.0
        at = 150.0 * LENS.distort(point) + [50.5, 39.0]
        assert corrected(view, 0, x, y) == pytest.approx(tuple(at), abs=1e-10)
        jacobian = LENS.jacobian(point)
        own = np.array([0.3, -0.7])
        assert straightened(view, x + 50.5, y + 39.0, *own) == pytest.approx(tuple(jacobian.T @ own), rel=1e-6)
    # A polynomial may return into the image beyond its largest radius.
    assert corrected(view, 0, 400.0, 300.0)[0] < -1e6


def test_lens_that_folds_the_image_is_refused() -> None:
    recording = ScannedPlane(focal_px=60.0, frames=1, cameras=2).recording()
    recording.attrs["distortion"] = [-1.5, 0.0, 0.0, 0.0]
    assert "not invertible at row 0, column 0" in lens_problems(recording)[0].message
    with pytest.raises(st.EstimateError, match=r"attrs\.distortion: is not invertible"):
        st.estimate(recording, "refined")


@pytest.mark.parametrize("lens", [Distortion(k1=-0.3, k2=0.1, p1=2e-3, p2=-1e-3), *by_night(Distortion(k1=0.4))])
def test_estimates_are_those_of_the_distorted_pixels(lens: Distortion) -> None:
    """Without correction, depth is off by the relative change of distances: by up to 3 k1 r², here a tenth."""
    plane = ScannedPlane(focal_px=150.0, depth_mm=300.0, baseline_mm=6.0, distortion=lens, noise_std=0.005, frames=3)
    found = st.estimate(plane.recording(), "refined", SETTINGS).sel(t=0)
    inner = (..., slice(14, -14), slice(14, -14))
    valid = found["valid"].values[inner]
    assert valid.mean() > 0.9
    truth = plane.truth()
    for name in ("disparity", "velocity"):
        error = (found[name].values - truth[name])[inner] / found[f"{name}_std"].values[inner]
        assert np.sqrt(np.mean(error[..., valid] ** 2)) < 1.6
    scale = plane.focal_px / plane.truth()["disparity"].mean() * plane.baseline_mm
    across = found["velocity_std"].values[:2][inner] * plane.focal_px / scale
    flow = (found["flow"].values - truth["flow"])[inner] / across
    assert np.sqrt(np.mean(flow[..., valid] ** 2)) < 2


def test_flow_of_one_camera_is_that_of_the_distorted_images() -> None:
    """The tolerances of a stage do not concern a camera that stays where it is."""
    plane = ScannedPlane(focal_px=150.0, depth_mm=300.0, cameras=1, distortion=Distortion(k1=0.4), frames=5)
    recording = plane.recording(stage_tolerances={"yaw_urad": 1e4})
    found = st.estimate(recording, "refined", SETTINGS).sel(t=0)
    inner = (..., slice(14, -14), slice(14, -14))
    assert np.abs((found["flow"].values - plane.truth()["flow"])[inner]).max() < 0.01
    assert "image_shift" not in found


def test_maps_are_put_back_where_the_pixels_see_them() -> None:
    """A linear map stays linear; across a step, no value is interpolated."""
    lens = Lens(COEFFICIENTS, 150.0, (31.5, 23.5), (48, 64))
    y, x = np.mgrid[:48, :64].astype(np.float64)
    maps = {"disparity": 5.0 + 0.01 * x, "status": np.full((48, 64), 2, dtype=np.uint8)}
    maps |= {"invalid_reason": np.zeros((48, 64), dtype=np.uint8)}
    found = lens.put_back(maps, 0.25)
    undistorted = 150.0 * undistort(COEFFICIENTS, np.stack([x - 31.5, y - 23.5]) / 150.0)[0] + 31.5
    inside = found["status"] == 2
    assert 0.8 < inside.mean() < 1
    np.testing.assert_allclose(found["disparity"][inside], 5.0 + 0.01 * undistorted[inside], rtol=1e-12)
    assert (found["invalid_reason"][~inside] > 0).all()
    nothing = lens.put_back(maps | {"disparity": np.full((48, 64), np.nan)}, 0.25)
    assert np.isnan(nothing["disparity"]).all()
    step = lens.put_back(maps | {"disparity": np.where(x < 30, 5.0, 9.0)}, 0.25)
    assert set(np.unique(step["disparity"][inside].round(9))) == {5.0, 9.0}
