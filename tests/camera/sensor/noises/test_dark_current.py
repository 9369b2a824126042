from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from scenetruth.camera.sensor.noise_sources import DarkCurrent
from tests.sensors import applied, assert_converts, uniform


def test_electrons_grow_with_time() -> None:
    assert_converts(DarkCurrent(kind="dark_current", exposure_time_s=0.1, dark_current_e_per_s=300.0), 50.0, 80.0)


def test_hot_pixels_are_so_many_and_the_same_in_all_images() -> None:
    effect = DarkCurrent(
        kind="dark_current",
        exposure_time_s=0.5,
        dark_current_e_per_s=10.0,
        hot_pixel_share=0.01,
        hot_pixel_current_e_per_s=4000.0,
    )
    image = applied(effect, uniform(0.0))
    assert set(np.unique(image)) == {5.0, 2000.0}
    share = (image == 2000.0).mean()
    # Standard error of a share, five of them.
    assert share == pytest.approx(0.01, abs=5 * np.sqrt(0.01 / image.size))
    np.testing.assert_array_equal(applied(effect, uniform(0.0), s=1), image)


def test_hot_pixels_are_hotter() -> None:
    with pytest.raises(ValidationError, match="must not be below dark_current_e_per_s, 10"):
        DarkCurrent(kind="dark_current", exposure_time_s=1.0, dark_current_e_per_s=10.0, hot_pixel_share=0.1)
