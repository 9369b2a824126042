"""Projection of a rig against the camera of a scene, its derivatives against differences, and its errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenetruth import ArgumentError
from scenetruth.camera import StageErrors, Viewpoint
from scenetruth.capture.calibration import (
    CalibrationTarget,
    Observations,
    RigLayout,
    RigPriors,
    RigState,
    project,
    rotation_matrix,
)
from tests.helpers.drawn_rigs import SIZE, draw_rig

NEW_ANGLES = RigPriors(visit_errors=StageErrors(pitch_urad=20, yaw_urad=20, roll_urad=5, straightness_um=1))

HELD = CalibrationTarget(half_width_mm=36.0, scale_std=1e-4, warp_mm=0.02, bend_mm=0.2, point_mm=(0.02, 0.1))
"""A board that is bent anew in every pose, whose points are not quite on a grid."""


def crooked(seed: int) -> tuple[RigState, Observations]:
    """A rig whose parameters all differ from zero, also the coefficients that are usually fixed."""
    rig = draw_rig(seed, poses=2, positions=3, priors=NEW_ANGLES, board=HELD)
    generator = np.random.default_rng(seed)
    values = rig.truth.values.copy()
    rest = slice(11, rig.truth.layout.first_pose)
    values[rest] += 0.01 * generator.standard_normal(values[rest].size)
    values[3:11] = [-0.6, 8.0, 1e-3, -8e-4, 5.0, 0.1, 0.2, 0.3]
    views = [replace(view, direction=(1, -1, 0)[view.visit % 3]) for view in rig.observations.views]
    return RigState(rig.truth.layout, values, rig.truth.turns), rig.observations.selected(views)


@given(st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_projection_is_that_of_a_camera_at_its_viewpoint(seed: int) -> None:
    """Exact to rounding: coordinates of some hundred px, and 20 operations."""
    state, views = crooked(seed)
    pixels, _ = project(views, state, derivatives=False)
    layout, values = state.layout, state.values
    camera = state.camera(*SIZE)
    start = 0
    for view, (position, visit, target, pose) in zip(views.views, layout.offsets(views.views), strict=True):
        turn = rotation_matrix(values[position : position + 3] + values[visit : visit + 3])
        along = (
            views.positions_mm[view.position] * (1 + values[13]) - view.direction * values[14] / 2 + values[visit + 3]
        )
        centre = along * np.array([1, values[11], values[12]])
        centre += values[position + 3 : position + 6] + [0, *values[visit + 4 : visit + 6]]
        q, a, b, c = values[target : target + 4]
        u, v, w = (view.points_mm + values[layout.point_columns(view)]).T
        a, b, c = (a, b, c) + values[pose + 6 : pose + 9]
        sag = (a * u**2 + b * u * v + c * v**2) / 36**2
        sag += np.stack([u**3, u**2 * v, u * v**2, v**3], axis=-1) @ values[pose + 9 : pose + 13] / 36**3
        board = np.stack([(1 + q) * u, (1 + q) * v, (1 + q) * w + sag], axis=-1)
        world = board @ state.turns[layout.poses.index(view.pose)].T + values[pose + 3 : pose + 6]
        expected = camera.project(Viewpoint(centre, turn).to_camera(world))
        expected[:, 1] += values[15] * (expected[:, 1] - values[2])
        count = len(view.pixels)
        np.testing.assert_allclose(pixels[start : start + count], expected, atol=1e-9)
        start += count


@given(st.integers(0, 10_000))
@settings(max_examples=5, deadline=None)
def test_derivatives_are_those_of_central_differences(seed: int) -> None:
    state, views = crooked(seed)
    _, slopes = project(views, state, derivatives=True)
    layout = state.layout
    columns = layout.columns(views.views)
    dense = np.zeros((len(slopes), 2, layout.size))
    for view, column in enumerate(columns):
        part = slice(views.first[view], views.first[view + 1])
        dense[part, :, column] = slopes[part, :, :45]
        points = layout.point_columns(views.views[view])
        for row, own in zip(range(part.start, part.stop), points, strict=True):
            dense[row][:, own] = slopes[row, :, 45:]
    flat = dense.reshape(-1, layout.size)
    # Sums of some hundred products.
    scale = np.abs(flat).max(axis=0)
    np.testing.assert_allclose(
        layout.information(views, slopes), flat.T @ flat, rtol=1e-9, atol=1e-9 * np.outer(scale, scale).max()
    )
    gathered = layout.gather(views, slopes, views.pixels[:, :, None])[:, 0]
    np.testing.assert_allclose(gathered, flat.T @ views.pixels.ravel(), rtol=1e-9, atol=1e-8 * scale.max())
    for index, name in enumerate(layout.names):
        step = 1e-6 if name.endswith(("pitch", "yaw", "roll", "_y", "_z", "aspect")) else 1e-3
        ends = []
        for sign in (1, -1):
            values = state.values.copy()
            values[index] += sign * step
            moved = RigState(layout, values, state.turns)
            ends.append(project(views, moved, derivatives=False)[0])
        expected = (ends[0] - ends[1]) / (2 * step)
        # Differences lose 1e-13 px over the step, and are curved by its square.
        np.testing.assert_allclose(dense[:, :, index], expected, rtol=1e-6, atol=1e-12 * 500 / step)


def test_all_problems_of_observations_are_reported_together() -> None:
    views = draw_rig(0, poses=1, positions=3).observations
    bad = replace(views.views[0], position=9, covariance_px2=-views.views[0].covariance_px2)
    with pytest.raises(ArgumentError) as caught:
        replace(views, views=(bad, *views.views[1:]), positions_mm=np.array([0.0, 0.0, 5.0]))
    text = str(caught.value)
    assert "3 problems" in text
    assert "positions_mm: coincide" in text
    assert "positive definite" in text
    assert "p0_s0" in text


def test_exact_parts_of_a_rig_are_fixed() -> None:
    rig = draw_rig(0, poses=2, positions=3, priors=RigPriors(errors=StageErrors(), step_std=0, position_um=0))
    layout = RigLayout.from_observations(rig.observations, rig.priors)
    free = {name for name, std in zip(layout.names, layout.std, strict=True) if std > 0}
    assert not any(name.startswith(("position", "visit", "step", "backlash", "k3")) for name in free)
    assert {"f", "k1", "axis_y", "board.scale", "pose[1].z"} <= free
