"""Results that wait in a folder: found by what the images show, and asked for where there are none."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators import prepare
from scenetruth.estimators.external import ResultsFolder, recording_key, write_recording
from tests.helpers import external_program

Make = Callable[..., xr.Dataset]


def test_results_made_offline_are_found(simulated: xr.Dataset, tmp_path: Path) -> None:
    write_recording(simulated, tmp_path / "in")
    place = tmp_path / "results" / recording_key(simulated)
    place.mkdir(parents=True)
    external_program.main(tmp_path / "in", place)
    st.save_store(simulated, tmp_path / "recording.zarr")
    opened = st.open_store(tmp_path / "recording.zarr", kind="recording")
    method = ResultsFolder(tmp_path / "results", "offline")
    found = st.estimate(opened, pickle.loads(pickle.dumps(method)))
    expected = np.load(place / "disparity.npy")
    assert np.array_equal(found["disparity"].values, expected, equal_nan=True)
    assert found.attrs["method"] == "offline"
    assert found.attrs["recording_hash"] == simulated.attrs["recording_hash"]


def test_missing_results_tell_where_they_belong(recording_of: Make, tmp_path: Path) -> None:
    recording = recording_of(np.uint8, 0, 255)
    with pytest.raises(st.EstimateError, match=r"write_recording\(recording, FOLDER\)") as caught:
        st.estimate(recording, ResultsFolder(tmp_path, "offline"))
    assert str(tmp_path / recording_key(recording)) in str(caught.value)


def test_a_folder_that_is_not_there_is_told_before_any_work(recording_of: Make, tmp_path: Path) -> None:
    with pytest.raises(st.EstimateError, match="no such results folder"):
        prepare(recording_of(np.uint8, 0, 255), ResultsFolder(tmp_path / "none", "offline"))
