"""Derivatives of where images show points, against differences of where they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.warp import ImageView
from scenetruth.estimators.refined.pose_corrections import compute_point_derivatives

Array = NDArray[np.float64]
VIEW = ImageView(
    np.array([-1.0, 0.0, 2.0, 1.0]),
    np.array([0.0, 1.0, 0.0, -1.0]),
    np.array([0.0, 1.0, -2.0, 3.0]),
    np.zeros((4, 4)),
    200.0,
    30.0,
    20.0,
)
FIELDS = np.array([[5.0, 8.0], [0.02, -0.01], [-0.03, 0.02], [0.4, -0.7]])
AT = np.array([[3.0, 44.0], [35.0, 8.0]])


def places(fields: Array, at: Array, acceleration: Array) -> Array:
    """Return where the images show points, shape (points, n, 2), by projection of points in space."""
    z = VIEW.focal / fields[0]
    point = np.stack([(at[0] - VIEW.centre_x) / VIEW.focal * z, (at[1] - VIEW.centre_y) / VIEW.focal * z, z])
    t = VIEW.t[:, None, None]
    moved = point + t * fields[1:] + 0.5 * t**2 * np.stack([*acceleration, np.zeros(2)])
    x = VIEW.focal * (moved[:, 0] - VIEW.s[:, None]) / moved[:, 2]
    y = VIEW.focal * (moved[:, 1] - VIEW.s_y[:, None]) / moved[:, 2]
    return np.stack([x, y], axis=-1).swapaxes(0, 1)


def test_derivatives_are_those_of_projected_points() -> None:
    found = compute_point_derivatives(VIEW, FIELDS, AT, accelerated=True).by_point
    # Central differences err by the square of the step times third derivatives, which are of the order of 1.
    step = 1e-4
    for k in range(8):
        ends = []
        for sign in (-1, 1):
            parts = [FIELDS.copy(), AT.copy(), np.zeros((2, 2))]
            part, row = (0, k) if k < 4 else (1, k - 4) if k < 6 else (2, k - 6)
            parts[part][row] += sign * step
            ends.append(places(*parts))
        expected = (ends[1] - ends[0]) / (2 * step)
        if 4 <= k < 6:
            # Columns and rows stand for a shift of the texture's grid, which moves with none of the images.
            expected = np.zeros_like(expected)
            expected[..., k - 4] = 1.0
        np.testing.assert_allclose(found[..., k], expected, atol=1e-5)


def test_corrections_move_turn_and_enlarge() -> None:
    found = compute_point_derivatives(VIEW, FIELDS, AT).by_image
    at = places(FIELDS, AT, np.zeros((2, 2)))
    angle, share = 1e-6, 1e-6
    turned = at @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) - at
    np.testing.assert_allclose(found[..., 2] * angle, turned, atol=1e-9)
    np.testing.assert_allclose(found[..., 3] * share, at * share, atol=1e-12)
    assert (found[..., :2] == np.eye(2)).all()
