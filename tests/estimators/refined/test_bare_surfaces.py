"""Bare surfaces before, in and behind textured ones, whose disparity follows from their outlines."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from scenetruth.estimators.refined import OtherViews, find_bare_areas, fit_bare_surfaces
from tests.helpers.bare_patches import GREY_NOISE, Patch, draw_patches

Map = NDArray[np.float64]

POSITIONS = np.array([-2.0, -1.0, 1.0, 2.0])
WALL = 5.0


EVERYWHERE = ((-1000.0, 1000.0), (-1000, 1000))
TEXTURED = Patch(WALL, *EVERYWHERE, np.nan)


def planes_of(patches: list[Patch]) -> list[tuple[Map, float, float, Map]]:
    """Return disparity, error, enclosed fraction and truth of every bare surface that was found."""
    grey, shown = draw_patches(patches, 0.0, 0)
    views = np.stack([draw_patches(patches, s, n + 1)[0] for n, s in enumerate(POSITIONS)]).astype(np.float32)
    square = sum(np.square(each) for each in np.gradient(grey))
    textured = ndimage.gaussian_filter(square, 1.0) > (2.0 * GREY_NOISE) ** 2
    areas = find_bare_areas(grey, GREY_NOISE, textured)
    surfaces = np.where((areas == 0) & (shown == WALL), 0, -1).astype(np.int32)
    other = OtherViews(views, POSITIONS, np.zeros(len(POSITIONS)))
    found = fit_bare_surfaces(areas, grey, GREY_NOISE, other, (2.5, 12.0), surfaces, np.array([[WALL, 0.0, 0.0]]))
    out = []
    for each in found:
        disparity = each.plane[0] + each.plane[1] * each.columns + each.plane[2] * each.rows
        out.append((disparity, each.error, each.enclosed, shown[each.rows, each.columns]))
    return out


@pytest.mark.parametrize("disparity", [WALL, 7.3, 9.1])
def test_a_bare_board_has_the_disparity_of_its_outlines(disparity: float) -> None:
    """Also if it is painted on the wall, where the plane of the wall is exact."""
    [(found, error, enclosed, _)] = planes_of([TEXTURED, Patch(disparity, (50, 95), (25, 70), 200.0)])
    assert np.abs(found - disparity).max() < (1e-6 if disparity == WALL else 0.2)
    assert error < 0.2
    assert enclosed > 0.7


def test_an_occluder_does_not_carry_a_bare_surface_along() -> None:
    """A field on the wall, half of which a nearer board hides: one of its outlines moves with that board."""
    board = Patch(9.0, (75, 120), (10, 80), np.nan)
    [(found, _, enclosed, truth)] = planes_of([TEXTURED, Patch(WALL, (40, 95), (25, 70), 200.0), board])
    assert np.median(np.abs(found - truth)) < 1e-6
    # One end of each row is that of the board.
    assert enclosed < 0.1


def test_a_bare_wall_has_the_plane_of_what_is_painted_on_it() -> None:
    """Pictures on the wall, and a board before it."""
    wall = Patch(WALL, *EVERYWHERE, 200.0)
    pictures = [Patch(WALL, (10, 35), (10, 40), np.nan), Patch(WALL, (100, 130), (20, 45), np.nan)]
    board = Patch(9.0, (50, 85), (40, 75), np.nan)
    largest = max(planes_of([wall, *pictures, board]), key=lambda each: len(each[0]))
    assert np.abs(largest[0] - WALL).max() < 1e-6


def test_without_outlines_there_is_no_plane() -> None:
    assert planes_of([Patch(WALL, *EVERYWHERE, 200.0)]) == []
