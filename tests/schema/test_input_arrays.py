"""Whatever is given for arrays and numbers, the result is a data set of its own, or an error that names them."""

from __future__ import annotations

import contextlib
import warnings
from datetime import UTC, datetime
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as some

import scenetruth as st

GOOD: dict[str, Any] = {"images": np.zeros((2, 3, 4, 5)), "focal_length_px": 100.0, "baseline_mm": 5.0}
RECORDING = st.make_recording(**GOOD)
NO_NUMBERS: list[Any] = [
    *(None, "x", "1", b"1", True, [], [1.0], {}, 1j, float("nan"), float("inf"), -float("inf"), 10**400),
    *(np.zeros(1), np.zeros((1, 1)), np.array(True), np.datetime64("2020"), object(), datetime(2020, 1, 1, tzinfo=UTC)),
    *(Fraction(1, 2), np.float64("nan"), np.bool_(True), np.array("1"), np.complex128(1)),
]
NO_ARRAYS: list[Any] = [
    *(None, "x", 3, np.float64(1), [], {}, object(), [[1], [2, 3]], np.zeros((2, 3, 4, 5), dtype=complex)),
    *(np.zeros((2, 3, 4, 5), dtype=object), np.zeros((2, 3, 4, 5), dtype="datetime64[s]"), np.zeros((2, 3, 4, 0))),
    *(np.zeros((2, 3, 4, 5), dtype=[("a", "f4")]), np.zeros((2, 3, 4, 5), dtype=bool), np.zeros((2, 3, 4, 5), "U1")),
]


# An id must be the same in every process that tests: no address in it.
@pytest.mark.parametrize("value", NO_NUMBERS, ids=lambda value: repr(value).partition(" object at ")[0])
@pytest.mark.parametrize("name", ["focal_length_px", "baseline_mm", "frame_interval_s", "full_scale"])
def test_what_is_no_number_is_refused_by_name(name: str, value: Any) -> None:
    if name == "full_scale" and value is None:
        return
    with pytest.raises(st.RecordingError, match=f"- {name}: must be a finite number"):
        st.make_recording(**GOOD | {name: value})


@pytest.mark.parametrize("value", [np.float32(3), np.int64(3), 3, np.array(3.0), np.uint8(3)])
def test_numbers_of_numpy_are_numbers(value: Any) -> None:
    made = st.make_recording(**GOOD | {"focal_length_px": value, "full_scale": value})
    assert (made.attrs["focal_length_px"], made.attrs["full_scale"]) == (3.0, 3.0)
    assert type(made.attrs["focal_length_px"]) is float


@pytest.mark.parametrize("value", [3, "ab", [1], [1, 2, 3], [1, "x"], [None, 1], np.zeros((2, 2)), {1, 2}, np.array(1)])
def test_what_is_no_pair_is_refused(value: Any) -> None:
    with pytest.raises(st.RecordingError, match="principal_point_px"):
        st.make_recording(**GOOD | {"principal_point_px": value})


@pytest.mark.parametrize("value", NO_ARRAYS, ids=lambda value: f"{type(value).__name__} {getattr(value, 'dtype', '')}")
def test_what_is_no_array_of_images_is_refused(value: Any) -> None:
    with pytest.raises(st.RecordingError, match="images: "):
        st.make_recording(**GOOD | {"images": value})


@pytest.mark.parametrize("value", NO_ARRAYS, ids=lambda value: f"{type(value).__name__} {getattr(value, 'dtype', '')}")
@pytest.mark.parametrize("name", ["depth", "velocity", "depth_std", "t", "status", "depth_rate"])
def test_what_is_no_map_is_refused(name: str, value: Any) -> None:
    if value is None or (name == "depth_rate" and isinstance(value, int | np.float64)):
        return
    arrays = {"depth": np.ones((3, 4, 5)), "flow": np.ones((2, 3, 4, 5)), name: value}
    with pytest.raises(st.RecordingError, match=rf"- ({name}|): "):
        st.make_estimate(recording=RECORDING, **arrays)


@pytest.mark.parametrize("name", ["status", "depth_rate"])
@pytest.mark.parametrize("shape", [(4, 5), (1, 4, 5), (5,), (1,), (4, 1), (3, 1, 1)])
def test_maps_of_one_frame_are_not_those_of_several(name: str, shape: tuple[int, ...]) -> None:
    ones: Any = np.ones(shape)
    for frames in ((3, 4, 5), (4, 5)):
        arrays = {"depth": np.ones(frames), "flow": np.ones((2, *frames)), name: ones}
        if frames == (4, 5) and shape in ((4, 5), (1, 4, 5)):
            st.make_estimate(recording=RECORDING, **arrays)
            continue
        with pytest.raises(st.RecordingError, match=rf"- {name}: must .*have the shape"):
            st.make_estimate(recording=RECORDING, **arrays)


