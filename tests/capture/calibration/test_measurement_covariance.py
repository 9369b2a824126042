"""Errors of depth and velocity by a calibration, against closed forms and drawn calibrations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from scenetruth.camera import StageErrors
from scenetruth.capture.calibration import (
    CommonError,
    Moment,
    RigGeometry,
    RigLayout,
    RigPriors,
    common_error,
    moving_point_modes,
    point_modes,
    triangulate,
)
from tests.helpers.drawn_rigs import draw_rig
from tests.helpers.nightly import by_night

F, Z = 5016.0, 660.0
X_MM = np.array([-10.0, -5.0, 0.0, 5.0, 10.0])
RIG = draw_rig(0, poses=1)
LAYOUT = RigLayout.from_observations(RIG.observations, RIG.priors)
REFERENCE = 2


def points(columns: int = 3) -> np.ndarray:
    x, y = np.meshgrid(np.linspace(-40, 40, columns), np.linspace(-30, 30, columns))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, Z)], axis=-1)


def ideal() -> np.ndarray:
    values = np.zeros(LAYOUT.size)
    values[:3] = F, 319.5, 239.5
    return values


def single(name: str, std: float) -> np.ndarray:
    covariance = np.zeros((LAYOUT.size, LAYOUT.size))
    index = LAYOUT.names.index(name)
    covariance[index, index] = std**2
    return covariance


def error_of_depth(covariance: np.ndarray, **more: np.ndarray) -> CommonError:
    return common_error(ideal(), covariance, LAYOUT, X_MM, REFERENCE, [Moment(points())], **more)[2]


def test_focal_length_and_step_scale_the_depth() -> None:
    """dZ / Z = df / f and the step error; differences of 1e-8 come from the finite steps."""
    np.testing.assert_allclose(error_of_depth(single("f", 1.0)).std, Z / F, rtol=1e-6)
    np.testing.assert_allclose(error_of_depth(single("step_scale", 1e-4)).std, 1e-4 * Z, rtol=1e-6)


def test_yaw_of_every_position_on_the_axis() -> None:
    """dZ / Z = Z / d * sum(s yaw) / sum(s^2) at the principal point, for positions about the reference."""
    centre = np.array([[0.0, 0.0, Z]])
    for position, x in enumerate(X_MM):
        if position == REFERENCE:
            continue
        covariance = single(f"position[{position}].yaw", 1e-4)
        found = common_error(ideal(), covariance, LAYOUT, X_MM, REFERENCE, [Moment(centre)])[2].std
        # The camera sees the point at an angle of x / Z.
        expected = Z * Z * 1e-4 * abs(x) * (1 + (x / Z) ** 2) / (X_MM**2).sum()
        np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_visits_along_x() -> None:
    """1 µm at each visit: dZ = Z * sum(x e) / sum(x^2), and for the reference's own error 0 by symmetry."""
    std = np.array([0, 0, 0, 1e-3, 0, 0])
    found = error_of_depth(np.zeros((LAYOUT.size, LAYOUT.size)), visit_std=std)
    np.testing.assert_allclose(found.std, Z * 1e-3 / np.sqrt((X_MM**2).sum()), rtol=1e-3)
    # Two independent frames.
    rates = common_error(
        ideal(), np.zeros((LAYOUT.size, LAYOUT.size)), LAYOUT, X_MM, REFERENCE, [Moment(points()), Moment(points())],
        visit_std=std,
    )[2]  # fmt: skip
    np.testing.assert_allclose(rates.std, np.sqrt(2) * found.std, rtol=1e-9)


def test_velocity_scales_with_focal_length_and_step() -> None:
    later = points() + [0.2, 0.0, 0.5]
    both = [
        common_error(ideal(), single(name, std), LAYOUT, X_MM, REFERENCE, [Moment(points()), Moment(later)])
        for name, std in (("step_scale", 1e-3), ("f", 1.0))
    ]
    for axis, shift in ((0, 0.2), (1, 0.0), (2, 0.5)):
        # The step scales all lengths.
        np.testing.assert_allclose(both[0][axis].std, 1e-3 * shift, rtol=1e-5, atol=1e-9)
    # The focal length scales depth alone: Z is proportional to f, X = x Z / f is not changed.
    np.testing.assert_allclose(both[1][2].std, 0.5 / F, rtol=1e-5)
    np.testing.assert_allclose(both[1][0].std, 0, atol=1e-8)


def test_differences_within_a_map_do_not_contain_the_common_part() -> None:
    found = error_of_depth(single("f", 1.0) + single("step_scale", 1e-4))
    weights = np.zeros(len(points()))
    weights[0], weights[-1] = 1.0, -1.0
    assert found.contrast(weights) < 1e-6 * found.mean_std
    assert found.rest_rms < 1e-4 * found.mean_std
    assert len(found.modes) == 1


