"""A small recording with its truth, and recordings of any type of numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from tests.helpers.small_recipes import SCENE


@pytest.fixture(scope="session")
def simulated() -> xr.Dataset:
    recording, _ = st.simulate(st.Scene.from_dict(SCENE))
    return recording


@pytest.fixture
def recording_of() -> Callable[..., xr.Dataset]:
    """Return what makes a recording of random images: 3 cameras, 3 frames, 36 x 48 px."""

    def make(dtype: Any, low: float, high: float, channels: tuple[int, ...] = (), **options: Any) -> xr.Dataset:
        draws = np.random.default_rng(7)
        values = draws.uniform(low, high, (3, 3, 36, 48, *channels))
        # Both ends are there.
        values.flat[:2] = low, high
        images = values.astype(dtype) if np.dtype(dtype).kind == "f" else np.rint(values).astype(dtype)
        options = {"full_scale": max(abs(low), abs(high)), **options}
        return st.make_recording(images, focal_length_px=80.0, baseline_mm=5.0, frame_interval_s=0.5, **options)

    return make
