"""Motion from the frames beside, on boards whose motion is known."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.estimators.plane_sweep import MotionResult, sweep_motion
from tests.helpers.textured_boards import Board, away_from_outlines, draw, images_of, true_board

Array = NDArray[np.float64]

SIZE = (88, 128)
FOCAL = 900.0
CENTRE = ((SIZE[1] - 1) / 2, (SIZE[0] - 1) / 2)
BOARDS = (
    Board(8.3, columns=(40, 92), rows=(22, 66), flow=(5.3, -3.6), approach=0.012),
    Board(3.2, flow=(-6.2, 2.1), approach=-0.006),
)
FIVE = (-2.0, -1.0, 0.0, 1.0, 2.0)


def truth() -> tuple[Array, Array]:
    """Return disparity, and velocity in baselines per frame, of the reference's pixels."""
    board = true_board(BOARDS, SIZE)
    d = np.array([board.disparity for board in BOARDS])
    q = np.array([(*board.flow, -board.approach * FOCAL) for board in BOARDS]) / d[:, None]
    return d[board], np.moveaxis(q[board], -1, 0)


def flow_of(d: Array, q: Array) -> Array:
    """Return the flow to t = 1, in px."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float64)
    x, y = x - CENTRE[0], y - CENTRE[1]
    g = 1 / (1 + d * q[2] / FOCAL)
    return np.stack([(x + d * q[0]) * g - x, (y + d * q[1]) * g - y])


def found_with(positions: tuple[float, ...], times: tuple[float, ...], sign: float = 1.0) -> MotionResult:
    beside = [images_of(BOARDS, SIZE, positions, t) for t in times]
    d, _ = truth()
    turned = sign * np.array(positions)
    return sweep_motion(draw(BOARDS, SIZE, 0.0)[None], beside, times, turned, sign * d, FOCAL, CENTRE)


@pytest.mark.parametrize(
    ("positions", "times"),
    [(FIVE, (-1.0, 1.0)), (FIVE, (1.0,)), ((0.0, 1.0), (-1.0, 1.0)), ((-1.3, 0.0, 2.0), (-1.0,))],
)
def test_boards_have_their_motion(positions: tuple[float, ...], times: tuple[float, ...]) -> None:
    found = found_with(positions, times)
    d, q = truth()
    error = np.hypot(*(flow_of(d, found.velocity) - flow_of(d, q)))
    # What moves in or out of the image is seen at one of the times at most.
    inside = away_from_outlines(true_board(BOARDS, SIZE), 4)
    inside[:12], inside[-12:], inside[:, :16], inside[:, -16:] = False, False, False, False
    if len(times) == 1:
        # Up to 11.5 px beside the nearer board are hidden then.
        inside &= away_from_outlines(true_board(BOARDS, SIZE), 12)
    # One other image alone leaves more to chance.
    assert (error[inside] > 0.5).mean() < (0.02 if len(positions) * len(times) > 3 else 0.05)
    # Images are shifted by halves of a pixel: with one pair, flow is no finer than a quarter.
    assert np.median(error[inside]) < 0.25
    assert found.known[inside].mean() > 0.95
    # The farthest camera tells the change of disparity to half a pixel.
    change = np.abs(d**2 * (found.velocity[2] - q[2]) / FOCAL) * max(np.abs(positions))
    assert np.median(change[inside]) < 0.5


def test_the_same_with_negative_disparities() -> None:
    one, other = found_with(FIVE, (1.0,)), found_with(FIVE, (1.0,), sign=-1.0)
    d, _ = truth()
    flows = flow_of(d, one.velocity), flow_of(-d, other.velocity)
    # Random changes have the other sign.
    assert np.median(np.abs(flows[0] - flows[1])) < 0.25


def test_one_camera_shows_flow() -> None:
    beside = [images_of(BOARDS, SIZE, (0.0,), t) for t in (-1.0, 1.0)]
    found = sweep_motion(draw(BOARDS, SIZE, 0.0)[None], beside, (-1, 1), (0.0,), None, FOCAL, CENTRE)
    d, q = truth()
    error = np.hypot(*(found.velocity[:2] - flow_of(d, q)))
    inside = away_from_outlines(true_board(BOARDS, SIZE), 5)
    inside[:12], inside[-12:], inside[:, :16], inside[:, -16:] = False, False, False, False
    # Away from the centre, flow of what comes nearer differs between the two times: by 0.012² of 30 px, and less.
    assert (error[inside] > 0.6).mean() < 0.02
    assert not found.velocity[2].any()


def test_the_number_of_threads_does_not_matter() -> None:
    many = found_with((0.0, 1.0), (1.0,))
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        one = found_with((0.0, 1.0), (1.0,))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(many.velocity, one.velocity)
    np.testing.assert_array_equal(many.known, one.known)


def test_what_has_no_texture_across_an_edge_has_no_known_motion() -> None:
    generator = np.random.default_rng(3)
    x = np.arange(SIZE[1], dtype=np.float64)
    wave = sum(np.cos(2 * np.pi * x / length + phase) for length, phase in ((5.0, 0.3), (7.7, 1.0), (11.3, 2.0)))
    stripes = [np.broadcast_to(wave, SIZE) + generator.normal(0, 0.02, SIZE) for _ in range(3)]
    images = np.stack(stripes).astype(np.float32)
    found = sweep_motion(
        images[:1], [images[1][None, None], images[2][None, None]], (-1, 1), (0.0,), None, FOCAL, CENTRE
    )
    assert found.known.mean() < 0.05
    noise = generator.normal(0, 1, (3, 1, 1, *SIZE)).astype(np.float32)
    found = sweep_motion(noise[0, 0], list(noise[1:]), (-1, 1), (0.0,), None, FOCAL, CENTRE)
    assert found.known.mean() < 0.05
