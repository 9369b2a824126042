"""Estimates from plain arrays: what follows from them is exact, what does not fit is told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

import scenetruth as st
from tests.helpers.analytic_plane import Plane

PLANE = Plane(velocity=(0.4, -0.3, 2.0), slope=0.3)
TRUTH = PLANE.truth(5.0)
SIZE = PLANE.size


@pytest.fixture(scope="module")
def recording() -> xr.Dataset:
    return st.make_recording(np.zeros((3, 3, *SIZE), np.float32), PLANE.focal_length_px, 5.0)


def test_disparity_follows_from_depth_and_back(recording: xr.Dataset) -> None:
    of_depth = st.make_estimate(recording=recording, depth=TRUTH["depth"], depth_std=np.full(SIZE, 0.1))
    of_disparity = st.make_estimate(recording=recording, disparity=TRUTH["disparity"])
    # float32 keeps 24 bits.
    np.testing.assert_allclose(of_depth["disparity"].values[0], TRUTH["disparity"], rtol=1.2e-7)
    np.testing.assert_allclose(of_disparity["depth"].values[0], TRUTH["depth"], rtol=1.2e-7)
    expected = 0.1 * TRUTH["disparity"] / TRUTH["depth"]
    np.testing.assert_allclose(of_depth["disparity_std"].values[0], expected, rtol=2e-7)
    maps = {"depth", "disparity", "depth_std", "disparity_std"}
    assert set(of_depth.data_vars) == {*maps, "status", "status_disparity", "valid", "invalid_reason"}


def test_velocity_follows_from_flow_depth_and_its_rate(recording: xr.Dataset) -> None:
    """The plane's closed form: flow and velocity are each other's inverse at known depth."""
    rate = PLANE.velocity[2]
    found = st.make_estimate(recording=recording, depth=TRUTH["depth"], flow=TRUTH["flow"], depth_rate=rate)
    np.testing.assert_allclose(found["velocity"].values[:, 0], TRUTH["velocity"], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(found["divergence"].values[0], TRUTH["divergence"], rtol=2e-7)
    back = st.make_estimate(recording=recording, depth=TRUTH["depth"], velocity=TRUTH["velocity"])
    np.testing.assert_allclose(back["flow"].values[:, 0], TRUTH["flow"], rtol=1e-6, atol=1e-7)


def test_rate_of_depth_is_that_along_the_flow(recording: xr.Dataset) -> None:
    """On a slanted plane the depth of a pixel changes otherwise than that of its surface point.

    Central differences along the flow are off by half the third derivative of the path and by the bilinear
    interpolation of a depth that curves by less than 1e-4 mm per px squared.
    """
    depth = np.stack([PLANE.depth(0.0, t) for t in (-1.0, 0.0, 1.0)])
    flow = np.repeat(TRUTH["flow"][:, None], 3, axis=1)
    found = st.make_estimate(recording=recording, depth=depth, flow=flow)
    inside = (slice(4, -4), slice(4, -4))
    middle = found["velocity"].sel(t=0, component="Z").values[inside]
    np.testing.assert_allclose(middle, PLANE.velocity[2], atol=2e-3)
    # A pixel's own change of depth is another number: this test can fail.
    assert np.abs((depth[2] - depth[0])[inside] / 2 - PLANE.velocity[2]).max() > 0.02
    with_one = found["velocity"].sel(t=1, component="Z").values[inside]
    np.testing.assert_allclose(with_one, PLANE.velocity[2], atol=0.03)


def test_nothing_is_invented(recording: xr.Dataset) -> None:
    flow_alone = st.make_estimate(recording=recording, flow=TRUTH["flow"])
    assert set(flow_alone.data_vars) == {"flow", "status", "status_motion", "valid", "invalid_reason"}
    one_frame = st.make_estimate(recording=recording, depth=TRUTH["depth"], flow=TRUTH["flow"])
    assert "velocity" not in one_frame


@settings(max_examples=30, deadline=None)
@given(mask=hnp.arrays(bool, SIZE), t=some.integers(-1, 1))
def test_nan_is_unknown_and_stays(mask: NDArray[np.bool_], t: int) -> None:
    recording = st.make_recording(np.zeros((3, 3, *SIZE), np.float32), PLANE.focal_length_px, 5.0)
    depth = np.where(mask, np.nan, TRUTH["depth"])
    found = st.make_estimate(recording=recording, depth=depth, flow=TRUTH["flow"], depth_rate=0.0, t=t)
    assert found["t"].values.tolist() == [t]
    for name in ("depth", "disparity", "divergence"):
        assert (np.isnan(found[name].values[0]) == mask).all()
    assert (found["status_disparity"].values[0] == np.where(mask, 0, 2)).all()
    assert (found["status_motion"].values == 2).all()
    assert (found["valid"].values[0] == ~mask).all()
    assert ((found["invalid_reason"].values[0] != 0) == mask).all()


def test_an_estimate_is_whole(recording: xr.Dataset, tmp_path: Path) -> None:
    status = np.full(SIZE, 2)
    status[:5] = 1
    status[5:9] = 3
    found = st.make_estimate(recording=recording, depth=TRUTH["depth"], status=status, method="mine")
    assert found.attrs["method"] == "mine"
    assert (found["status"].values[0] == status).all()
    assert (found["valid"].values[0] == (status == 2)).all()
    st.save_store(found, tmp_path / "estimate.zarr")
    xr.testing.assert_identical(st.load_store(tmp_path / "estimate.zarr", kind="estimate"), found)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({}, "at least one of depth, disparity, flow, velocity"),
        ({"depth": np.ones((4, 5))}, r"depth: must have the shape \(t, y, x\)"),
        ({"depth": np.ones(SIZE[::-1])}, "rows and columns appear to be swapped"),
        ({"flow": np.ones((*SIZE, 2))}, "move them to the front"),
        ({"flow": np.ones((3, *SIZE))}, r"flow: must have the shape \(2, t, y, x\)"),
        ({"depth": -np.ones(SIZE)}, "depth: must be positive: 3072 pixels are not"),
        ({"disparity": -np.ones(SIZE)}, r"must be positive \(x_s = x_0 - disparity s\).*change the sign"),
        (
            {"depth": np.full(SIZE, np.inf)},
            "3072 values that are infinite or exceed float32; mark invalid pixels as NaN",
        ),
        ({"depth": np.ones(SIZE, bool)}, "must hold real numbers"),
        ({"depth": np.ones(SIZE), "depth_std": -np.ones(SIZE)}, "depth_std: must not be negative"),
        ({"depth": np.ones((2, *SIZE))}, "arrays have 2 frames, the recording 3"),
        ({"depth": np.ones((2, *SIZE)), "flow": np.ones((2, 3, *SIZE))}, "different numbers of frames"),
        ({"depth": np.ones(SIZE), "t": 7}, "not in the recording, whose frames are"),
        ({"depth": np.ones(SIZE), "status": np.full(SIZE, 5)}, r"status: must have the shape .* hold 0 \(invalid\)"),
        ({"depth": np.full(SIZE, 0.5), "disparity": np.full(SIZE, 10.0)}, "0.001 times f V_X / disparity"),
        ({"depth": np.ones(SIZE), "flow": np.ones((2, *SIZE)), "depth_rate": np.ones(3)}, "depth_rate: must be"),
    ],
)
def test_what_does_not_fit_is_told(recording: xr.Dataset, arrays: dict[str, Any], message: str) -> None:
    with pytest.raises(st.RecordingError, match=message):
        st.make_estimate(recording=recording, **arrays)


def test_everything_wrong_is_told_at_once(recording: xr.Dataset) -> None:
    with pytest.raises(st.RecordingError, match="2 problems"):
        st.make_estimate(recording=recording, depth=np.ones((4, 5)), flow=np.ones((7, *SIZE)))


def test_few_pixels_without_a_positive_depth_become_invalid() -> None:
    recording = st.make_recording(np.zeros((2, 2, *SIZE)), 500.0, 5.0)
    disparity = np.full(SIZE, 4.0)
    disparity[0, :10] = [0.0, -1.0] * 5
    disparity[1, 0] = np.nan
    known = disparity.size - 1
    share = f"{100 * 10 / known:.2g}"
    with pytest.warns(
        st.EstimateWarning, match=rf"disparity: 10 of {known} finite pixels \({share} %\) are not positive"
    ):
        found = st.make_estimate(recording=recording, disparity=disparity, t=0)
    assert np.isnan(found["depth"].values[0, 0, :10]).all()
    assert not found["valid"].values[0, 0, :10].any()
    assert int(np.isfinite(found["disparity"].values).sum()) == known - 10


def test_labelled_maps_are_read_by_the_names_of_their_dimensions() -> None:
    recording = st.make_recording(np.zeros((2, 1, 6, 6)), focal_length_px=500, baseline_mm=5)
    depth = np.random.default_rng(0).uniform(400, 600, (6, 6))
    labelled = xr.DataArray(depth, dims=("y", "x"), coords={"y": np.arange(6), "x": np.arange(6)})
    turned = labelled.transpose("x", "y")
    flow = xr.DataArray(np.ones((6, 6, 2)), dims=("y", "x", "image_component"))
    found = st.make_estimate(recording=recording, depth=turned, flow=flow)
    np.testing.assert_allclose(found["depth"].values[0], depth, rtol=1e-6)
    assert found["flow"].sizes["image_component"] == 2
    with pytest.raises(st.RecordingError, match=r"depth: has labels of y that do not increase"):
        st.make_estimate(recording=recording, depth=labelled[::-1])
