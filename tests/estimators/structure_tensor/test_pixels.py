"""Estimates of a part of the images, or of every second pixel, stand at the pixels of the camera."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import scenetruth as st
from scenetruth.errors import RecordingError
from scenetruth.schema import STATUS_VALID
from tests.estimators.structure_tensor.analytic import Plane

# Moves in depth, so that a wrong principal point would show as a motion along X.
PLANE = Plane(depth_mm=488.0, velocity=(0.1, -0.05, 0.3), size=(60, 90))
POINT: dict[str, Any] = {"working_point_px": 2, "flow_working_point_px": (0, 0)}


def test_a_crop_gives_the_same_estimate_as_the_whole() -> None:
    recording = PLANE.recording(np.arange(5.0) - 2, 9)
    rows, columns = slice(9, 57), slice(20, 80)
    whole = st.estimate(recording, **POINT).isel(y=rows, x=columns)
    part = st.estimate(recording.isel(y=rows, x=columns), **POINT)
    np.testing.assert_array_equal(part["x"], np.arange(20, 80))
    np.testing.assert_array_equal(part["y"], np.arange(9, 57))
    assert part.attrs["principal_point_px"] == recording.attrs["principal_point_px"]
    both = (part["status"].values == STATUS_VALID) & (whole["status"].values == STATUS_VALID)
    assert both.sum() > 400
    assert part["status"].where(whole["status"] != STATUS_VALID, 0).max() < STATUS_VALID
    for name in ("depth", "velocity", "disparity", "flow", "divergence"):
        np.testing.assert_allclose(
            part[name].values[..., both[0]], whole[name].values[..., both[0]], rtol=1e-4, atol=1e-5, err_msg=name
        )


@pytest.mark.parametrize("pyramid_levels", [0, 1])
def test_every_second_pixel_gives_depth_and_motion_undoubled(pyramid_levels: int) -> None:
    plane = Plane(depth_mm=488.0, velocity=(0.1, -0.05, 0.3), size=(100, 140), wavelengths_px=(12.0, 40.0))
    recording = plane.recording(np.arange(5.0) - 2, 9)
    chosen = slice(3, None, 2)
    settings: dict[str, Any] = {"pyramid_levels": 1} if pyramid_levels else POINT
    estimate = st.estimate(recording.isel(x=chosen, y=chosen), **settings).sel(t=0)
    truth = plane.truth()
    known = estimate["status"].values == STATUS_VALID
    assert known.sum() > 150
    error = {
        name: np.abs(estimate[name].values - truth[name][..., chosen, chosen])[..., known].max()
        for name in ("depth", "velocity", "disparity", "flow", "divergence")
    }
    # Pixels of the camera, though the estimator saw only half of them along either axis.
    assert error["disparity"] < 1e-3
    assert error["flow"] < 1e-3
    assert error["depth"] < 0.3
    assert error["velocity"] < 0.02
    np.testing.assert_array_equal(estimate["registration_disparity"].values[known] % 2, 0)
    assert estimate.attrs["working_point_px"] == 2


def test_uneven_pixels_are_refused() -> None:
    recording = PLANE.recording(np.arange(5.0) - 2, 9)
    with pytest.raises(RecordingError, match="x"):
        st.estimate(recording.isel(x=[*range(40), *range(50, 90)]), **POINT)
