"""Displacements since a reference frame against closed forms of growth, rotation and translation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.schema import label, read_intrinsics
from tests.helpers.deformed_planes import CAMERA, SHAPE, plane_points

Map = NDArray[np.float64]

FRAMES = (-2, -1, 0, 1, 2, 3)
RATE, TURN = 0.02, 0.01


def moving(std: float | None = None, **changes: Any) -> xr.Dataset:
    """Return a frontal plane that grows by RATE along X per frame, and turns about its normal and comes nearer."""
    rays = plane_points(0.0, distance_mm=1.0)
    depth = np.stack([np.full(SHAPE, 600.0 - 2.0 * t) for t in FRAMES])
    points = rays[:, None] * depth
    # The velocity of a point depends on its place only, apart from the steady approach.
    velocity = np.stack([RATE * points[0] - TURN * points[1], TURN * points[0], np.full(depth.shape, -2.0)])
    maps = {"depth": depth, "velocity": velocity} | changes
    if std is not None:
        maps |= {"velocity_std": np.full(velocity.shape, std), "depth_std": np.full(depth.shape, 0.0)}
    return label("estimate", maps, CAMERA, t=list(FRAMES), attrs={"settings": '{"window_sigma_px": 1.0}'})


def expected_strain(t: int) -> Map:
    """Return the Green-Lagrange strain of the flow of a constant velocity gradient, by its power series."""
    gradient = np.array([[RATE, -TURN], [TURN, 0.0]])
    flow = term = np.eye(2)
    for n in range(1, 20):
        term = term @ gradient * t / n
        flow = flow + term
    return np.asarray(0.5 * (flow.T @ flow - np.eye(2)))


def test_strain_since_a_frame_is_that_of_the_flow() -> None:
    strain = st.compute_strain(moving(), since=0, settings={"window": 5, "step": 3})
    assert strain.attrs["displacement_source"] == "velocity, integrated from frame 0"
    for t in FRAMES:
        frame = strain.sel(t=t)
        valid = frame["valid"].values
        assert valid.sum() > 200
        found = np.array([[frame["exx"], frame["exy"]], [frame["exy"], frame["eyy"]]])[:, :, valid]
        # The trapezoidal rule has an error of (L³ / 6) / 2 for every frame.
        error = abs(t) * math.hypot(RATE, TURN) ** 3
        wanted = np.broadcast_to(expected_strain(t)[:, :, None], found.shape)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=error + 1e-12)
        np.testing.assert_array_equal(frame["point"].values, strain.sel(t=0)["point"].values)
    assert float(strain["exx"].sel(t=3).max()) > 0.05


def test_points_that_leave_the_image_or_hide_are_lost() -> None:
    estimate = moving()
    estimate["depth"].values[4, :, 30:50] -= 80.0
    strain = st.compute_strain(estimate, since=0, settings={"window": 3, "step": 1})
    moved = strain["displacement"].sel(component="Z")
    assert np.isnan(moved.sel(t=2).values[:, 32:48]).all()
    assert np.isfinite(moved.sel(t=1).values[20:40, 32:48]).all()
    # Those on the right border grow out of the image within a frame.
    assert np.isnan(moved.sel(t=1).values[:, -1]).all()
    assert (strain["invalid_reason"].sel(t=2).values[:, 32:48] == 1).all()


def test_standard_deviations_of_frames_are_summed() -> None:
    strain = st.compute_strain(moving(std=1e-3), since=0, settings={"window": 5, "step": 3, "correlation_sigma_px": 0})
    inner = (slice(3, -3), slice(3, -3))
    one, three = (float(np.nanmean(strain["eyy_std"].sel(t=t).values[inner])) for t in (1, 3))
    # Lengths along Y do not change to first order, so that the sensitivity stays.
    assert three == pytest.approx(3 * one, rel=0.02)
    assert float(strain["exx_std"].sel(t=0).max()) == 0


def test_truth_of_a_growing_sheet_is_tracked() -> None:
    """Interpolation and the trapezoidal rule against the exact strain of the triangles."""
    from scenetruth.strain import compute_true_strain
    from tests.strain.test_true_strain import growing

    scene = growing(motion=[])
    truth = st.make_truth(scene)
    settings = {"measure": "hencky", "window": 5, "step": 2}
    found = st.compute_strain(truth, since=-1, settings=settings).sel(t=1)
    first = truth.sel(t=[-1])
    exact = compute_true_strain(first, scene, settings=settings, times=[1.0]).isel(t=0)
    exact = exact.sel({dim: found[dim].values for dim in ("y", "x")})
    valid = found["valid"].values
    assert valid.sum() > 100
    for name in ("exx", "eyy", "e1"):
        np.testing.assert_allclose(found[name].values[valid], exact[name].values[valid], rtol=0, atol=1e-5)


def test_reference_frame_must_exist() -> None:
    with pytest.raises(st.ScoreError, match="since: must be one of the frames"):
        st.compute_strain(moving(), since=9)
    with pytest.raises(st.ScoreError, match="does not apply"):
        st.compute_strain(moving(), since=0, settings={"measure": "rate"})
    with pytest.raises(st.ScoreError, match="needs two or more frames"):
        st.compute_strain(moving().sel(t=[0]), since=0)
    assert read_intrinsics(moving()) == CAMERA
