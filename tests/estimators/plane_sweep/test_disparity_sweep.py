"""The plane sweep on boards whose disparity is known."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy import ndimage

import scenetruth as st
from scenetruth.errors import EstimateError
from scenetruth.estimators.plane_sweep import choose_hypotheses, make_camera_row, spread_hypotheses, sweep_disparity
from scenetruth.schema import REASONS, make_recording
from tests.helpers.invalid_borders import with_invalid_pixels
from tests.helpers.textured_boards import Board, away_from_outlines, images_of, true_disparity

SIZE = (60, 96)
BOARDS = (Board(8.37, columns=(36, 66), rows=(14, 44)), Board(3.19))
# What hides columns in the other views, in px.
BESIDE = 12

RIGS = {
    "five": (-2.0, -1.0, 0.0, 1.0, 2.0),
    "two": (0.0, 1.0),
    "two, the other to the left": (-1.0, 0.0),
    "reference at the end": (0.0, 1.0, 2.0),
    "unequal": (-1.3, 0.0, 0.45, 1.9),
    "nine": tuple(np.arange(-4, 5) / 2.0),
}


@pytest.mark.parametrize("rig", RIGS)
def test_boards_have_their_disparity(rig: str) -> None:
    positions = RIGS[rig]
    found = sweep_disparity(images_of(BOARDS, SIZE, positions), positions)
    true = true_disparity(BOARDS, SIZE)
    error = np.abs(found.disparity - true)
    inside = away_from_outlines(true, 3)
    x = np.arange(SIZE[1])
    # Where some view sees the point, whatever it sees of the other board.
    # All others on one side do not see one end, and what is beside the nearer board.
    if min(positions) == 0:
        inside &= (x >= 20) & ~((x >= 36 - BESIDE) & (x < 36))
    if max(positions) == 0:
        inside &= (x < SIZE[1] - 20) & ~((x >= 66) & (x < 66 + BESIDE))
    assert (error[inside] > 0.25).mean() < 0.005
    # A quarter of the step between hypotheses: parabolas keep something of the grid.
    assert np.median(error[inside]) < 0.0625
    assert found.known[inside].mean() > 0.99
    assert (error[found.known] > 0.25).mean() < 0.03


def test_what_no_other_view_sees_is_not_known() -> None:
    # The view to the right sees, of the farther board, no more than the reference does to the right of the nearer one:
    # 5.18 px are hidden left of it. At the image's left end 3.19 px lie outside.
    found = sweep_disparity(images_of(BOARDS, SIZE, (0.0, 1.0)), (0.0, 1.0))
    # Some are taken for the nearer board's, which is then seen there.
    assert found.known[18:40, 31:35].mean() < 0.3
    assert found.known[:, :3].mean() < 0.1
    assert found.known[18:40, 70:90].all()


def test_the_same_seen_with_the_other_sign() -> None:
    positions = np.array(RIGS["unequal"])
    images = images_of(BOARDS, SIZE, RIGS["unequal"])
    one, other = sweep_disparity(images, positions), sweep_disparity(images, -positions, -1.0)
    np.testing.assert_array_equal(one.disparity, -other.disparity)
    assert other.ranges == [(-low, -high) for low, high in one.ranges]


def test_a_small_thing_far_from_all_else_is_found() -> None:
    boards = (Board(31.6, columns=(70, 86), rows=(20, 36)), Board(4.3))
    size = (64, 160)
    found = sweep_disparity(images_of(boards, size, (-1.0, 0.0, 1.0)), (-1.0, 0.0, 1.0))
    # Beside the range of the farther board, not in one with it.
    assert any(low <= 31.6 <= high for low, high in found.ranges)
    assert any(high < 25 for _, high in found.ranges)
    assert np.abs(found.disparity[23:33, 73:83] - 31.6).max() < 0.25


def test_noise_alone_is_not_known() -> None:
    images = np.random.default_rng(1).normal(0, 1, (1, 5, 80, 120)).astype(np.float32)
    assert sweep_disparity(images, RIGS["five"]).known.mean() < 0.02
    flat = sweep_disparity(np.ones((1, 5, 80, 120), dtype=np.float32), RIGS["five"])
    assert not flat.known.any()


def test_a_texture_that_repeats_itself_is_not_known() -> None:
    y, x = np.mgrid[:60, :120].astype(np.float64)
    stripes = [np.cos(2 * np.pi * (x + 4.0 * s) / 6.0) + 0.5 * np.cos(2 * np.pi * y / 7.0) for s in (-1, 0, 1)]
    images = (np.stack(stripes) + np.random.default_rng(0).normal(0, 0.01, (3, 60, 120)))[None].astype(np.float32)
    found = sweep_disparity(images, (-1.0, 0.0, 1.0), ranges=[(0.0, 20.0)])
    assert found.known[:, 30:90].mean() < 0.1
    assert sweep_disparity(images, (-1.0, 0.0, 1.0), ranges=[(2.0, 6.0)]).known.mean() > 0.8


def test_brightness_of_a_view_does_not_matter() -> None:
    images = images_of(BOARDS, SIZE, RIGS["five"])
    changed = images.copy()
    changed[:, 3] = 5 + 0.5 * changed[:, 3]
    changed[:, 0] *= 2
    # Where single precision makes neighbours equal, or no longer equal, bits differ.
    one, other = sweep_disparity(images, RIGS["five"]), sweep_disparity(changed, RIGS["five"])
    np.testing.assert_allclose(one.disparity, other.disparity, atol=0.01)


def test_strips_hardly_show() -> None:
    size = (150, 64)
    images = images_of(BOARDS, size, RIGS["five"])
    choose = partial(
        choose_hypotheses, images[0], make_camera_row(RIGS["five"], 1.0), spread_hypotheses([(0.0, 12.0)], 0.125)
    )
    whole = choose(strip_rows=size[0])
    strips = choose(strip_rows=20)
    one_by_one = choose(strip_rows=20, memory_bytes=0)
    np.testing.assert_array_equal(strips.disparity, one_by_one.disparity)
    # The sweep gives medians of 3 x 3 pixels.
    medians = [ndimage.median_filter(found.disparity, 3) for found in (whole, strips)]
    assert (np.abs(medians[0] - medians[1]) > 0.01).mean() < 0.01


@pytest.mark.parametrize("baseline_mm", [5.0, -5.0])
@pytest.mark.parametrize("thinned", [1, 2])
def test_the_method_gives_depth_in_the_cameras_pixels(baseline_mm: float, thinned: int) -> None:
    positions = (-1.0, 0.0, 1.0)
    images = images_of((Board(7.4),), SIZE, positions)[0][:, None]
    recording = make_recording(images, focal_length_px=800.0, baseline_mm=5.0)
    if baseline_mm < 0:
        # The same images: what stands at -5 mm is now s = 1.
        recording = make_recording(images[::-1], focal_length_px=800.0, baseline_mm=-5.0)
    recording = recording.assign_coords({name: thinned * np.arange(recording.sizes[name]) for name in ("x", "y")})
    found = st.estimate(recording, "plane_sweep").isel(t=0)
    sign = np.sign(baseline_mm)
    middle = {"x": slice(20, 76), "y": slice(10, 50)}
    np.testing.assert_allclose(found["disparity"].isel(middle), sign * 7.4 * thinned, atol=0.1 * thinned)
    np.testing.assert_allclose(found["depth"].isel(middle), 800 * 5 / (7.4 * thinned), rtol=0.015)
    assert (found["status"].isel(middle) == 2).all()
    given = st.estimate(recording, "plane_sweep", disparity_px=(sign * 5.0 * thinned, sign * 9.0 * thinned)).isel(t=0)
    np.testing.assert_allclose(given["disparity"].isel(middle), sign * 7.4 * thinned, atol=0.1 * thinned)


def test_images_without_a_valid_pixel_are_rejected() -> None:
    images = images_of((Board(7.4),), SIZE, (0.0, 1.0))[0][:, None]
    images[1] = np.nan
    recording = make_recording(images, focal_length_px=800.0, baseline_mm=5.0)
    with pytest.raises(EstimateError, match=r"1 of \d+ images have no valid pixel \(the first at t = 0, s = 1\)"):
        st.estimate(recording, "plane_sweep")


def test_only_pixels_whose_census_touches_an_invalid_pixel_are_lost() -> None:
    images = images_of((Board(7.4),), SIZE, (-1.0, 0.0, 1.0))[0][:, None]
    recording = make_recording(images, focal_length_px=800.0, baseline_mm=5.0)
    broken = with_invalid_pixels(recording)
    whole, found = (st.estimate(each, "plane_sweep").isel(t=0) for each in (recording, broken))
    lost = ndimage.binary_dilation(~np.isfinite(broken["image"].values[1, 0]), np.ones((7, 7)))
    assert np.isnan(found["disparity"].values[lost]).all()
    assert (found["invalid_reason"].values[lost] == REASONS.index("border")).all()
    # Views that are invalid at a point do not cover it; some other view does, but beside the left and right borders.
    middle = np.zeros(SIZE, dtype=bool)
    middle[:, 20:76] = True
    kept = middle & ~lost
    assert found["valid"].values[kept].all()
    np.testing.assert_allclose(found["disparity"].values[kept], 7.4, atol=0.1)
    # Costs propagate along all paths, with decreasing effect, and are scaled by the range of valid grey values.
    change = np.abs(found["disparity"].values[kept] - whole["disparity"].values[kept])
    assert change.max() < 0.1
    assert np.median(change) < 0.01


@pytest.mark.parametrize("disparity", [0, 1, 2])
def test_what_is_far_away_is_told_or_left_out(disparity: int) -> None:
    texture = ndimage.gaussian_filter(np.random.default_rng(0).normal(size=(48, 144)), 1.5)
    images = np.stack([texture[:, 40 + disparity * s : 104 + disparity * s] for s in (-1, 0, 1)])[None]
    found = sweep_disparity(images.astype(np.float32), np.array([-1.0, 0.0, 1.0]), 1.0)
    assert (found.disparity > 0).all()
    told = found.disparity[found.known]
    # What does not move from camera to camera has no depth.
    assert disparity == 0 or told.size > 0.8 * texture[:, :64].size
    assert np.abs(told - disparity).max(initial=0.0) < 0.25
