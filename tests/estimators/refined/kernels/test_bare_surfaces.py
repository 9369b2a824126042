"""Kernels that compare the other views, beside plain readings of what they do."""

from __future__ import annotations

import numpy as np

from scenetruth.estimators.refined.kernels.bare_surfaces import compare_ends, compare_pixels, find_ends

GENERATOR = np.random.default_rng(0)


def test_ends_are_those_of_runs_in_rows() -> None:
    labels = np.zeros((4, 12), dtype=np.int32)
    labels[:, 3:7] = 1
    labels[1, 7] = 1  # an outline that leans
    labels[3, 9:] = 2  # up to the end of the image
    ends = np.zeros((40, 6), dtype=np.int32)
    ends = ends[: find_ends(labels, 3, ends)]
    sides = {(y, side): column for column, y, side in ends[:, :3].tolist()}
    # The last one in the fourth row is that of the other surface.
    assert sides == {**{(y, -1): 3 for y in range(3)}, (3, -1): 9, **{(y, 1): 6 for y in (0, 2, 3)}, (1, 1): 7}
    assert ends[:, 2].tolist().count(-1) == 5
    # Pieces of three rows; the fourth begins another.
    left = ends[(ends[:, 2] == -1) & (ends[:, 0] == 3)]
    assert len(set(left[:3, 4].tolist())) == 1
    assert left[3, 4] != left[0, 4]
    for n, other in enumerate(ends[:, 5].tolist()):
        assert other == -1 or ends[other, 5] == n
    assert ends[ends[:, 0] == 9][0, 5] == -1
    assert ends[(ends[:, 1] == 1) & (ends[:, 0] == 3)][0, 3] == 5


def test_outlines_cost_least_where_they_are() -> None:
    """A bright area in a dark view, displaced by 5 columns per step."""
    x = np.arange(60)
    labels = np.zeros((8, 60), dtype=np.int32)
    labels[:, 20:30] = 1
    grey = 100.0 * labels
    positions = np.array([-1.0, 2.0])
    views = np.stack([100.0 * np.isin(x + 5 * s, np.arange(20, 30)) for s in positions])
    views = np.repeat(views[:, None], 8, axis=1).astype(np.float32)
    ends = np.zeros((100, 6), dtype=np.int32)
    ends = ends[: find_ends(labels, 99, ends)]
    disparities = np.arange(3.0, 8.0, 0.5)
    costs, weights = np.zeros((2, len(disparities))), np.zeros(2)
    compare_ends(ends, 5, grey, grey, views, -positions[:, None] * disparities, 1.0, costs, weights)
    costs /= weights[:, None]
    assert (disparities[np.argmin(costs, axis=1)] == 5.0).all()
    # With 1 px per step more, the view at 2 steps is beyond the left end by 2 px, the other beyond the right by 1.
    np.testing.assert_allclose(costs[:, disparities == 6.0].ravel(), [1.0, 0.5])
    np.testing.assert_allclose(costs[:, disparities == 5.0].ravel(), 0.0)
    np.testing.assert_allclose(costs[:, disparities == 4.0].ravel(), [0.5, 1.0])


def test_pixels_are_compared_on_the_better_side() -> None:
    shape = (4, 30)
    grey, slope = GENERATOR.normal(size=shape), GENERATOR.uniform(0, 2, shape)
    views = GENERATOR.normal(size=(3, *shape)).astype(np.float32)
    positions, shifts = np.array([1.0, 2.0, -1.5]), np.array([0.1, -0.2, 0.3])
    disparity = GENERATOR.uniform(2, 9, shape)
    found = np.empty(shape)
    compare_pixels(0, 4, disparity, grey, slope, views, positions, shifts, 0.7, 0.3, found)
    for y, x in np.ndindex(shape):
        sides: tuple[list[float], list[float]] = ([], [])
        for v in range(3):
            place = x - disparity[y, x] * positions[v] - shifts[v]
            if 0 <= place < 29:
                value = np.interp(place, np.arange(30), views[v, y])
                sides[int(positions[v] > 0)].append((value - grey[y, x]) ** 2)
        means = [np.mean(side) for side in sides if side]
        expected = min(means) / (0.7**2 + (0.3 * slope[y, x]) ** 2) if means else 0.0
        np.testing.assert_allclose(found[y, x], expected, rtol=1e-5, atol=1e-9)