@pytest.mark.parametrize("like", [None, "x", {}, np.zeros(3), xr.Dataset(), xr.DataArray(np.zeros(3))], ids=repr)
def test_what_is_no_recording_is_refused(like: Any) -> None:
    with pytest.raises(st.RecordingError):
        st.make_estimate(recording=like, depth=np.ones((3, 4, 5)))
    with pytest.raises(st.RecordingError):
        st.estimate(like)
    with pytest.raises(st.ScoreError):
        st.score(like, like)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"settings": "abc"}, "settings: must be a mapping"),
        ({"settings": [("tau", 1)]}, "settings: must be a mapping"),
        ({"settings": 3}, "settings: must be a mapping"),
        ({"settings": {3: 4}}, "keys must be texts"),
        ({"settings": {"tau": float("nan")}}, "tau: .*finite"),
        ({"settings": {"tau": 10**400}}, "tau: does not fit into 64 bits"),
        ({"window_taps_px": 1e300}, "window_taps_px"),
        ({"window_taps_px": 10**9 + 1}, "window_taps_px: .*less than or equal to 1001"),
        ({"working_point_px": 10**12}, "working_point_px: .*less than or equal to 32768"),
        ({"progress": 3}, "progress: must be callable"),
        ({"progress": "print"}, "progress: must be callable"),
        ({"method": None}, "is not a method"),
        ({"method": 3}, "is not a method"),
        ({"method": ""}, "no such method"),
        ({"method": "\0:x"}, "cannot be imported"),
        ({"method": "a:b:c"}, "cannot be imported"),
    ],
    ids=str,
)
def test_calls_of_estimate_that_make_no_sense(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(st.EstimateError, match=message):
        st.estimate(RECORDING, **arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"settings": {"interior_margin_px": "x"}}, "interior_margin_px"),
        ({"settings": {"interior_margin_px": float("nan")}}, "interior_margin_px"),
        ({"settings": {"interior_margin_px": -1}}, "interior_margin_px"),
        ({"settings": {"growth_window_px": 1e9}}, "growth_window_px"),
        ({"metadata": [1]}, "metadata: must be a mapping"),
        ({"settings": {"nonsense": 1}}, "nonsense"),
    ],
    ids=str,
)
def test_calls_of_score_that_make_no_sense(arguments: dict[str, Any], message: str) -> None:
    found = st.make_estimate(recording=RECORDING, depth=np.ones((3, 4, 5)))
    with pytest.raises(st.ScoreError, match=message):
        st.score(found, found, **arguments)


def test_parts_that_are_no_data_sets() -> None:
    found = st.make_estimate(recording=RECORDING, depth=np.ones((3, 4, 5)))
    parts: list[tuple[Any, Any, dict[str, Any]]] = [
        (None, found, {}),
        (RECORDING, "x", {}),
        (RECORDING, found, {"truth": 3}),
        (RECORDING, found, {"score": {}}),
        (RECORDING, found, {"progress": 3}),
    ]
    for recording, estimate, more in parts:
        with pytest.raises(
            st.ScoreError,
            match=r"must be an xarray\.Dataset|must be a Score|progress: must be callable|recording: is missing",
        ):
            st.write_report(estimate, recording=recording, output="unused", **more)
    with pytest.raises(st.ScoreError, match=r"must be an xarray\.Dataset"):
        st.compute_growth_rate(None)  # type: ignore[arg-type]
    with pytest.raises(st.SceneError, match="must be a file path"):
        st.track_points(None, found, [0])  # type: ignore[arg-type]


junk = some.sampled_from([*NO_NUMBERS, *NO_ARRAYS, 1, 2.5, 1e300, 5e-324, np.ones((2, 3, 4, 5)), np.ones(2), [0, 5]])


@given(some.fixed_dictionaries({}, optional=dict.fromkeys(
    ["images", "focal_length_px", "baseline_mm", "principal_point_px", "frame_interval_s", "stage_x_mm", "stage_y_mm",
     "full_scale", "attrs"], junk)))  # fmt: skip
def test_any_arguments_give_a_recording_or_an_error_of_ours(changes: dict[str, Any]) -> None:
    with contextlib.suppress(st.RecordingError), warnings.catch_warnings():
        # Of implausible units, as a focal length of 1 px.
        warnings.simplefilter("ignore", st.SceneWarning)
        assert st.make_recording(**GOOD | changes).image.shape


@given(some.dictionaries(some.sampled_from(
    ["depth", "disparity", "flow", "velocity", "depth_rate", "depth_std", "velocity_std", "status", "t"]),
    junk | some.sampled_from([np.ones((3, 4, 5)), np.ones((4, 5)), np.full((4, 5), 1e-300), np.ones((2, 3, 4, 5)),
                              np.full((3, 4, 5), 1e300), np.full((3, 4, 5), np.nan)])))  # fmt: skip
