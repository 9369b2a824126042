from __future__ import annotations

import numpy as np

from scenetruth.camera.sensor.effects import FullWell
from tests.sensors import applied


def test_no_pixel_holds_more() -> None:
    effect = FullWell(kind="full_well", full_well_e=9000.0)
    assert applied(effect, np.array([[10.0, 8999.5, 9000.5, 1e6]])).tolist() == [[10.0, 8999.5, 9000.0, 9000.0]]
    assert effect.mean_response(1e6, 1.0) == effect.largest_input(1e6, 1.0) == 9000.0
    assert effect.largest_input(100.0, 1.0) == 100.0
