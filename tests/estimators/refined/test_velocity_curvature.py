"""The smooth part of the velocity: removed before windows are fitted, and added to the result."""

from __future__ import annotations

from typing import Any

import numpy as np

import scenetruth as st
from scenetruth.estimators.refined import blank_fit, initial_parameters, smooth_velocity
from tests.helpers.nightly import nightly
from tests.helpers.wavy_plane import MovingPlane, turning

SHAPE, SIGMA_PX = (61, 82), 3.0


def test_polynomials_of_second_order_are_smooth() -> None:
    """Up to the end of a surface and beyond, whatever the other surface does; small ones have none."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 50.0
    near, far = (np.stack([a + x * x, a * y - x * y, x - a * y * y]) for a in (1.0, -3.0))
    left = x < 0.8
    fields = np.concatenate([np.ones((1, *SHAPE)), np.where(left, near, far)])
    fit = blank_fit(initial_parameters(fields, accelerated=False), variances=True)
    fit.variance[:] = np.exp(np.sin(9 * x))
    among = np.abs(x - 0.8) > 0.1
    found = smooth_velocity(fit, among, SIGMA_PX)
    np.testing.assert_allclose(found[:, left], near[:, left], atol=2e-3)
    np.testing.assert_allclose(found[:, ~left & among], far[:, ~left & among], atol=2e-3)
    small = (x < 0.1) & (y < 0.1)
    assert not np.isfinite(smooth_velocity(fit, small, SIGMA_PX)).any()


@nightly
def test_a_plane_keeps_its_fit() -> None:
    """Its velocity is of second order in the image by perspective alone, which windows know without the smooth part."""
    plane = MovingPlane(gradient=np.diag([0.012, -0.006, 0.0]) + turning(1e-3, 2e-3, -1e-3))
    recording = plane.recording(noise_std=0.002, seed=4)
    found, fixed = (
        st.estimate(
            recording,
            "refined",
            window_sigma_px=4.0,
            motion=motion,
            acceleration=False,
            surface="plane",
            discontinuity_refit=False,
        ).isel(t=0, y=slice(16, -16), x=slice(34, -34))
        for motion in ("auto", "affine")
    )
    affine = found["motion_model"].values == 2
    assert affine.mean() > 0.4
    truth = plane.truth()
    for name in ("growth_rate", "velocity"):
        std = fixed[f"{name}_std"].values
        assert np.nanmedian(np.abs((found[name] - fixed[name]).values / std)[..., affine]) < 0.4
        error = (found[name].values - truth[name][..., 16:-16, 34:-34]) / found[f"{name}_std"].values
        assert np.sqrt(np.nanmean(error[..., affine] ** 2)) < 1.3


@nightly
def test_growth_that_changes_within_windows() -> None:
    """By its mean over 28 mm: without the smooth part, growth errs by 1.7 standard deviations and U_X by 2.1."""
    growth = {"kind": "growth", "rate_per_hour": 0.6, "along_share": 0.7, "base_to_tip": [4.0, 0.0]}
    sheet = {
        "name": "sheet",
        "mesh": {"kind": "saddle", "size_mm": [60, 44], "curvature_per_mm": 0.002},
        "texture": {"kind": "noise", "wavelength_mm": [1.0, 5.0], "mean": 0.5, "rms_contrast": 0.25},
        "pose": {"position_mm": [0, 0, 600], "rotations": [{"axis": [0, 1, 0], "angle_deg": 12}]},
        "deformation": [{**growth, "base_mm": -55, "tip_mm": 55}],
    }
    scene = {
        "camera": {"width": 110, "height": 84, "focal_length_px": 2400},
        "stage": {"positions": 5, "baseline_mm": 5.0},
        "frames": {"count": 9, "frame_interval_s": 60},
        "objects": [sheet],
        "sensor": {"bit_depth": 12, "noise_std": 0.005},
        "seed": 2,
    }
    recording, truth = st.simulate(scene)
    found = st.estimate(recording, "refined", acceleration=False, discontinuity_refit=False)
    inner: dict[str, Any] = {"y": slice(16, -16), "x": slice(20, -20)}
    found, truth = found.isel(t=0, **inner), truth.sel(t=found["t"][0]).isel(inner)
    error = (found["growth_rate"] - truth["growth_rate"]).values / found["growth_rate_std"].values
    assert np.sqrt(np.nanmean(error**2)) < 1.5
