"""What is fetched from the images, and what is not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from scenetruth.estimators.refined.image_stack import NO_DEFECTS
from scenetruth.estimators.refined.initialisation import CameraLayout, fill_gaps, map_to_reference
from scenetruth.estimators.refined.kernels import photo_consistency, warp
from tests.helpers.kernel_images import COUNT, HEIGHT, VIEW, WIDTH
from tests.helpers.wavy_plane import MovingPlane, turning

PLANE = MovingPlane(seed=2, size=(90, 120), gradient=turning(4e-3, -3e-3, 5e-3))


def test_one_pixel_is_filled_as_cubics_go_on() -> None:
    y, x = np.mgrid[:9, :10].astype(np.float64)
    image = x**3 - 2 * x**2 * y + y**3 + x * y - 7
    holed = image.copy()
    holed[4, 5] = 1e6
    warp.smooth_over(holed, np.array([[4, 5]]), 1)
    np.testing.assert_allclose(holed, image, atol=1e-9)


def test_filled_squares_have_the_least_squared_laplacian() -> None:
    """Beside a solver that knows nothing of it: least squares over the image mirrored at its ends."""
    generator = np.random.default_rng(8)
    image = generator.normal(0, 1, (9, 9))
    bad = np.zeros((9, 9), dtype=bool)
    bad[4:6, 4:6] = True
    found = image.copy()
    warp.smooth_over(found, np.argwhere(bad), 400)

    def laplacian(values: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(ndimage.laplace(values.reshape(9, 9), mode="mirror").ravel())

    columns = np.stack([laplacian(np.eye(81)[n]) for n in np.flatnonzero(bad)], axis=1)
    fixed = laplacian(np.where(bad, 0.0, image))
    expected = np.linalg.lstsq(columns, -fixed, rcond=None)[0]
    np.testing.assert_allclose(found[bad], expected, atol=1e-9)
    np.testing.assert_array_equal(found[~bad], image[~bad])


def test_bad_pixels_are_not_fetched(images: Any, fields: Any, warped: Any) -> None:
    coefficients = np.stack([ndimage.spline_filter(image, 5, mode="mirror") for image in images]).astype(np.float32)
    bad = (np.random.default_rng(9).random((COUNT, HEIGHT, WIDTH)) < 0.1).astype(np.uint8)
    empty = np.zeros((0, 0, 0), dtype=np.uint8)
    gradient = np.empty((2, HEIGHT, WIDTH), dtype=np.float32)
    found, free = np.empty((2, COUNT, HEIGHT, WIDTH), dtype=np.float32)
    for out, flags in ((found, bad), (free, NO_DEFECTS)):
        warp.warp_rows(coefficients, VIEW, fields, empty, flags, 0, out, gradient, (0, HEIGHT))
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    d, q_x, q_y, q_z = fields
    for n in range(COUNT):
        scale = 1 / (1 + VIEW.t[n] * d * q_z / VIEW.focal)
        at_x = (x - VIEW.centre_x + d * (VIEW.t[n] * q_x - VIEW.s[n])) * scale + VIEW.centre_x
        at_y = (y - VIEW.centre_y + d * (VIEW.t[n] * q_y - VIEW.s_y[n])) * scale + VIEW.centre_y
        shown = np.isfinite(free[n])
        rows, columns = (np.floor(at[shown] + 0.5).astype(int) for at in (at_y, at_x))
        expected = free[n][shown].copy()
        expected[bad[n, rows, columns] == 1] = np.nan
        np.testing.assert_array_equal(found[n][shown], expected)
        assert np.isnan(found[n][~shown]).all()
    # And not judged.
    pixels = np.argwhere(np.ones((HEIGHT, WIDTH), dtype=np.bool_))
    judged = np.empty((len(pixels), photo_consistency.LANES), dtype=np.float32)
    even = np.ones((COUNT, 1, 1), np.float32), np.zeros((COUNT, 1, 1), np.float32)
    photo_consistency.judge_pixels(coefficients, VIEW, fields, bad, even, 32, pixels, judged, (0, len(pixels)))
    variances = judged.T.reshape(-1, HEIGHT, WIDTH)
    several = np.isfinite(found).sum(axis=0) >= 3
    np.testing.assert_array_equal(np.isfinite(variances[0]), several)
    expected = np.nanvar(found[:, several].astype(np.float64), axis=0, ddof=1)
    np.testing.assert_allclose(variances[0][several], expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("s", "t"), [(0.0, 1.0), (1.0, 0.0), (-1.0, -2.0)])
def test_fields_of_another_image_are_brought_back(s: float, t: float) -> None:
    """What the kernel fetches for the reference's pixels, the inverse brings back, to half a pixel's change of d."""
    start = np.ascontiguousarray(PLANE.start())
    height, width = PLANE.size
    y, x = np.mgrid[:height, :width].astype(np.float64)
    centre = ((width - 1) / 2, (height - 1) / 2)
    view = warp.ImageView(np.array([s]), np.zeros(1), np.array([t]), np.zeros((1, 4)), PLANE.focal_px, *centre)
    # Where the other image sees the points, by the kernel itself: it fetches ramps.
    ramps = np.empty((2, 1, height, width), dtype=np.float32)
    nothing, gradient = np.zeros((0, 0, 0), np.uint8), np.empty((2, height, width), np.float32)
    for out, ramp in zip(ramps, (x, y), strict=True):
        warp.warp_rows(ramp[None].astype(np.float32), view, start, nothing, nothing, 0, out, gradient, (0, height))
    d, q_x, q_y, q_z = start
    there = np.stack([d / (1 + t * d * q_z / PLANE.focal_px), q_x, q_y, q_z])
    # The other image's own fields: those of the points it sees, at its pixels.
    known = np.isfinite(ramps[0, 0])
    own = np.full_like(start, np.nan)
    columns, rows = (np.rint(ramp[0][known]).astype(int) for ramp in ramps)
    own[:, rows, columns] = there[:, known]
    own = fill_gaps(own, np.isfinite(own[0]))
    back = map_to_reference(
        own, s, t, CameraLayout(np.stack([np.arange(-2.0, 3.0), np.zeros(5)], axis=-1), 4.0, PLANE.focal_px, centre)
    )
    inner = (slice(None), slice(15, -15), slice(25, -25))
    assert np.abs((back - start)[inner])[0].max() < 0.01
    np.testing.assert_allclose(back[inner][1:], start[inner][1:], atol=2e-4)
