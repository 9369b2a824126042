"""Every rig that can see something is estimated against a plane in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.method_settings import StructureTensorSettings
from scenetruth.estimators.structure_tensor.filters import choose_acquisition_axes
from scenetruth.schema import STATUS_INVALID, STATUS_VALID
from tests.estimators.structure_tensor.analytic import Plane

Array = NDArray[np.float64]

# Disparity 2.05 px where the working point is 2: what is left is small, as after registration.
PLANE = Plane(depth_mm=488.0, velocity=(0.1, -0.05, 0.3), size=(44, 60))
WORKING_POINT: dict[str, Any] = {"working_point_px": 2}
# What filters leave of texture of 6 to 20 px at displacements of 0.1 to 0.3 px per step: two taps are the trapezium
# rule, (k u)^2 / 12 of the displacement; longer ones match to a few parts in ten thousand.
FEW, MANY = 1e-3, 2e-4


def positions(count: int) -> Array:
    return np.arange(count, dtype=np.float64) - (count - 1) // 2


def errors(recording: xr.Dataset, plane: Plane, **settings: Any) -> tuple[dict[str, float], xr.Dataset]:
    """Return the largest errors at the reference frame, relative where that makes sense, and the estimate."""
    estimate = st.estimate(recording, **settings).sel(t=0)
    truth = plane.truth()
    known = estimate["status"].values == STATUS_VALID
    assert known.sum() >= 150
    result = {}
    for name in ("disparity", "flow", "divergence"):
        result[name] = float(np.max(np.abs(estimate[name].values - truth[name])[..., known]))
    result["depth"] = float(np.max(np.abs(estimate["depth"].values / truth["depth"] - 1)[known]))
    speed = np.abs(estimate["velocity"].values - truth["velocity"])[:, known]
    result |= {f"U_{axis}": float(np.max(part)) for axis, part in zip("XYZ", speed, strict=True)}
    return result, estimate


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6, 7, 8, 9])
def test_any_number_of_cameras(count: int) -> None:
    found, _ = errors(PLANE.recording(positions(count), 9), PLANE, **WORKING_POINT)
    assert found["disparity"] <= (FEW if count == 2 else MANY)
    assert found["flow"] <= MANY
    assert found["divergence"] <= 0.03 * 0.3 / 488
    assert found["U_Z"] <= 0.03 * 0.3


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6, 7, 8, 9, 10, 12])
def test_any_number_of_frames(count: int) -> None:
    found, estimate = errors(PLANE.recording(positions(5), count), PLANE, **WORKING_POINT)
    assert found["disparity"] <= MANY
    assert found["flow"] <= (FEW if count == 2 else MANY)
    assert found["U_Z"] <= 0.04 * 0.3
    assert estimate.attrs["window_taps_frames"] == {7: 3, 8: 3}.get(count, 5 if count >= 9 else 1)


@pytest.mark.parametrize(
    ("cameras", "frames", "outputs"), [(5, 2, [0]), (5, 4, [0, 1]), (2, 9, [0]), (5, 11, [-1, 0, 1])]
)
def test_frames_that_are_estimated(cameras: int, frames: int, outputs: list[int]) -> None:
    assert st.estimate(PLANE.recording(positions(cameras), frames))["t"].values.tolist() == outputs


def test_two_images_and_two_times() -> None:
    found, _ = errors(PLANE.recording([0, 1], 2), PLANE, **WORKING_POINT)
    assert found["disparity"] <= FEW
    assert found["flow"] <= FEW
    assert found["depth"] <= FEW


@pytest.mark.parametrize(
    "stage", [[-2.1, -1.05, 0, 0.9, 2.02], [-1.1, 0, 1.8, 3.1], [-1.0, 0, 2.0], [-3.3, -1.9, -1, 0, 1.2, 2.1, 2.7]]
)
def test_unequal_stage_positions(stage: list[float]) -> None:
    found, estimate = errors(PLANE.recording(stage, 9), PLANE, **WORKING_POINT)
    assert estimate.attrs["filters_s"].startswith("least squares")
    # The interpolation of shifts by parts of a pixel adds to what filters leave: quintic splines, a few 1e-4 at 6 px.
    assert found["disparity"] <= 5e-4
    assert found["flow"] <= MANY
    assert found["U_Z"] <= 0.05 * 0.3


def test_the_true_stage_positions_are_used() -> None:
    """A stage that goes 1 % too far shows disparities 1 % too large, unless its positions are told."""
    recording = PLANE.recording(positions(5) * 1.01, 9)
    told, _ = errors(recording, PLANE, **WORKING_POINT)
    untold = recording.assign_coords(stage_x_mm=("s", positions(5)))
    wrong = st.estimate(untold, **WORKING_POINT).sel(t=0)
    assert told["depth"] <= 1e-4
    assert float((wrong["disparity"] / PLANE.truth()["disparity"]).median()) == pytest.approx(1.01, abs=1e-4)


def test_a_single_time_gives_depth_alone() -> None:
    recording = PLANE.recording(positions(5), 1)
    estimate = st.estimate(recording, **WORKING_POINT).sel(t=0)
    known = estimate["status_disparity"].values == STATUS_VALID
    assert known.sum() >= 150
    assert (estimate["status"].values == estimate["status_disparity"].values).all()
    assert (estimate["status_motion"] == STATUS_INVALID).all()
    for name in ("flow", "velocity", "divergence", "velocity_std"):
        assert np.isnan(estimate[name]).all(), name
    np.testing.assert_allclose(estimate["disparity"].values[known], PLANE.truth()["disparity"][known], atol=MANY)
    assert np.isfinite(estimate["depth_std"].values[known]).all()


def test_a_single_camera_gives_flow_and_divergence_alone() -> None:
    recording = PLANE.recording([0.0], 9)
    estimate = st.estimate(recording).sel(t=0)
    known = estimate["status_motion"].values == STATUS_VALID
    assert known.sum() >= 150
    assert (estimate["status"].values == estimate["status_motion"].values).all()
    for name in ("depth", "disparity", "velocity", "depth_std", "velocity_std", "disparity_std"):
        assert np.isnan(estimate[name]).all(), name
    truth = PLANE.truth()
    np.testing.assert_allclose(estimate["flow"].values[:, known], truth["flow"][:, known], atol=MANY)
    np.testing.assert_allclose(estimate["divergence"].values[known], truth["divergence"][known], atol=0.03 * 0.3 / 488)


def test_one_camera_of_several_sees_the_same_flow() -> None:
    """The case of one camera is the same code: with images that do not differ along s, both agree."""
    alone = PLANE.recording([0.0], 9)
    together = st.make_recording(np.repeat(alone["image"].values, 5, axis=0), 1000.0, 1.0)
    one, five = (st.estimate(data, working_point_px=0) for data in (alone, together))
    np.testing.assert_allclose(one["flow"], five["flow"], atol=1e-6)
    np.testing.assert_allclose(one["divergence"], five["divergence"], atol=1e-8)


@pytest.mark.parametrize("channels", [1, 3])
def test_channels_add_their_tensors(channels: int) -> None:
    colours = PLANE.recording(positions(5), 9, channels=channels)
    whole = st.estimate(colours, **WORKING_POINT)
    # A tensor's trace is the sum of its eigenvalues.
    parts = [
        st.estimate(st.make_recording(colours["image"].values[..., channel], 1000.0, 1.0), **WORKING_POINT)[
            "eigenvalues"
        ].sum("rank", skipna=False)
        for channel in range(channels)
    ]
    np.testing.assert_allclose(whole["eigenvalues"].sum("rank", skipna=False), sum(parts), rtol=2e-5)
    found, _ = errors(colours, PLANE, **WORKING_POINT)
    assert found["disparity"] <= MANY


def test_colours_in_which_nothing_is_grey() -> None:
    """A texture that two channels show with opposite signs vanishes in their mean, not in their tensors."""
    grey = PLANE.recording(positions(5), 9)["image"].values
    colours = st.make_recording(np.stack([grey, 1 - grey], axis=-1), 1000.0, 1.0)
    for settings in (WORKING_POINT, {"working_point_px": "auto"}, {}):
        found, estimate = errors(colours, PLANE, **settings)
        assert found["disparity"] <= MANY
        assert estimate.attrs["working_point_px"] == 2


def test_a_recording_of_any_length_has_every_estimate_of_its_parts() -> None:
    images = PLANE.recording(positions(5), 13)["image"].values
    long = st.estimate(st.make_recording(images, 1000.0, 1.0), **WORKING_POINT)
    assert long["t"].values.tolist() == [-2, -1, 0, 1, 2]
    for index in range(5):
        alone = st.estimate(st.make_recording(images[:, index : index + 9], 1000.0, 1.0), **WORKING_POINT)
        for name in long.data_vars:
            np.testing.assert_array_equal(long[name].isel(t=index), alone[name].isel(t=0), err_msg=str(name))


@pytest.mark.parametrize(
    ("count_t", "taps", "window"), [(1, 1, 1), (2, 2, 1), (3, 3, 1), (5, 5, 1), (8, 5, 3), (20, 5, 5)]
)
def test_what_a_number_of_frames_allows(count_t: int, taps: int, window: int) -> None:
    rig = choose_acquisition_axes(positions(5), count_t, StructureTensorSettings())
    assert (len(rig.over_t.nodes), len(rig.window_t)) == (taps, window)
    assert len(rig.outputs(count_t)) == count_t - taps - window + 2
    assert rig.centre_t == (0.5 if count_t == 2 else 0.0)


@pytest.mark.parametrize(
    ("stage", "centre"), [([-1, 0, 1], 0.0), ([0, 1], 0.5), ([-1, 0, 1, 2], 0.5), ([0, 1, 2], 1.0)]
)
def test_where_estimates_belong(stage: list[float], centre: float) -> None:
    rig = choose_acquisition_axes(np.array(stage, dtype=np.float64), 9, StructureTensorSettings())
    assert rig.centre_s == centre
    assert (rig.over_s.nodes == np.array(stage) - centre).all()