def test_any_arrays_give_an_estimate_or_an_error_of_ours(arrays: dict[str, Any]) -> None:
    with contextlib.suppress(st.RecordingError), warnings.catch_warnings():
        warnings.simplefilter("ignore", st.EstimateWarning)
        made = st.make_estimate(recording=RECORDING, **arrays)
        assert all(not np.isinf(item.values).any() for item in made.data_vars.values())


def test_a_recording_keeps_no_array_of_its_caller() -> None:
    images, stage = np.zeros((2, 3, 4, 5)), np.array([0.0, 5.0])
    more: dict[str, Any] = {"notes": [1, 2]}
    recording = st.make_recording(images, 100.0, 5.0, stage_x_mm=stage, attrs=more)
    images += 0.5
    stage += 1
    more["notes"].append(3)
    assert float(recording.image.max()) == 0
    assert recording.stage_x_mm.values.tolist() == [0, 5]
    assert recording.attrs["notes"] == [1, 2]
    recording.image[:] = 0.25
    assert images.max() == 0.5
    assert np.may_share_memory(st.make_recording(images, 100.0, 5.0, copy=False).image.values, images)


def test_a_view_of_one_value_stays_one() -> None:
    values = np.broadcast_to(np.zeros((), dtype=np.float32), (100, 1000, 1000, 1000))
    recording = st.make_recording(values, 1000.0, 5.0)
    assert recording.image.values.strides == (0, 0, 0, 0)
    assert not np.may_share_memory(recording.image.values, values)


def test_an_estimate_shares_nothing_with_its_recording_or_its_arrays() -> None:
    depth, frames = np.ones((3, 4, 5), dtype=np.float32), np.array([-1, 0, 1])
    found = st.make_estimate(recording=RECORDING, depth=depth, t=frames)
    depth[:], frames[:] = 7, 9
    assert float(found.depth.max()) == 1
    assert found.t.values.tolist() == [-1, 0, 1]
    parts = [item.values for item in (*found.variables.values(),)]
    assert not any(np.may_share_memory(one, other.values) for one in parts for other in RECORDING.variables.values())

    def looking(recording: xr.Dataset) -> xr.Dataset:
        found = st.make_estimate(recording=recording, depth=np.ones((3, 4, 5)))
        found["depth"] = (("t", "y", "x"), recording.image.values[0], found.depth.attrs)
        return found

    images = np.ones((2, 3, 4, 5), dtype=np.float32)
    recording = st.make_recording(images, 100.0, 5.0)
    estimate = st.estimate(recording, looking)
    estimate.depth[:] = 9
    assert float(recording.image.max()) == 1


def test_masked_pixels_of_maps_are_unknown() -> None:
    depth = np.ma.masked_array(np.ones((4, 5)), mask=np.eye(4, 5, dtype=bool))
    found = st.make_estimate(recording=RECORDING, depth=depth)
    np.testing.assert_array_equal(np.isnan(found.depth.values[0]), np.eye(4, 5, dtype=bool))


def test_reserved_attributes_are_refused() -> None:
    with pytest.raises(st.RecordingError, match="attrs: must not contain baseline_mm, scenetruth"):
        st.make_recording(**GOOD, attrs={"baseline_mm": 3, "scenetruth": "x"})


@pytest.mark.parametrize("dim", ["s", "t", "y", "x"])
@pytest.mark.parametrize("of_mask", [False, True])
def test_labels_that_contradict_the_order_of_an_array_are_asked_for(dim: str, of_mask: bool) -> None:
    values = np.random.default_rng(0).uniform(0, 1, (3, 4, 5, 6))
    labels = {name: np.arange(size) for name, size in zip("styx", values.shape, strict=True)}
    sorted_images = xr.DataArray(values, dims=tuple("styx"), coords=labels)
    backwards = sorted_images.isel({dim: slice(None, None, -1)})
    images, mask = (sorted_images, backwards > 0.5) if of_mask else (backwards, None)
    name = "exclusion_mask" if of_mask else "images"
    with pytest.raises(st.RecordingError, match=rf"{name}: has labels of {dim} .* {name}\.sortby\('{dim}'\)"):
        st.make_recording(images, 500, 5, exclusion_mask=mask)
    drop = backwards.drop_vars(dim)
    made = st.make_recording(drop, 500, 5)
    np.testing.assert_array_equal(made.image.values, drop.values)
    made = st.make_recording(backwards.sortby(dim).transpose("x", "t", "s", "y"), 500, 5)
    np.testing.assert_array_equal(made.image.values, values)


def test_lengths_as_labels_of_pixels_do_not_count() -> None:
    images = xr.DataArray(
        np.zeros((2, 3, 5, 6)), dims=tuple("styx"), coords={"y": 0.25 * np.arange(5)[::-1], "x": list("abcdef")}
    )
    assert st.make_recording(images, 500, 5).sizes["y"] == 5
