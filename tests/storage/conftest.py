"""Small data sets of every kind."""

from __future__ import annotations

import pytest
import xarray as xr

import scenetruth as st
from tests.helpers.scenes import cube


@pytest.fixture(scope="session")
def data() -> dict[str, xr.Dataset]:
    small = {"camera": {"width": 48, "height": 40, "focal_length_px": 700}}
    recording, truth = st.simulate(cube(**small, sensor={"bit_depth": 10, "noise_std": 0.01}))
    return {"recording": recording, "truth": truth, "estimate": st.estimate(recording, working_point_px=0)}
