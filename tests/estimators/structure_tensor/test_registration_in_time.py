"""Motions of many pixels per frame, and disparities of many values, against a plane in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import scenetruth as st
from scenetruth.schema import STATUS_VALID
from tests.estimators.structure_tensor.analytic import Plane
from tests.nightly import by_night

STAGE = np.arange(5.0) - 2


def median_errors(plane: Plane, frames: int, **settings: Any) -> tuple[dict[str, float], float]:
    estimate = st.estimate(plane.recording(STAGE, frames), **settings).sel(t=0)
    truth = plane.truth()
    known = estimate["status"].values == STATUS_VALID
    return {
        name: float(np.median(np.abs(estimate[name].values - truth[name])[..., known]))
        for name in ("disparity", "flow", "divergence", "velocity")
    }, float(known.mean())


FAST = Plane(velocity=(2.1, -1.6, 0.3), size=(104, 120))


@pytest.mark.parametrize("settings", [{"flow_working_point_px": (4, -3)}, {}, {"pyramid_levels": 1}], ids=str)
def test_registration_in_time(settings: dict[str, Any]) -> None:
    """Flow (4.2, -3.2) px per frame."""
    found, known = median_errors(FAST, 9, **settings)
    assert known >= 0.2
    assert found["disparity"] <= 1e-4
    assert found["flow"] <= 1e-4
    # Of u_z = 6e-4: a registered frame sees the scene expand about another point, and a flow that grows with u_z.
    assert found["divergence"] <= 0.05 * 6e-4
    assert found["velocity"] <= 0.01


def test_without_registration_it_fails() -> None:
    found, _ = median_errors(FAST, 9, flow_working_point_px=(0, 0), tau=0.0)
    assert found["flow"] >= 1


@pytest.mark.parametrize("levels", [1, 2])
def test_coarse_to_fine_finds_flows_that_vary_over_the_image(levels: int) -> None:
    """A near camera: from -5 to 5 px per frame, of which no single integer flow suits more than a part."""
    plane = Plane(
        focal_length_px=100, depth_mm=100.0, velocity=(0.0, 0.0, -6.0), size=(150, 180), wavelengths_px=(9, 40)
    )
    _, part = median_errors(plane, 5)
    found, known = median_errors(plane, 5, pyramid_levels=levels)
    assert known >= 0.3
    assert found["flow"] <= 0.05
    assert part < known
    assert found["velocity"] <= 0.2


def test_points_registered_by_hand_and_by_the_images_agree() -> None:
    by_hand = st.estimate(FAST.recording(STAGE, 9), working_point_px=2, flow_working_point_px=(4, -3))
    by_images = st.estimate(FAST.recording(STAGE, 9), working_point_px="auto", flow_working_point_px="auto")
    assert [2, 4, -3] in by_images.attrs["working_points_px"]
    both = (by_hand["status"].values == STATUS_VALID) & (by_images["status"].values == STATUS_VALID)
    assert both.sum() > 1000
    np.testing.assert_array_equal(by_hand["depth"].values[both], by_images["depth"].values[both])


def test_working_points_of_each_pixel_follow_a_slope() -> None:
    """Disparities from 7 to 13 px: wherever the images reach, each pixel takes the integer next to its own."""
    plane = Plane(depth_mm=100.0, slope=3.0, size=(64, 240), velocity=(0.01, 0.0, -0.02))
    recording = plane.recording(STAGE, 9)
    truth = plane.truth()["disparity"]
    assert truth.min() < 7
    assert truth.max() > 12.5
    each = st.estimate(recording).isel(t=0)
    known = each["status"].values == STATUS_VALID
    assert known.mean() >= 0.35
    away = np.abs(each["registration_disparity"].values - truth)[known]
    assert np.quantile(away, 0.95) <= 0.7
    error = np.abs(each["disparity"].values - truth)
    for single in (7, 9, 10, 11, 13):
        one = st.estimate(recording, working_point_px=single).isel(t=0)
        other = np.abs(one["disparity"].values - truth)
        both = known & (one["status"].values == STATUS_VALID)
        # Where the single one is next to the disparity too, both are the same.
        assert np.sqrt(np.mean(error[both] ** 2)) <= np.sqrt(np.mean(other[both] ** 2)) + 1e-6


@pytest.mark.parametrize("levels", [2, *by_night(3)])
def test_coarse_to_fine_keeps_a_far_background_of_fine_texture(levels: int) -> None:
    """Waves of 4 to 8 px are gone at a quarter of the resolution, where only what is near and coarse is left."""
    near, far = (
        Plane(depth_mm=300.0, velocity=(2.0, 0.0, 0.0), size=(160, 240), wavelengths_px=(12.0, 40.0)),
        Plane(depth_mm=1200.0, velocity=(0.05, 0.0, 0.0), size=(160, 240), wavelengths_px=(4.0, 8.0)),
    )
    recording, background = near.recording(STAGE, 9), far.recording(STAGE, 9)["image"]
    image = recording["image"].copy()
    image[..., 110:] = background[..., 110:].values
    behind = {"x": slice(135, 220), "y": slice(20, -20)}
    density = {}
    for number in (0, levels):
        found = st.estimate(recording.assign(image=image), tau="auto", pyramid_levels=number).sel(t=0).isel(behind)
        known = found["status"].values == STATUS_VALID
        density[number] = known.mean()
        assert np.abs(found["depth"].values[known] / 1200.0 - 1).max() < 0.01
    assert density[0] > 0.9
    assert density[levels] == pytest.approx(density[0], abs=0.02)
