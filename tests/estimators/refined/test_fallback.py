"""Fallback values in holes: planes across them, edges between surfaces, and standard deviations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators.refined import OtherViews, Sources, fill_holes, near_bare_surfaces, recede
from tests.helpers.bare_patches import BOARDS_SIZE, GREY_NOISE, Patch, draw_patches
from tests.helpers.wavy_plane import MovingPlane

SHAPE = (80, 100)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
NOWHERE = np.zeros(SHAPE, dtype=bool)
FLAT = np.random.default_rng(0).normal(100.0, 1.0, SHAPE)


def sources(disparity: np.ndarray, fitted: np.ndarray) -> Sources:
    return Sources(disparity, fitted, NOWHERE, NOWHERE)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_planes_continue_across_holes(sign: float) -> None:
    """Also for negative baselines."""
    hole = (abs(Y - 40) < 15) & (abs(X - 50) < 20)
    truth = sign * (8.0 + 0.02 * X - 0.01 * Y)
    found = fill_holes(FLAT, 1.0, sources(np.where(hole, np.nan, truth), ~hole), hole, 2.0)
    assert (found.where == hole).all()
    assert np.abs(found.disparity - truth)[hole].max() < 0.02
    assert (found.std[hole] > 0.04).all()


def test_edges_of_the_image_separate_surfaces() -> None:
    """A bright board before a dark wall, of which the rims are known; the hole contains its outline."""
    board = X < 43
    truth = np.where(board, 9.0, 6.0)
    hole = (abs(Y - 40) < 20) & (abs(X - 50) < 25)
    # 43 is not the middle of the hole.
    found = fill_holes(FLAT + 60.0 * board, 1.0, sources(truth, ~hole), hole, 2.0)
    wrong = np.abs(found.disparity - truth) > 0.25
    assert wrong[hole].mean() < 0.03
    # Close to the outline, both are possible.
    assert (np.abs(found.disparity - truth)[hole] < 3 * found.std[hole]).all()
    unseen = fill_holes(FLAT, 1.0, sources(truth, ~hole), hole, 2.0)
    assert (np.abs(unseen.disparity - truth)[hole] < 4 * unseen.std[hole]).all()


def test_deviations_grow_with_the_distance() -> None:
    """A surface on one side says little about what lies far from it; errors of slopes add up."""
    generator = np.random.default_rng(4)
    fitted = X < 30
    truth = np.full(SHAPE, 7.0)
    found = fill_holes(FLAT, 1.0, sources(truth + generator.normal(0, 0.05, SHAPE), fitted), ~fitted, 2.0)
    middle = np.median(found.std, axis=0)
    assert middle[35] < middle[60] < middle[95]
    assert middle[95] > 0.5


def test_sweep_pixels_keep_their_values() -> None:
    swept = X < 50
    truth = 7.0 + 0.01 * X
    found = fill_holes(FLAT, 1.0, Sources(truth, ~swept, swept, NOWHERE), swept & (X > 10), 2.0)
    assert (found.where == (swept & (X > 10))).all()
    np.testing.assert_array_equal(found.disparity[found.where], truth[found.where])
    assert (found.std[found.where] < 0.1).all()


def test_without_sources_there_is_no_fallback() -> None:
    truth = np.full(SHAPE, 7.0)
    assert not fill_holes(FLAT, 1.0, sources(truth, NOWHERE), ~NOWHERE, 2.0).where.any()
    # Nor from a few pixels that agree by chance.
    few = (Y < 3) & (X < 5)
    assert not fill_holes(FLAT, 1.0, sources(truth, few), ~few, 2.0).where.any()


PLANE = MovingPlane(size=(64, 96))
SMALL = {"window_sigma_px": 4, "discontinuity_refit": False, "motion": "translation"}


@pytest.fixture(scope="module")
def bare() -> xr.Dataset:
    """Return a recording of a plane with a bare patch, whose place is the same in all cameras for simplicity."""
    recording = PLANE.recording(noise_std=0.005).isel(t=[1]).assign_coords(t=[0])
    image = recording["image"].copy()
    shape = image[..., 20:44, 34:60].shape
    image[..., 20:44, 34:60] = 0.5 + np.random.default_rng(5).normal(0, 0.005, shape)
    return recording.assign(image=image)


def estimated(recording: xr.Dataset, **settings: Any) -> xr.Dataset:
    return st.estimate(recording, "refined", {**SMALL, **settings}).isel(t=0)


def test_fallback_fills_what_may_be_filled(bare: xr.Dataset) -> None:
    """Holes have disparity, depth and their standard deviations only; excluded pixels remain invalid."""
    mask = np.zeros((64, 96), dtype=bool)
    mask[25:30, 40:50] = True
    found = estimated(bare.assign(exclusion_mask=(("y", "x"), mask)))
    status = found["status"].values
    hole = np.zeros_like(mask)
    hole[26:38, 42:52] = True
    # The sweep may match the patch, which does not move, and then contradicts.
    assert np.mean(status[hole & ~mask] == 3) > 0.6
    assert (status[mask] == 0).all()
    assert np.isnan(found["depth"].values[mask]).all()
    for name in ("disparity", "depth"):
        assert (found[f"{name}_std"].values[status == 3] > 0).all()
    assert not found["valid"].values[status == 3].any()
    relative = found["depth_std"] / found["depth"] - found["disparity_std"] / found["disparity"]
    assert np.abs(relative.values[status == 3]).max() < 1e-5
    without = estimated(bare.assign(exclusion_mask=(("y", "x"), mask)), fallback="none")
    assert ((without["status"].values == 2) == (status == 2)).all()
    assert (without["status"].values[hole] == 0).all()


def test_one_camera_has_no_fallback(bare: xr.Dataset) -> None:
    frames = PLANE.recording(noise_std=0.005).isel(s=[len(bare["s"]) // 2])
    assert not (estimated(frames)["status"].values == 3).any()


def test_sweep_pixels_near_bare_surfaces_are_uncertain() -> None:
    """The squares of the sweep extend the disparity of an outline by some pixels; within texture they do not."""
    textured = (X < 50) & ~((abs(Y - 40) < 2) & (abs(X - 20) < 2))
    near = near_bare_surfaces(textured)
    assert near[:, 46:].all()
    assert not near[:, :44].any()
    swept = X < 50
    truth = np.full(SHAPE, 7.0)
    found = fill_holes(FLAT, 1.0, Sources(truth, NOWHERE, swept, near), ~NOWHERE, 2.0)
    assert found.std[:, :40].max() < 0.1
    assert found.std[:, 46:50].min() > 0.5


def test_pixels_beside_an_outline_recede_to_the_farther_surface() -> None:
    """A sweep that extends boards by 3 px beyond their outlines before a wall, and across a gap between them."""
    everywhere = ((-1000.0, 1000.0), (-1000, 1000))
    boards = [Patch(9.0, (40, 70), (10, 80), np.nan), Patch(9.0, (73, 100), (10, 80), np.nan)]
    scene = [Patch(4.0, *everywhere, np.nan), *boards]
    positions = np.array([-2.0, -1.0, 1.0, 2.0])
    grey, truth = draw_patches(scene, 0.0, 0)
    views = np.stack([draw_patches(scene, s, n + 1)[0] for n, s in enumerate(positions)]).astype(np.float32)
    columns = np.mgrid[: BOARDS_SIZE[0], : BOARDS_SIZE[1]][1]
    rows = slice(20, 70)
    swept = np.where((columns >= 37) & (columns < 103), 9.0, 4.0)
    nowhere = np.zeros(BOARDS_SIZE, dtype=bool)
    given = Sources(swept, nowhere, ~nowhere, nowhere)
    found, unlike = recede(given, grey, GREY_NOISE, OtherViews(views, positions, np.zeros(4)))
    wrong = np.abs(found.disparity - truth) > 0.1
    beside = (slice(20, 70), np.r_[37:40, 100:103])
    assert wrong[beside].mean() < 0.4
    assert wrong[rows, 44:66].mean() < 0.01
    # No source nearby has the disparity of the gap, but its pixels are unlike the other views.
    assert wrong[rows, 70:73].all()
    assert (unlike[rows, 71] == 2).mean() > 0.5
    assert (unlike[rows, 70:73] > 0).all()
    assert (unlike[rows, 46:64] > 0).mean() < 0.2
