"""What is hidden in the next frame, where the truth does not tell it by itself."""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.ndimage import binary_dilation

from scenetruth.exporters import ExportSource
from scenetruth.exporters.benchmark_formats import hidden_next


def test_points_are_looked_for_in_the_next_frame(recording: xr.Dataset, truth: xr.Dataset) -> None:
    surface = truth.object_id.sel(s=0, t=0).values >= 0
    expected = surface & ~truth.visible.sel(s=0, t=1).values
    # Some points are seen later but not earlier: these have to be told apart.
    assert (truth.occluded_in_time.sel(s=0, t=0).values & ~expected).sum() > 20
    found = hidden_next(ExportSource(recording, truth.drop_vars("visible")), 0, 0)
    wrong = found != expected
    assert wrong.sum() < 0.15 * expected.sum()
    # Only at the outlines of what is hidden, by a pixel.
    outline = binary_dilation(expected) & binary_dilation(~expected & surface)
    assert not (wrong & ~outline).any()


def test_first_frame_and_reference_are_exact(source: ExportSource, truth: xr.Dataset) -> None:
    np.testing.assert_array_equal(hidden_next(source, 1, -1), truth.occluded_in_time.sel(s=1, t=-1).values)
    expected = (truth.object_id.sel(s=0, t=0).values >= 0) & ~truth.visible.sel(s=0, t=1).values
    np.testing.assert_array_equal(hidden_next(source, 0, 0), expected)
