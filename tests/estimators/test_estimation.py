"""The door that every method's recording and estimate pass, and what a method is given."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.errors import Problem
from scenetruth.estimators import Method, Needs, StreamingMethod, user_code
from scenetruth.estimators.estimation import read_only
from scenetruth.schema import blank_estimate

Estimate = Callable[[xr.Dataset], Any]


@pytest.fixture
def recording() -> xr.Dataset:
    return st.make_recording(np.random.default_rng(0).random((3, 2, 30, 40)), focal_length_px=500, baseline_mm=5)


def good(recording: xr.Dataset) -> xr.Dataset:
    return st.make_estimate(recording=recording, depth=np.full((30, 40), 900.0), flow=np.zeros((2, 30, 40)))


class Doing(Method):
    """A method that does what a test says."""

    name: str = "doing"

    def __init__(self, work: Estimate, **attributes: Any) -> None:
        self._work = work
        for name, value in attributes.items():
            setattr(self, name, value)

    def estimate(self, recording: xr.Dataset, settings: Any, progress: Any) -> Any:
        return self._work(recording)


def write_to(recording: xr.Dataset) -> xr.Dataset:
    recording["image"].values[0, 0, 0, 0] = 7
    return good(recording)


def raise_zero_division(recording: xr.Dataset) -> xr.Dataset:
    return recording / (1 // 0)


def leave(recording: xr.Dataset) -> xr.Dataset:
    sys.exit(3)


HERE = r"[\w/]*test_estimation\.py"


@pytest.mark.parametrize(
    ("work", "message"),
    [
        (leave, rf"method 'doing': failed: it called sys.exit\(3\) \({HERE}:[0-9]+ in leave\)"),
        (lambda r: raise_zero_division(r), rf"ZeroDivisionError: .* \({HERE}:[0-9]+ in raise_zero_division\)"),
        (lambda r: np.linalg.inv(np.zeros((2, 2))), rf"Singular matrix \({HERE}:[0-9]+ in <lambda>\)"),
        (lambda r: st.make_estimate(recording=r), rf"method 'doing' \({HERE}:[0-9]+ in <lambda>\)"),
        (raise_zero_division, "method 'doing': failed: ZeroDivisionError"),
        (write_to, "method 'doing': modifies the recording passed to it"),
        (lambda _: None, "output of method 'doing'.*is not an xarray.Dataset.*'NoneType'"),
        (lambda r: good(r).drop_vars("flow"), "flow: is declared by the method, but missing"),
        (lambda r: good(r).astype(np.int32), "depth: must contain floats"),
        (lambda r: good(r).isel(x=slice(5, 30)), "x: must have the recording's 40 pixels"),
        (lambda r: good(r).assign_coords(x=np.arange(40) + 100), "x: has 40 values that are missing in the recording"),
        (lambda r: good(r).assign_coords(t=[9]), "t: has 1 values that are missing in the recording"),
        (lambda r: good(r).transpose("x", "y", "t", ...), "depth: must have the dimensions"),
        (lambda r: good(r).assign(depth=good(r)["depth"].assign_attrs(units="m")), "depth.units: must be 'mm'"),
        (
            lambda r: st.make_estimate(recording=r, depth=np.ones((4, 4))),
            "method 'doing'.*\n.*depth: must have the shape",
        ),
    ],
)
def test_what_goes_wrong_is_told_with_the_name_of_the_method(
    recording: xr.Dataset, work: Estimate, message: str
) -> None:
    before = recording.copy(deep=True)
    method = Doing(work, gives=frozenset({"depth", "flow"}))
    with pytest.raises(st.EstimateError, match=f"(?s){message}"):
        st.estimate(recording, method)
    xr.testing.assert_identical(recording, before)


def test_what_nobody_has_written_himself_has_no_place(recording: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(given: xr.Dataset) -> Any:
        return given.attrs["nokey"]

    monkeypatch.setattr(user_code, "is_user_file", lambda file: False)
    with pytest.raises(st.EstimateError, match=r"failed: KeyError: 'nokey'$"):
        st.estimate(recording, Doing(fail))


def test_an_interruption_is_no_failure_of_a_method(recording: xr.Dataset) -> None:
    def interrupted(given: xr.Dataset) -> xr.Dataset:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        st.estimate(recording, Doing(interrupted))


def test_maps_of_unknown_names_are_told_with_the_known_ones(recording: xr.Dataset) -> None:
    with pytest.raises(st.EstimateError) as caught:
        st.estimate(recording, lambda recording: {"dpeth": np.zeros((30, 40)), "like": 1, "quux": 2})
    told = str(caught.value)
    assert "dpeth: is not a quantity of an estimate; did you mean 'depth'? Valid: depth, disparity, flow," in told
    assert "quux: is not a quantity of an estimate. Valid: depth" in told
    assert "like: is not a quantity" in told
    assert ", like" not in told


def test_the_recording_cannot_be_changed_through_its_containers(recording: xr.Dataset) -> None:
    def meddle(given: xr.Dataset) -> xr.Dataset:
        result = good(given)
        given.attrs["focal_length_px"] = 1.0
        given["image"].attrs["units"] = "apples"
        given["extra"] = given["image"]
        return result

    before = recording.copy(deep=True)
    st.estimate(recording, Doing(meddle))
    xr.testing.assert_identical(recording, before)


@pytest.mark.parametrize(
    ("needs", "message"),
    [
        (Needs(cameras=4), r"stage\.positions: 'doing' needs 4 camera positions \(got 3\)"),
        (Needs(frames=3), r"frames\.count: 'doing' needs 3 frames \(got 2\)"),
        (Needs(channels=3), r"channel: 'doing' takes images of 3 channels \(got 1\)"),
    ],
)
def test_what_a_method_needs_is_asked_for_before_it_works(recording: xr.Dataset, needs: Needs, message: str) -> None:
    def never(_: xr.Dataset) -> None:
        raise AssertionError

    with pytest.raises(st.EstimateError, match=message):
        st.estimate(recording, Doing(never, needs=needs))


def test_requirements_of_the_method_itself_are_asked_too(recording: xr.Dataset) -> None:
    def requirements(given: xr.Dataset, settings: Any) -> list[Problem]:
        return [Problem("camera.width", "is not a power of two", given.sizes["x"])]

    with pytest.raises(st.EstimateError, match=r"camera\.width: is not a power of two"):
        st.estimate(recording, Doing(good, requirements=requirements))


def test_settings_come_as_model_mapping_or_keywords(recording: xr.Dataset) -> None:
    from scenetruth.estimators import validate_settings
    from scenetruth.estimators.registry import find_method

    model = validate_settings(find_method("structure_tensor"), {"working_point_px": 0, "window_sigma_px": 4.0})
    one = st.estimate(recording, "structure_tensor", model)
    two = st.estimate(recording, settings={"working_point_px": 0}, window_sigma_px=4.0)
    xr.testing.assert_identical(one, two)
    with pytest.raises(st.EstimateError, match="window_sigma: unknown setting of 'structure_tensor'; did you mean"):
        st.estimate(recording, window_sigma=3)


def test_progress_may_interrupt(recording: xr.Dataset) -> None:
    class StopError(BaseException):
        pass

    def stop(*_: Any) -> None:
        raise StopError

    with pytest.raises(StopError):
        st.estimate(recording, progress=stop, working_point_px=0)


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


def test_lens_and_times_that_a_method_ignores_are_warned_of() -> None:
    """Unless the method declares that it takes account of them."""
    times = np.arange(3) + 0.25 * np.arange(2)[:, None]
    distortion = (-0.1, 0.0, 0.0, 0.0)
    recording = st.make_recording(np.zeros((2, 3, 30, 40)), 500.0, 5.0, planned_time_s=times, distortion=distortion)

    class Wall(Method):
        name = "wall"

        def estimate(self, recording: Any, settings: Any, progress: Any) -> xr.Dataset:
            return st.make_estimate(recording=recording, depth=np.full((30, 40), 900.0))

    class Aware(Wall):
        needs = Needs(distortion=True, schedule=True)

    with pytest.warns(st.EstimateWarning) as caught:
        st.estimate(recording, Wall())
    assert {str(warning.message).partition(":")[0] for warning in caught} == {"attrs.distortion", "planned_time_s"}
    assert any("'wall' assumes a pinhole camera" in str(warning.message) for warning in caught)
    assert any("up to 0.25 s apart" in str(warning.message) for warning in caught)
    st.estimate(recording, Aware())
    st.estimate(recording.drop_vars("planned_time_s").assign_attrs(distortion=[0.0] * 4), Wall())


def write_through_c(recording: xr.Dataset) -> xr.Dataset:
    ctypes.memset(recording["image"].values.ctypes.data, 0, 64)
    return good(recording)


def write_after_setflags(recording: xr.Dataset) -> xr.Dataset:
    values = recording["image"].values
    values.setflags(write=True)
    values[0, 0] = 0.25
    return good(recording)


def write_to_the_positions(recording: xr.Dataset) -> xr.Dataset:
    found = good(recording)
    ctypes.memset(recording["stage_x_mm"].values.ctypes.data, 0, 8)
    return found


class DoingByFrames(StreamingMethod):
    """A streaming method that writes to the images."""

    name = "by_frames"

    def blank(self, recording: xr.Dataset, settings: Any) -> xr.Dataset:
        return blank_estimate(["disparity"], recording=recording, t=[0, 1])

    def fill(self, recording: xr.Dataset, settings: Any, put: Any, progress: Any) -> dict[str, Any]:
        write_through_c(recording)
        return {}


@pytest.mark.parametrize(
    ("method", "variable"),
    [
        (write_through_c, "image"),
        (write_after_setflags, "image"),
        (Doing(write_through_c), "image"),
        (write_to_the_positions, "stage_x_mm"),
        (DoingByFrames(), "image"),
    ],
)
def test_writing_below_the_flags_of_numpy_is_detected(recording: xr.Dataset, method: Any, variable: str) -> None:
    with pytest.raises(st.EstimateError, match=rf"modifies the recording .*\({variable}\)") as raised:
        st.estimate(recording, method)
    assert f"'{getattr(method, '__name__', None) or method.name}'" in str(raised.value)


def test_writing_to_a_copy_is_allowed(recording: xr.Dataset) -> None:
    before = recording.copy(deep=True)

    def careful(given: xr.Dataset) -> xr.Dataset:
        write_after_setflags(given.copy(deep=True))
        return good(given)

    st.estimate(recording, careful)
    xr.testing.assert_identical(recording, before)
