"""What errors of pose and time do to images, against the projection of points by the camera itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from scipy.spatial.transform import Rotation

import scenetruth as st
from scenetruth.design.uncertainty import (
    ObservationModel,
    build_observation_model,
    displace_camera,
    disturb_poses,
    make_stage_schedule,
    shift_in_time,
)
from scenetruth.provenance import build_schedule
from tests.helpers.budget_scenes import laboratory


@pytest.fixture(scope="module")
def sight() -> ObservationModel:
    scene = laboratory(everything=False)
    recording, truth = st.simulate(scene, save_radiance=True)
    return build_observation_model(scene, recording, truth, np.ones((108, 144), dtype=np.bool_))


def shown(sight: ObservationModel, s: int, t: float, off_mm: np.ndarray, turn_rad: np.ndarray) -> np.ndarray:
    """Where a camera with errors shows the points: positions from the principal point, shape (2, y, x)."""
    focal, depth = sight.intrinsics.focal_length_px, sight.depth
    points = np.stack([sight.points.x * depth / focal, sight.points.y * depth / focal, depth])
    points += t * sight.velocity
    camera = np.array([s * sight.intrinsics.baseline_mm, 0.0, 0.0]) + off_mm
    away = np.einsum("ji,jyx->iyx", Rotation.from_rotvec(turn_rad).as_matrix(), points - camera[:, None, None])
    return np.asarray(focal * away[:2] / away[2])


@settings(max_examples=15, deadline=None)
@given(
    s=some.sampled_from([-2, 0, 1]),
    t=some.sampled_from([-2, 0, 2]),
    off=some.lists(some.floats(-0.02, 0.02), min_size=3, max_size=3),
    turn=some.lists(some.floats(-2e-4, 2e-4), min_size=3, max_size=3),
)
def test_errors_of_pose_move_images_as_projections_do(
    sight: ObservationModel, s: int, t: int, off: list[float], turn: list[float]
) -> None:
    off_mm, turn_rad = np.array(off), np.array(turn)
    exact = shown(sight, s, t, off_mm, turn_rad) - shown(sight, s, t, np.zeros(3), np.zeros(3))
    change = displace_camera(sight, s, t, off_mm, turn_rad)
    # Second order: f times a tenth of the product of the largest angles, 720 * 2e-4 * 2e-4 px and little more.
    np.testing.assert_allclose(np.stack([change.x, change.y]), exact, rtol=0, atol=2e-4)


def test_a_later_time_is_motion(sight: ObservationModel) -> None:
    change = shift_in_time(sight, 1, 1, 0.25)
    exact = shown(sight, 1, 1.25, np.zeros(3), np.zeros(3)) - shown(sight, 1, 1, np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(np.stack([change.x, change.y]), exact, rtol=0, atol=1e-6)


def test_the_stage_of_a_scene_is_that_of_its_simulation(sight: ObservationModel) -> None:
    scene = laboratory()
    real, told = build_schedule(scene).moment(1, -1), make_stage_schedule(scene).moment(1, -1)
    np.testing.assert_array_equal(told.viewpoint.position_mm, real.viewpoint.position_mm)
    change = disturb_poses(make_stage_schedule(scene), sight)(1, -1)
    assert change is not None
    off = real.viewpoint.position_mm - build_schedule(scene).nominal(1, -1).viewpoint.position_mm
    by_pose, by_time = displace_camera(sight, 1, -1, off, real.rotation_rad), shift_in_time(sight, 1, -1, real.t + 1)
    np.testing.assert_allclose(change.x, by_pose.x + by_time.x)


def test_maps_of_images_are_fetched_where_points_are(sight: ObservationModel) -> None:
    columns = np.broadcast_to(np.arange(144.0), (108, 144))
    place = sight.place(1, 0)
    inside = (place.x > sight.points.x[0, 0]) & (place.x < sight.points.x[0, -1])
    found = sight.fetched(columns, 1, 0)
    np.testing.assert_allclose(found[inside], (place.x - sight.points.x[0, 0])[inside], atol=0.5)
