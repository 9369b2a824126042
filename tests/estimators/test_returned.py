"""What a method is given cannot be changed by it."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators.estimation import read_only


def test_nothing_of_a_recording_can_be_written_to() -> None:
    images = np.random.default_rng(0).integers(0, 255, (3, 3, 20, 30), dtype=np.uint8)
    recording = st.make_recording(images, 500.0, 5.0).assign_attrs(note="mine")
    guarded = read_only(recording)
    before = recording.copy(deep=True)
    xr.testing.assert_identical(guarded, recording)
    assert {"image", "stage_x_mm", "time_s", "x", "y", "s", "t"} <= set(guarded.variables)
    for name in guarded.variables:
        with pytest.raises(ValueError, match="read-only"):
            guarded[name].values[...] = 0
    guarded.attrs["note"] = "theirs"
    guarded["image"].attrs["units"] = "theirs"
    guarded["extra"] = guarded["image"] * 2
    xr.testing.assert_identical(recording, before)
    # The caller's own arrays stay as they were.
    assert recording["image"].values.flags.writeable
