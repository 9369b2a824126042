"""Estimates written frame by frame are those that are made in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.errors import EstimateError
from scenetruth.estimators import prepare
from scenetruth.estimators.structure_tensor import MEMORY_LIMITS
from scenetruth.pipeline.runner import write_estimate
from tests.helpers.analytic_plane import Plane


@pytest.fixture(scope="module")
def recording() -> xr.Dataset:
    plane = Plane(velocity=(0.1, -0.05, 0.3), slope=0.3, size=(60, 56))
    return plane.recording(np.arange(3) - 1, 13, noise=0.01)


@pytest.mark.parametrize("form", ["", ".zip"])
def test_groups_of_frames_leave_no_trace(
    recording: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    whole = st.estimate(recording)
    st.save_store(recording, tmp_path / "recording.zarr")
    # Two frames at a time, of five.
    monkeypatch.setattr(MEMORY_LIMITS, "map_bytes", 2 * 84 * 60 * 56)
    told: list[tuple[str, int, int]] = []
    work = prepare(
        st.open_store(tmp_path / "recording.zarr"), progress=lambda what, done, total: told.append((what, done, total))
    )
    target = tmp_path / f"estimate.zarr{form}"
    write_estimate(work, target, zipped=bool(form))
    found = st.load_store(target, kind="estimate")
    xr.testing.assert_identical(found.drop_attrs(), whole.drop_attrs())
    assert {**found.attrs, "working_points_px": None} == {**whole.attrs, "working_points_px": None}
    assert np.array_equal(found.attrs["working_points_px"], whole.attrs["working_points_px"])
    assert whole.sizes["t"] == 5
    # Progress of all groups together: it never goes back, and ends at its end.
    assert [done for _, done, _ in told] == sorted(done for _, done, _ in told)
    assert {total for _, _, total in told} == {told[-1][1]}


def test_methods_that_need_all_frames_are_written_too(recording: xr.Dataset, tmp_path: Path) -> None:
    def far(recording: xr.Dataset) -> xr.Dataset:
        return st.make_estimate(recording=recording, depth=np.full(recording["image"].shape[1:], 700.0))

    write_estimate(prepare(recording, far), tmp_path / "estimate.zarr")
    assert (st.load_store(tmp_path / "estimate.zarr").depth == 700).all()


def test_failures_of_methods_are_named(recording: xr.Dataset, tmp_path: Path) -> None:
    holes = recording.assign(image=recording["image"].astype(np.float64))
    holes["image"][0, 1] = np.nan
    with pytest.raises(EstimateError, match=r"image: 1 of .* images have no valid pixel"):
        write_estimate(prepare(holes), tmp_path / "estimate.zarr")
