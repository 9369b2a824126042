"""Pictures of the largest errors have contrast, a mark at the right place, and say what is invalid."""

from __future__ import annotations

import base64
import io

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from scenetruth.scoring.report import draw_hotspot, draw_hotspot_map, show_errors, stretch_grey


def pixels(address: str) -> NDArray[np.uint8]:
    with Image.open(io.BytesIO(base64.b64decode(address.removeprefix("data:image/png;base64,")))) as picture:
        return np.asarray(picture.convert("RGB"))


def is_mark(shown: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray((shown == np.rint(255 * np.array([1.0, 0.82, 0.25]))).all(axis=-1))


def test_the_square_has_the_size_of_the_part() -> None:
    errors = np.random.default_rng(2).normal(size=(100, 120))
    found = draw_hotspot(errors, errors, 40, 70, (32, 64, 32))
    shown = pixels(found.address)
    half = (found.width - 6) // 2
    for part in (shown[:, :half], shown[:, half + 6 :]):
        ys, xs = np.nonzero(is_mark(part))
        # The section starts at row 8 and column 38; three pixels of the picture for one of the map, dark outside.
        assert (ys.min(), ys.max()) == (3 * (32 - 8) + 1, 3 * (64 - 8) - 2)
        assert (xs.min(), xs.max()) == (3 * (64 - 38) + 1, 3 * (96 - 38) - 2)


@pytest.mark.parametrize(("row", "column"), [(50, 60), (0, 0), (99, 3)])
def test_the_mark_surrounds_the_pixel_in_image_and_error(row: int, column: int) -> None:
    rng = np.random.default_rng(7)
    # A hundredth of the range of the whole image: dull without local contrast.
    image = 100 + rng.random((100, 120))
    image[:, 119] = 200
    errors = rng.normal(size=(100, 120))
    errors[row, column] = 9.0
    found = draw_hotspot(image, errors, row, column)
    shown = pixels(found.address)
    assert shown.shape[1] == found.width
    half = (found.width - 6) // 2
    grey, colour = shown[:, :half], shown[:, half + 6 :]
    at = [3 * (place - max(0, place - 32)) + 1 for place in (row, column)]
    for part in (grey, colour):
        ys, xs = np.nonzero(is_mark(part))
        assert ys.size > 20
        # Its corners are as far from the pixel on all sides that are in the picture.
        assert ys.max() - at[0] == pytest.approx(14, abs=1) or row > 90
        assert xs.max() - at[1] == pytest.approx(14, abs=1)
    plain = grey[~is_mark(grey)]
    assert plain.std() > 40
    # The strongest colour is that of the largest errors.
    assert tuple(colour[at[0], at[1]]) == pytest.approx((103, 0, 31), abs=3)
    assert found.limit < 9


def test_signs_have_their_colours_and_invalid_pixels_a_hatching() -> None:
    shown = show_errors(np.array([[-1.0, 0.0, 1.0, np.nan]]), 1.0)[0]
    assert shown[0, 2] > shown[0, 0] + 0.2
    assert shown[2, 0] > shown[2, 2] + 0.2
    assert shown[1].min() > 0.95
    hatched = show_errors(np.full((12, 12), np.nan), 1.0)
    assert len(np.unique(hatched[..., 0])) == 2
    assert np.ptp(hatched, axis=-1).max() < 0.1


def test_a_flat_image_stays_finite() -> None:
    assert np.isfinite(stretch_grey(np.full((4, 5), 7.0))).all()
    assert draw_hotspot(np.full((9, 9), 7.0), np.zeros((9, 9)), 4, 4).limit == 1.0


def test_a_map_without_errors_has_no_mark() -> None:
    image, errors = np.random.default_rng(1).random((20, 30)), np.full((20, 30), np.nan)
    assert not is_mark(pixels(draw_hotspot_map(image, errors, 0.5))).any()
    errors[11, 22] = -0.3
    found = is_mark(pixels(draw_hotspot_map(image, errors, 0.5)))
    ys, xs = np.nonzero(found[:, : 2 * 30])
    assert ((ys.min() + ys.max()) / 2, (xs.min() + xs.max()) / 2) == pytest.approx((22.5, 44.5), abs=6)
