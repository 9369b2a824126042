"""Motions of twins: the simplest type that agrees with measured velocities."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenetruth.capture.twin import MeasuredMotion, fit_motion

SHAPE = (40, 50)
STD = np.array([0.002, 0.002, 0.02])


def points() -> np.ndarray:
    y, x = np.indices(SHAPE, dtype=np.float64)
    z = 600 + 0.002 * (x - 25) ** 2 + 0.1 * y
    return np.stack([(x - 25) * z / 1000, (y - 20) * z / 1000, z], axis=-1)


def measured(velocity: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return velocities (h, w, 3) with noise, components first, and their standard deviations."""
    std = np.broadcast_to(STD[:, None, None], (3, *SHAPE)).copy()
    noise = std * np.random.default_rng(seed).standard_normal((3, *SHAPE))
    return np.moveaxis(velocity, -1, 0) + noise, std


small = st.floats(-0.02, 0.02)


@given(v=st.tuples(small, small, small), seed=st.integers(0, 10**6))
@settings(max_examples=10, deadline=None)
def test_a_translation_is_recovered(v: tuple[float, float, float], seed: int) -> None:
    found = fit_motion(points(), *measured(np.broadcast_to(v, (*SHAPE, 3)), seed))
    assert found.kind == "translation"
    # Five standard deviations of the mean of 2000 pixels.
    assert (np.abs(found.translation - v) < 5 * STD / np.sqrt(np.prod(SHAPE))).all()


@given(turn=st.tuples(small, small, small), seed=st.integers(0, 10**6))
@settings(max_examples=10, deadline=None)
def test_a_rigid_motion_is_recovered(turn: tuple[float, float, float], seed: int) -> None:
    turn_ = np.array(turn) + np.array([0.02, 0.0, 0.02])
    at = points()
    velocity = np.cross(turn_, at - at.reshape(-1, 3).mean(axis=0)) + (0.1, 0.0, -0.2)
    found = fit_motion(at, *measured(velocity, seed))
    # White noise leaves less than is required of the correlated noise of a method.
    assert found.kind in ("rigid", "translation")
    residual = np.sqrt(np.mean((found.velocity(at) - velocity) ** 2, axis=(0, 1)))
    assert (residual < 0.2 * STD + 1e-9).all() or found.kind == "translation"
    entries = found.to_entries()
    assert entries is not None
    assert entries[-1]["kind"] == "velocity"
    if found.kind == "rigid":
        assert np.allclose(
            np.array(entries[0]["axis"]) * np.deg2rad(entries[0]["rate_deg_per_frame"]),
            [found.gradient[2, 1], found.gradient[0, 2], found.gradient[1, 0]],
        )


def test_growth_is_affine_and_needs_positions() -> None:
    at = points()
    velocity = 0.01 * (at - at.reshape(-1, 3).mean(axis=0)) * (1, 1, 0)
    found = fit_motion(at, *measured(velocity, 1))
    assert found.kind == "affine"
    assert found.to_entries() is None
    vertices = at.reshape(-1, 3)
    moved = found.positions(vertices, found.velocity(at).reshape(-1, 3), 2.0)
    spread = np.ptp(moved[:, 0]) / np.ptp(vertices[:, 0])
    # exp(0.02), within five standard deviations of a slope: 0.002 / (8.7 mm sqrt(2000)) = 5e-6 per frame.
    assert spread == pytest.approx(np.exp(0.02), abs=1e-4)


def test_a_bending_is_a_field() -> None:
    at = points()
    velocity = np.stack([0 * at[..., 0], 0 * at[..., 0], 0.5 * np.sin(at[..., 0] / 5)], axis=-1)
    found = fit_motion(at, *measured(velocity, 2))
    assert found.kind == "field"
    assert np.sqrt(np.mean((found.velocity(at) - velocity)[..., 2] ** 2)) < STD[2]


def test_without_velocity_a_surface_is_at_rest() -> None:
    at = points()
    assert fit_motion(at, None, None).kind == "static"
    assert fit_motion(at, np.full((3, *SHAPE), np.nan), None).to_entries() == []


def test_a_rigid_motion_keeps_distances() -> None:
    gradient = np.array([[0, -0.3, 0.1], [0.3, 0, 0], [-0.1, 0, 0]])
    motion = MeasuredMotion("rigid", np.zeros(3), np.array([1.0, 2, 3]), gradient)
    at = points().reshape(-1, 3)[::97]
    moved = motion.positions(at, at, 1.7)
    assert np.linalg.norm(moved - moved[0], axis=1) == pytest.approx(np.linalg.norm(at - at[0], axis=1), abs=1e-9)
