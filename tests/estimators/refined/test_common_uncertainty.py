"""Uncertainty that pixels have in common, against the change of estimates by the very errors."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.camera import Distortion
from scenetruth.estimators.refined import (
    CalibrationUncertainty,
    compute_common_variance,
    distort,
    read_calibration_uncertainty,
)
from tests.helpers.scanned_plane import ScannedPlane

Array = NDArray[np.float64]
SIZE, FOCAL, BASELINE = (5, 7), 800.0, 4.0
D, Q = np.full(SIZE, 12.0), np.array([0.2, -0.1, 0.3])[:, None, None] * np.ones((3, *SIZE))


def measured(focal: float, baseline: float, c_x: float) -> tuple[float, Array]:
    """Return depth and velocity of the same images, analysed with other intrinsics: d, flow and its rate are seen."""
    x = 100.0 - c_x
    d, rate = 12.0, 12.0 * 0.3 / FOCAL
    flow = 12.0 * 0.2 - 100.0 * rate
    depth = focal * baseline / d
    ahead = rate / d * focal
    return depth, np.array([(flow + x * rate) / d, -0.1, ahead]) * baseline


@pytest.mark.parametrize(
    ("given", "changed"),
    [
        (CalibrationUncertainty(focal=1e-3), (FOCAL * 1.001, BASELINE, 0.0)),
        (CalibrationUncertainty(scale=2e-3), (FOCAL, BASELINE * 1.002, 0.0)),
        (CalibrationUncertainty(centre=(3.0 / FOCAL, 0.0)), (FOCAL, BASELINE, 3.0)),
    ],
)
def test_errors_of_calibration(given: CalibrationUncertainty, changed: tuple[float, float, float]) -> None:
    found = compute_common_variance(given, None, D, Q)
    depth, velocity = measured(FOCAL, BASELINE, 0.0)
    other_depth, other_velocity = measured(*changed)
    assert np.sqrt(found.depth[0, 0]) * depth == pytest.approx(abs(other_depth - depth), abs=1e-9)
    stated = np.sqrt(found.velocity[:, 0, 0]) * BASELINE
    np.testing.assert_allclose(stated, np.abs(other_velocity - velocity), atol=1e-9)


def test_pose_errors_add_to_those_of_the_calibration() -> None:
    poses = np.array([0.01, 1e-4, 2e-4, 3e-4])[:, None, None] ** 2 * np.ones((4, *SIZE))
    found = compute_common_variance(CalibrationUncertainty(scale=1e-3), poses, D, Q)
    np.testing.assert_allclose(found.disparity, 0.01**2 + (12e-3) ** 2)
    np.testing.assert_allclose(found.depth, (0.01 / 12) ** 2 + 1e-6)
    np.testing.assert_allclose(found.velocity[0], 1e-8 + 0.04e-6)


def test_coefficients_change_short_distances() -> None:
    """An error of k1 changes distances along x by σ (3 x² + y²), relatively."""
    recording = ScannedPlane(distortion=Distortion(k1=-0.1), frames=1, cameras=2, focal_px=200.0).recording(
        lens_tolerances={"distortion_std": [0.02, 0, 0, 0, 0, 0, 0, 0]}
    )
    lens = read_calibration_uncertainty(recording).lens
    assert lens is not None
    y, x = np.mgrid[:72, :96].astype(np.float64)
    x, y = (x - 47.5) / 200.0, (y - 35.5) / 200.0
    np.testing.assert_allclose(lens[0][:, 1:-1], (0.02 * (3 * x**2 + y**2))[:, 1:-1], rtol=0.01, atol=1e-6)
    assert distort(np.zeros(8), np.stack([x, y])) == pytest.approx(np.stack([x, y]))


def test_total_contains_the_common_part() -> None:
    plane = ScannedPlane(noise_std=0.005, frames=3)
    settings = {"window_sigma_px": 4.0, "window_frames": 3, "surface": "plane", "discontinuity_refit": False}
    bare = st.estimate(plane.recording(), "refined", settings).sel(t=0)
    stated = plane.recording(stage_tolerances={"scale_ppm": 1e3}, lens_tolerances={"focal_length_std_px": 2.0})
    found = st.estimate(stated, "refined", settings).sel(t=0)
    assert "depth_std_common" not in bare
    valid = found["valid"].values
    common = found["depth_std_common"].values[valid]
    np.testing.assert_allclose(common, (found["depth"].values * np.hypot(1e-3, 2e-3))[valid], rtol=1e-4)
    total, own = found["depth_std"].values[valid], bare["depth_std"].values[valid]
    np.testing.assert_allclose(total, np.hypot(own, common), rtol=1e-3)
    # Without stage errors between images, nothing is corrected.
    assert "image_shift" not in found
