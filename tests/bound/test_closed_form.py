"""The closed formulas against the maps of planes with even textures."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.bound import ClosedFormBound, closed_form_bound, cramer_rao_bound, texture_gradient
from scenetruth.bound.unknowns import Motion
from scenetruth.errors import RecordingError
from tests.helpers.bound_planes import plane_of, truth_of

RIG = {"focal_length_px": 1000.0, "baseline_mm": 2.0, "positions": 3, "frames": 5, "depth_mm": 500.0}
TEXTURE = {"gradient": 0.05, "noise_std": 0.01, "window_sigma_px": 3.0}


@pytest.mark.parametrize("motion", ["translation", "rigid", "growing", "affine"])
def test_they_agree_with_the_maps(motion: Motion) -> None:
    """Within 30 %: the texture of a window is not that of all, and its derivatives along x and y are not alike."""
    plane = plane_of(size=(40, 100), slopes=(0.0, 0.0), velocity_mm=(0.0, 0.0, 0.0), waves=200, baseline_mm=12.0)
    recording = plane.recording(3, 5)
    maps = cramer_rao_bound(
        truth_of(plane),
        recording.assign(radiance=recording["image"]),
        noise_std=0.01,
        window_sigma_px=3.0,
        motion=motion,
    ).isel(t=0, y=slice(8, -8), x=slice(32, -32))
    # 0.1 is the contrast of these planes, whose waves are as many in each octave.
    texture = {**TEXTURE, "gradient": texture_gradient(0.1, (8.0, 16.0), -2.0)}
    told = closed_form_bound(**{**RIG, **texture, "baseline_mm": 12.0}, motion=motion)  # type: ignore[arg-type]
    expected = {
        "disparity_std": told.disparity_px,
        "depth_std": told.depth_mm,
        "slope_std": told.slope,
        "flow_std": told.flow_px,
    }
    for name, std in expected.items():
        assert np.median(maps[name]) == pytest.approx(std, rel=0.3), name
    assert np.median(maps["velocity_std"][2]) == pytest.approx(told.velocity_depth_mm, rel=0.3)
    # Away from the principal point, U_X has a share of U_Z's error.
    share = (maps["x"] - 49.5).values / 1000.0
    lateral = np.hypot(told.velocity_lateral_mm, share * told.velocity_depth_mm)
    assert np.median(maps["velocity_std"][0] / lateral) == pytest.approx(1.0, abs=0.3)
    if told.growth_rate is not None:
        assert np.median(maps["growth_rate_std"]) == pytest.approx(told.growth_rate, rel=0.3)
    assert (told.growth_rate is None) == ("growth_rate_std" not in maps)


def test_they_scale_as_they_say() -> None:
    def at(**changes: float) -> ClosedFormBound:
        return closed_form_bound(**{**RIG, **TEXTURE, **changes})  # type: ignore[arg-type]

    one, wide, long = at(), at(baseline_mm=4.0), at(frames=9)
    assert wide.depth_mm == pytest.approx(one.depth_mm / 2)
    assert wide.flow_px == one.flow_px
    # Σt² of 9 frames is 60, of 5 it is 10.
    assert long.flow_px == pytest.approx(one.flow_px / np.sqrt(6))
    assert long.disparity_px == pytest.approx(one.disparity_px * np.sqrt(5 / 9))
    noisy, coarse = at(noise_std=0.02), at(gradient=0.025)
    assert noisy == coarse
    assert noisy.velocity_depth_mm == pytest.approx(2 * one.velocity_depth_mm)
    # Sums over windows of 3 and 6 px that end at twice that: their outermost pixels count in full, here 2 % and 4 %.
    large = at(window_sigma_px=6.0)
    assert large.depth_mm == pytest.approx(one.depth_mm / 2, rel=0.02)
    assert large.slope == pytest.approx(one.slope / 4, rel=0.06)


def test_growth_hides_motion_in_depth_behind_a_short_baseline() -> None:
    """With a long baseline, all comes from the change of disparity, and growth takes nothing away."""
    ratios = [
        closed_form_bound(**{**RIG, **TEXTURE, "baseline_mm": baseline}, motion="growing").velocity_depth_mm  # type: ignore[arg-type]
        / closed_form_bound(**{**RIG, **TEXTURE, "baseline_mm": baseline}).velocity_depth_mm  # type: ignore[arg-type]
        for baseline in (0.2, 2.0, 200.0)
    ]
    assert ratios[0] > ratios[1] > ratios[2] >= 1.0
    assert ratios[2] == pytest.approx(1.0, abs=1e-3)


def test_a_single_frame_tells_no_motion() -> None:
    found = closed_form_bound(**{**RIG, **TEXTURE, "frames": 1})  # type: ignore[arg-type]
    assert np.isfinite(found.depth_mm)
    assert np.isinf([found.flow_px, found.velocity_lateral_mm, found.velocity_depth_mm]).all()


def test_the_gradient_is_that_of_waves() -> None:
    """Waves of all directions: half of the squared gradient lies along each axis."""
    x = np.arange(10_000) * 0.01
    wave = 3.0 * np.sqrt(2) * np.sin(2 * np.pi * x / 5.0)
    assert np.std(np.gradient(wave, 0.01)) / np.sqrt(2) == pytest.approx(texture_gradient(3.0, 5.0), rel=1e-3)
    for exponent in (0.0, -2.0, -4.0, 1.5):
        narrow = texture_gradient(3.0, (4.999, 5.001), exponent)
        assert narrow == pytest.approx(texture_gradient(3.0, 5.0), rel=1e-6)
    # Against sums over rings.
    f = np.linspace(1 / 30, 1 / 6, 20_001)
    for exponent in (0.0, -2.0, 1.0):
        power = f ** (exponent + 1)
        expected = 2 * np.pi * 3.0 * np.sqrt((power * f**2).sum() / power.sum() / 2)
        assert texture_gradient(3.0, (6.0, 30.0), exponent) == pytest.approx(expected, rel=1e-3)


def test_all_that_is_wrong_is_listed() -> None:
    with pytest.raises(RecordingError, match=r"(?s)depth_mm.*gradient.*motion"):
        closed_form_bound(**{**RIG, **TEXTURE, "depth_mm": 0.0, "gradient": -1.0, "motion": "wild"})  # type: ignore[arg-type]
    with pytest.raises(RecordingError, match="wavelength_px"):
        texture_gradient(1.0, 0.0)
