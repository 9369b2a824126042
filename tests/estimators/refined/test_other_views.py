"""Other views with the brightness of the reference, and pixels compared with them."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from scenetruth.estimators.refined import ImageStack, OtherViews, match_views

SIZE = (60, 120)


def test_gain_offset_and_shift_of_every_view_are_found() -> None:
    """Views of a plane with disparity 4, displaced to the left by errors of their poses, and of other brightness."""
    positions, shifts, gains = np.array([-1.0, 0.0, 1.0, 2.0]), (0.3, 0.0, -0.2, 0.1), (0.8, 1.0, 1.1, 1.2)
    texture = ndimage.gaussian_filter(np.random.default_rng(0).normal(size=(SIZE[0], SIZE[1] + 40)), 2.5)
    texture = 100 + 20 * texture / texture.std()
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    views = np.stack([
        (ndimage.map_coordinates(texture, [rows, columns + 20 + 4.0 * s + shift], order=5) - 7.0) / gain
        for s, shift, gain in zip(positions, shifts, gains, strict=True)
    ])  # fmt: skip
    reference = views[1]
    coefficients = np.stack([ndimage.spline_filter(view, 5, mode="mirror") for view in views]).astype(np.float32)
    stack = np.stack([positions, np.zeros(4)], axis=1)
    images = ImageStack([coefficients[None]], stack, np.zeros(1), 900.0, (60.0, 30.0), np.zeros((4, 4)))
    disparity = np.full(SIZE, 4.0)
    found = match_views(images, reference, disparity, (columns > 15) & (columns < 100))
    np.testing.assert_array_equal(found.positions, [-1.0, 1.0, 2.0])
    np.testing.assert_allclose(found.shifts, [0.3, -0.2, 0.1], atol=0.02)
    inner = (slice(5, 55), slice(15, 100))
    for view, gain, original in zip(found.grey, (0.8, 1.1, 1.2), views[[0, 2, 3]], strict=True):
        np.testing.assert_allclose(view[inner], (gain * original)[inner], atol=1.0)
    assert found.uncertainty == np.sqrt(np.mean(np.square(found.shifts)))
    # Exact disparities agree; 3 px per step more do not.
    assert np.median(found.compare(disparity, reference, 1.0)[inner]) < 0.1
    assert np.median(found.compare(disparity + 3.0, reference, 1.0)[inner]) > 3.0


def test_a_point_that_no_view_contains_is_like_them() -> None:
    views = OtherViews(np.ones((1, 4, 20), dtype=np.float32), np.array([1.0]), np.zeros(1))
    assert (views.compare(np.full((4, 20), 30.0), np.zeros((4, 20)), 1.0) == 0).all()
