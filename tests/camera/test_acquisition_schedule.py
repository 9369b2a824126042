"""Real moments of images: statistics of errors, backlash and timing, against a stage that is followed step by step."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from scipy.spatial.transform import Rotation

from scenetruth.camera import Frames, ImageAcquisition, Schedule, Stage
from scenetruth.random_streams import generator_for
from tests.helpers.nightly import nightly

SCANS = ["unidirectional", "bidirectional"]


def schedule(count: int = 4, interval_s: float = 1.0, seed: int = 7, **stage: Any) -> Schedule:
    return Schedule(
        Stage.model_validate({"positions": 5, "baseline_mm": 5.0, **stage}),
        Frames(count=count, frame_interval_s=interval_s),
        partial(generator_for, seed, "stage"),
    )


def images(plan: Schedule) -> Iterator[tuple[int, int, int]]:
    stage = plan.stage
    return product(stage.s_y.tolist(), stage.s.tolist(), plan.frames.t.tolist())


def values(moment: ImageAcquisition) -> list[float]:
    return [moment.t, *moment.viewpoint.position_mm, *moment.viewpoint.rotation.ravel(), *moment.rotation_rad]


@pytest.mark.parametrize("stage", [{}, {"errors": {}}, {"scan": "bidirectional", "errors": {"yaw_urad": 0}}])
def test_a_perfect_stage_is_where_it_should_be_to_the_last_bit(stage: dict[str, Any]) -> None:
    plan = schedule(rows=3, row_spacing_mm=2.5, **stage)
    for s_y, s, t in images(plan):
        moment = plan.moment(s, t, s_y)
        assert values(moment) == values(plan.nominal(s, t, s_y))
        assert moment.t == t
        assert moment.viewpoint.position_mm.tolist() == [5.0 * s, 2.5 * s_y, 0]
        assert (moment.viewpoint.rotation == np.eye(3)).all()


def within_sampling_error(sample: np.ndarray[Any, Any], sigma: float) -> bool:
    """Whether mean and rms of independent normal numbers are within five standard errors of 0 and sigma."""
    count = sample.size
    rms = np.sqrt(np.mean(sample**2))
    return bool(abs(sample.mean()) < 5 * sigma / np.sqrt(count) and abs(rms / sigma - 1) < 5 / np.sqrt(2 * count))


@nightly
def test_errors_have_the_stated_statistics() -> None:
    errors = {"repeatability_um": 2, "straightness_um": 3, "pitch_urad": 40, "yaw_urad": 50, "roll_urad": 60}
    plan = schedule(count=10, positions=1001, baseline_mm=0.1, errors=errors)
    moments = {(s, t): plan.moment(s, t) for _, s, t in images(plan)}
    s_values, t_values = plan.stage.s.tolist(), plan.frames.t.tolist()
    off_um = np.array(
        [[1e3 * (moments[s, t].viewpoint.position_mm - (0.1 * s, 0, 0)) for t in t_values] for s in s_values]
    )
    turns = np.array([[1e6 * moments[s, t].rotation_rad for t in t_values] for s in s_values])
    # The guide is the same in all frames; what the drive misses is fresh in each.
    assert np.ptp(off_um[..., 1:], axis=1).max() == 0
    assert np.ptp(turns, axis=1).max() == 0
    samples = [(off_um[..., 0], 2), (off_um[:, 0, 1], 3), (off_um[:, 0, 2], 3)]
    samples += [(turns[:, 0, axis], sigma) for axis, sigma in enumerate((40, 50, 60))]
    for sample, sigma in samples:
        assert within_sampling_error(sample, sigma)
    independent = np.column_stack([*off_um[..., 0].T, off_um[:, 0, 1:], turns[:, 0]])
    correlation = np.corrcoef(independent.T) - np.eye(independent.shape[1])
    assert np.abs(correlation).max() < 5 / np.sqrt(1001)


def test_rotations_follow_the_right_hand() -> None:
    """Positive pitch looks up, positive yaw to the right, positive roll turns X towards Y."""
    errors = {"pitch_urad": 1e4, "yaw_urad": 2e4, "roll_urad": 3e4}
    plan = schedule(errors=errors)
    for s in plan.stage.s.tolist():
        moment = plan.moment(s, 0)
        pitch, yaw, roll = moment.rotation_rad
        right, _, forward = moment.viewpoint.rotation.T
        # To first order; the second is the product of two angles, below 0.06 * 0.09 / 2 at three standard deviations.
        np.testing.assert_allclose([-forward[1], forward[0], right[1]], [pitch, yaw, roll], atol=3e-3)
        expected = Rotation.from_rotvec(moment.rotation_rad).as_matrix()
        np.testing.assert_allclose(moment.viewpoint.rotation, expected, atol=1e-15)


def test_moments_do_not_depend_on_the_order_in_which_they_are_asked_for() -> None:
    stage: dict[str, Any] = {
        "rows": 2,
        "row_spacing_mm": 1,
        "scan": "bidirectional",
        "time_per_position_s": 0.02,
        "errors": {"preset": "screw_stage"},
    }
    one, two = schedule(**stage), schedule(**stage)
    keys = list(images(one))
    forwards = {(s_y, s, t): values(one.moment(s, t, s_y)) for s_y, s, t in keys}
    shuffled = np.random.default_rng(0).permutation(len(keys))
    backwards = {keys[k]: values(two.moment(keys[k][1], keys[k][2], keys[k][0])) for k in shuffled}
    assert forwards == backwards
    other = schedule(seed=8, **stage)
    assert values(other.moment(1, 0)) != forwards[0, 1, 0]


def test_a_position_keeps_its_errors_when_others_are_added() -> None:
    errors: dict[str, Any] = {"preset": "screw_stage", "backlash_um": 0}
    few, many = schedule(errors=errors), schedule(count=9, positions=11, rows=3, row_spacing_mm=1, errors=errors)
    for _, s, t in images(few):
        assert values(few.moment(s, t)) == values(many.moment(s, t))


def off_x_um(plan: Schedule, s: int, t: int, s_y: int = 0) -> float:
    place = int(np.flatnonzero(plan.stage.s == s)[0])
    return float(1e3 * (plan.moment(s, t, s_y).viewpoint.position_mm[0] - plan.stage.x_mm[place]))


@pytest.mark.parametrize(("baseline", "expected"), [(5.0, -2.0), (-5.0, 2.0)])
def test_backlash_of_a_unidirectional_scan_is_the_same_everywhere(baseline: float, expected: float) -> None:
    plan = schedule(baseline_mm=baseline, errors={"backlash_um": 4})
    for s_y, s, t in images(plan):
        assert off_x_um(plan, s, t, s_y) == pytest.approx(expected, abs=1e-9)


def test_backlash_of_a_bidirectional_scan_alternates_but_where_it_turns() -> None:
    plan = schedule(scan="bidirectional", errors={"backlash_um": 4})
    found = {t: [round(off_x_um(plan, s, t), 9) for s in range(-2, 3)] for t in (0, 1, 2)}
    # Upwards in even frames, downwards in odd ones; the first image of each is taken where the last one was.
    assert found[0] == found[2] == [2, -2, -2, -2, -2]
    assert found[1] == [2, 2, 2, 2, -2]


@given(
    positions=some.integers(1, 5),
    rows=some.integers(1, 3),
    scan=some.sampled_from(SCANS),
    sign=some.sampled_from([-1, 1]),
)
def test_drive_against_a_stage_followed_step_by_step(positions: int, rows: int, scan: str, sign: int) -> None:
    """Go through all images in the order of their times; the drive errs afresh if, and only if, it has moved."""
    common: dict[str, Any] = {
        "positions": positions,
        "baseline_mm": sign * 5.0,
        "rows": rows,
        "row_spacing_mm": 1,
        "scan": scan,
        "time_per_position_s": 1.0,
    }
    interval = Stage.model_validate(common).scan_interval_s
    lash = schedule(interval_s=interval, errors={"backlash_um": 4}, **common)
    drift = schedule(interval_s=interval, errors={"repeatability_um": 4}, **common)
    ordered = sorted(images(lash), key=lambda image: lash.moment(image[1], image[2], image[0]).t)
    here: int | None = None
    former = direction = None
    for s_y, s, t in ordered:
        error = drift.moment(s, t, s_y).viewpoint.position_mm[0] - sign * 5.0 * s
        moved = here != s or (scan == "unidirectional" and positions > 1)
        if here is not None:
            assert (error != former) == moved
            if moved:
                direction = sign if scan == "unidirectional" else sign * int(np.sign(s - here))
            if direction is not None:
                assert off_x_um(lash, s, t, s_y) == pytest.approx(-2 * direction, abs=1e-9)
        here, former = s, error


def test_images_follow_each_other_in_time() -> None:
    plan = schedule(interval_s=2.0, time_per_position_s=0.3)
    assert [plan.offset_s(s, 1) for s in range(-2, 3)] == pytest.approx([-0.6, -0.3, 0, 0.3, 0.6], abs=1e-15)
    assert plan.moment(2, 1).t == pytest.approx(1.3, abs=1e-15)
    assert plan.moment(0, 1).t == 1
    assert plan.nominal(2, 1).t == 1
    back = schedule(interval_s=2.0, time_per_position_s=0.3, scan="bidirectional")
    assert [back.offset_s(s, 1) for s in range(-2, 3)] == pytest.approx([0.6, 0.3, 0, -0.3, -0.6], abs=1e-15)
    assert [back.offset_s(s, 0) for s in range(-2, 3)] == pytest.approx([-0.6, -0.3, 0, 0.3, 0.6], abs=1e-15)


NUMBER = some.floats(-1e4, 1e4)
ANGLE = some.floats(-1e5, 1e5)


@given(
    off=some.lists(some.tuples(NUMBER, NUMBER, NUMBER, ANGLE, ANGLE, ANGLE), min_size=6, max_size=6),
    visit=some.tuples(NUMBER, NUMBER, NUMBER, ANGLE, ANGLE, ANGLE),
    tilt=some.tuples(ANGLE, ANGLE),
)
def test_listed_poses_are_those_of_the_images(
    off: list[tuple[float, ...]], visit: tuple[float, ...], tilt: tuple[float, float]
) -> None:
    names = ("x_um", "y_um", "z_um", "pitch_urad", "yaw_urad", "roll_urad")
    listed: list[dict[str, Any]] = [dict(zip(names, row, strict=True)) for row in off]
    listed[4]["visits"] = [{}, dict(zip(names, visit, strict=True)), {}]
    plan = schedule(
        count=3, positions=3, baseline_mm=100.0, rows=2, row_spacing_mm=7.0, poses=listed, axis_tilt_urad=tilt
    )
    for s_y, s, t in images(plan):
        number = 3 * s_y + s + 1
        total = np.array(off[number]) + (np.array(visit) if (number, t) == (4, 0) else 0)
        # In mm and rad: nominal position along the tilted axis, then the listed differences.
        place = np.array([100.0 * s, 7.0 * s_y, 0]) + 1e-6 * 100.0 * s * np.array([0, *tilt]) + 1e-3 * total[:3]
        moment = plan.moment(s, t, s_y)
        np.testing.assert_allclose(moment.viewpoint.position_mm, place, rtol=0, atol=1e-10)
        np.testing.assert_allclose(moment.rotation_rad, 1e-6 * total[3:], rtol=0, atol=1e-14)
        expected = Rotation.from_rotvec(1e-6 * total[3:]).as_matrix()
        np.testing.assert_allclose(moment.viewpoint.rotation, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("scan", SCANS)
def test_drawn_errors_that_are_listed_give_the_same_images(scan: str) -> None:
    errors = {"repeatability_um": 3, "backlash_um": 8, "straightness_um": 5, "yaw_urad": 90, "roll_urad": 20}
    drawn = schedule(rows=2, row_spacing_mm=4, scan=scan, errors=errors)
    poses = []
    for s_y, s in product(drawn.stage.s_y.tolist(), drawn.stage.s.tolist()):
        off = [1e3 * (drawn.moment(s, t, s_y).viewpoint.position_mm - drawn.nominal(s, t, s_y).viewpoint.position_mm)
               for t in drawn.frames.t.tolist()]  # fmt: skip
        turn = 1e6 * drawn.moment(s, 0, s_y).rotation_rad
        angles = dict(zip(("pitch_urad", "yaw_urad", "roll_urad"), turn.tolist(), strict=True))
        visits = [{"x_um": float(x)} for x, *_ in off]
        poses.append({"y_um": float(off[0][1]), "z_um": float(off[0][2]), **angles, "visits": visits})
    listed = schedule(rows=2, row_spacing_mm=4, scan=scan, poses=poses)
    # With errors in addition, listed poses and visits replace all drawn values.
    both = schedule(rows=2, row_spacing_mm=4, scan=scan, poses=poses, errors=errors)
    for s_y, s, t in images(drawn):
        expected = values(drawn.moment(s, t, s_y))
        np.testing.assert_allclose(values(listed.moment(s, t, s_y)), expected, rtol=0, atol=1e-12)
        assert values(both.moment(s, t, s_y)) == values(listed.moment(s, t, s_y))


def test_without_listed_visits_they_are_drawn() -> None:
    errors = {"repeatability_um": 3, "straightness_um": 5, "yaw_urad": 90}
    drawn, listed = schedule(errors=errors), schedule(errors=errors, poses=[{"x_um": 7}] * 5)
    for _, s, t in images(drawn):
        place = np.array([5.0 * s, 0, 0])
        along = drawn.moment(s, t).viewpoint.position_mm[0]
        np.testing.assert_allclose(listed.moment(s, t).viewpoint.position_mm - place, [along - 5.0 * s + 7e-3, 0, 0],
                                   rtol=0, atol=1e-12)  # fmt: skip