def test_modes_sum_to_the_covariance() -> None:
    generator = np.random.default_rng(1)
    root = generator.standard_normal((6, 6))
    found = CommonError.from_covariance(root @ root.T)
    np.testing.assert_allclose(found.modes.T @ found.modes, found.covariance, atol=1e-10)
    assert (np.diff((found.modes**2).sum(axis=1)) <= 0).all()


@pytest.mark.parametrize("seed", [1, *by_night(2)])
def test_covariance_is_that_of_drawn_calibrations(seed: int) -> None:
    """Depths of 400 drawn parameter vectors: the standard deviation within 4 times 1 / sqrt(2 n)."""
    layout = RigLayout.from_observations(RIG.observations, RigPriors(errors=StageErrors(preset="air_bearing")))
    generator = np.random.default_rng(seed)
    std = np.where(
        np.isfinite(layout.std), layout.std, [1.0, 1.0, 1.0, 0.01, 1.0, 1e-4, 1e-4, *[0] * (layout.size - 7)]
    )
    std[layout.first_visit :] = 0
    values = draw_rig(seed, poses=1).truth.values[: layout.size].copy()
    covariance = np.diag(std**2)
    exact = RigGeometry.from_values(values, layout, X_MM, REFERENCE)
    seen = exact.project(exact.to_stage(points()))
    depths = []
    for _ in range(400):
        drawn = values + std * generator.standard_normal(layout.size)
        rig = RigGeometry.from_values(drawn, layout, X_MM, REFERENCE)
        depths.append(triangulate(rig, seen, points()[:, 2])[:, 2])
    stated = common_error(values, covariance, layout, X_MM, REFERENCE, [Moment(points())])[2].std
    np.testing.assert_allclose(np.std(depths, axis=0), stated, rtol=4 / np.sqrt(800))


def test_triangulation_returns_exact_points() -> None:
    rig = RigGeometry.from_values(RIG.truth.values, LAYOUT, X_MM, REFERENCE)
    seen = rig.project(rig.to_stage(points()))
    np.testing.assert_allclose(triangulate(rig, seen, np.full(9, 640.0)), points(), atol=1e-8)


@pytest.mark.parametrize(
    ("motion", "rate"),
    [
        ("y", lambda p: [0.0, 1.0, 0.0]),
        ("z", lambda p: [0.0, 0.0, 1.0]),
        ("pitch", lambda p: np.cross([1.0, 0.0, 0.0], p)),
        ("roll", lambda p: np.cross([0.0, 0.0, 1.0], p)),
    ],
)
def test_poses_that_drift_together_are_a_false_motion(motion: str, rate: Callable[[np.ndarray], np.ndarray]) -> None:
    """All cameras move or turn alike from frame to frame: every point seems to move by the opposite."""
    scans = draw_rig(0, poses=4)
    layout = RigLayout.from_observations(scans.observations, scans.priors)
    size = 1e-4 if motion in "yz" else 1e-7
    drift = np.zeros(layout.size)
    visits = np.array([[5 * frame + position for frame in range(4)] for position in range(5)])
    for frame in range(4):
        for position in range(5):
            drift[layout.names.index(f"visit[{visits[position, frame]}].{motion}")] = size * (frame - 1.5)
    values = np.zeros(layout.size)
    values[:3] = F, 319.5, 239.5
    # Cameras turn about their own centres, which are apart along X only.
    given = points() if motion != "roll" else points() * [1.0, 0.0, 1.0]
    modes, rates = moving_point_modes(values, np.outer(drift, drift), layout, X_MM, REFERENCE, given, visits)
    assert len(rates) == 1
    assert np.abs(modes).max() < 1e-6 * size
    expected = np.array([size * np.asarray(rate(point)) for point in given])
    sign = np.sign((rates[0] * expected).sum())
    np.testing.assert_allclose(sign * rates[0], expected, rtol=0, atol=2e-3 * np.abs(expected).max())
    same = moving_point_modes(values, single_in(layout, "f"), layout, X_MM, REFERENCE, given, visits)
    plain = point_modes(values, single_in(layout, "f"), layout, X_MM, REFERENCE, given)
    np.testing.assert_allclose(np.abs(same[0]), np.abs(plain), rtol=1e-9, atol=1e-12)
    assert np.abs(same[1]).max() == 0


def single_in(layout: RigLayout, name: str) -> np.ndarray:
    covariance = np.zeros((layout.size, layout.size))
    index = layout.names.index(name)
    covariance[index, index] = 1.0
    return covariance
