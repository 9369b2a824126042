"""Slips that are put into right estimates are named, each by itself; shifts are measured to a share of a pixel."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray
from scipy import ndimage

import scenetruth as st
from scenetruth.errors import EstimateWarning, ScoreError
from scenetruth.schema import Intrinsics, label, make_estimate, make_recording, read_intrinsics
from scenetruth.scoring.convention_check import detect_convention_mismatches, fit_shift
from scenetruth.scoring.convention_hypotheses import NO_MISMATCH, ConventionMismatch
from scenetruth.scoring.convention_samples import MismatchSamples, read_mismatch_samples
from tests.helpers.mismatch_scenes import (
    BALL,
    BOX,
    FAR,
    PLANE,
    STAIRS,
    STILL,
    VARIABLES,
    WALL,
    Errors,
    estimate_of,
    right_estimate,
    truth_of,
)
from tests.helpers.nightly import NIGHTLY, by_night, nightly
from tests.helpers.scenes import SCENES

Map = NDArray[np.float64]
Change = Callable[[Map], Map]

USUAL = Errors()
"""A good method: half a percent of noise, half of it smooth, and some outliers."""


@pytest.fixture(scope="module")
def room() -> xr.Dataset:
    return truth_of(WALL, BALL)


@pytest.fixture(scope="module")
def right(room: xr.Dataset) -> xr.Dataset:
    return right_estimate(room, USUAL, seed=1)


@pytest.fixture(scope="module")
def square() -> xr.Dataset:
    return truth_of(WALL, BALL, width=48)


@pytest.fixture(scope="module")
def scenes(room: xr.Dataset, square: xr.Dataset) -> list[xr.Dataset]:
    """Scenes of all kinds: curved and plane, moving and still, with and without background, filled and not."""
    return [
        room,
        square,
        truth_of(BOX),
        truth_of(PLANE),
        truth_of(BALL, FAR),
        truth_of(STAIRS, focal_length_px=60),
        truth_of(BOX, PLANE, focal_length_px=200),
    ]


@pytest.fixture(scope="module")
def still() -> xr.Dataset:
    return truth_of(STILL, width=48)


def poor(seed: int) -> Errors:
    """Return errors up to several times those of a poor method."""
    rng = np.random.default_rng([2024, seed])
    return Errors(
        noise=rng.choice([0.0, 0.03 * rng.random()]),
        bias=0.02 * rng.random(),
        outliers=0.1 * rng.random(),
        missing=0.8 * rng.random(),
        blur_px=rng.choice([0.0, 3 * rng.random()]),
        coarse=rng.random(),
    )


def named(slips: list[ConventionMismatch]) -> set[tuple[str, str]]:
    return {(slip.quantity, slip.kind) for slip in slips}


def changed(right: xr.Dataset, quantity: str, change: Change) -> xr.Dataset:
    """Return one quantity of an estimate with a slip; each is looked at by itself."""
    return right[[quantity]].assign({quantity: (right[quantity].dims, change(right[quantity].values))})


def times(*factors: float) -> Change:
    column = np.array(factors)
    return lambda values: values * (column if len(factors) == 1 else column[:, None, None, None])


def rolled(right: int, down: int) -> Change:
    """Shift maps by whole pixels; what comes in is not known."""

    def change(values: Map) -> Map:
        moved = np.roll(values, (down, right), (-2, -1))
        for length, axis in ((down, -2), (right, -1)):
            gone = np.arange(values.shape[axis])
            outside = gone < length if length >= 0 else gone >= len(gone) + length
            moved = np.where(outside[:, None] if axis == -2 else outside, np.nan, moved)
        return moved

    return change


def halfway(right: int, down: int) -> Change:
    """Sample maps between pixels."""

    def change(values: Map) -> Map:
        for length, other in ((right, rolled(right, 0)), (down, rolled(0, down))):
            values = 0.5 * (values + other(values)) if length else values
        return values

    return change


UP_DOWN: Change = lambda values: values[..., ::-1, :]  # noqa: E731
MIRRORED: Change = lambda values: values[..., ::-1]  # noqa: E731
TURNED: Change = lambda values: values[..., ::-1, ::-1]  # noqa: E731
TRANSPOSED: Change = lambda values: np.swapaxes(values, -1, -2)  # noqa: E731
REVERSED: Change = lambda values: np.flip(values, axis=-3)  # noqa: E731
YX: Change = lambda values: values[[1, 0]]  # noqa: E731
YXZ: Change = lambda values: values[[1, 0, 2]]  # noqa: E731
ZYX: Change = lambda values: values[::-1]  # noqa: E731

VALUES: list[tuple[str, str, Change]] = [
    ("depth", "sign", times(-1)),
    ("depth", "metres", times(1e-3)),
    ("depth", "centimetres", times(0.1)),
    ("depth", "micrometres", times(1e3)),
    ("depth", "disparity", lambda depth: 90 * 7 / depth),
    ("depth", "inverse_depth", lambda depth: 1 / depth),
    ("depth", "inverse_depth_in_metres", lambda depth: 1000 / depth),
    ("disparity", "sign", times(-1)),
    ("disparity", "whole_baseline", times(4)),
    *(("disparity", "several_steps", times(count)) for count in (2, 8)),
    ("disparity", "depth", lambda disparity: 90 * 7 / disparity),
    ("disparity", "inverse_depth", lambda disparity: disparity / (90 * 7)),
    ("disparity", "inverse_depth_in_metres", lambda disparity: disparity / (90 * 7) * 1000),
    ("disparity", "image_widths", times(1 / 64)),
    ("flow", "sign", times(-1)),
    ("flow", "sign_x", times(-1, 1)),
    ("flow", "sign_y", times(1, -1)),
    ("flow", "components_exchanged", YX),
    ("flow", "per_second", times(30)),
    ("flow", "several_frames", times(4)),
    ("flow", "image_widths", times(1 / 64)),
    ("velocity", "sign", times(-1)),
    ("velocity", "sign_x", times(-1, 1, 1)),
    ("velocity", "sign_y", times(1, -1, 1)),
    ("velocity", "sign_z", times(1, 1, -1)),
    ("velocity", "sign_yz", times(1, -1, -1)),
    ("velocity", "sign_xy", times(-1, -1, 1)),
    ("velocity", "components_exchanged", YXZ),
    ("velocity", "components_reversed", ZYX),
    ("velocity", "metres", times(1e-3)),
    ("velocity", "per_second", times(30)),
    ("velocity", "metres_per_second", times(0.03)),
    ("velocity", "baselines", times(1 / 7)),
    *(("velocity", "several_frames", times(count)) for count in (2, 60)),
]
MORE_VALUES: list[tuple[str, str, Change]] = [
    *(("disparity", "several_steps", times(count)) for count in (3, 5, 6, 7)),
    *(("velocity", "several_frames", times(count)) for count in (3, 9, 25)),
]
PLACES: list[tuple[str, Change]] = [
    ("rows_upside_down", UP_DOWN),
    ("columns_mirrored", MIRRORED),
    ("maps_turned", TURNED),
    ("frames_reversed", REVERSED),
    *(("one_pixel", rolled(right, down)) for right, down in ((1, 0), (0, -1))),
    *(("half_pixel", halfway(right, down)) for right, down in ((-1, 0), (1, 1))),
]
# All directions are measured by day in `test_half_and_whole_pixels_are_told_with_their_signs`.
MORE_PLACES: list[tuple[str, Change]] = [
    *(("one_pixel", rolled(right, down)) for right, down in ((-1, 0), (0, 1), (1, 1), (-1, -1))),
    *(("half_pixel", halfway(right, down)) for right, down in ((1, 0), (0, 1), (0, -1), (-1, -1))),
]


@pytest.mark.parametrize(("quantity", "kind", "change"), [*VALUES, *by_night(*MORE_VALUES)])
def test_slips_of_values(room: xr.Dataset, right: xr.Dataset, quantity: str, kind: str, change: Change) -> None:
    slips = detect_convention_mismatches(changed(right, quantity, change), room)
    assert named(slips) == {(quantity, kind)}
    assert all(0.6 <= slip.explained <= 1 and quantity in slip.message for slip in slips)


@pytest.mark.parametrize("quantity", VARIABLES)
@pytest.mark.parametrize(("kind", "change"), [*PLACES, *by_night(*MORE_PLACES)])
def test_slips_of_place(room: xr.Dataset, right: xr.Dataset, quantity: str, kind: str, change: Change) -> None:
    slips = detect_convention_mismatches(changed(right, quantity, change), room)
    assert named(slips) == {(quantity, kind)}
    assert all(0.05 <= slip.explained <= 1 and quantity in slip.message for slip in slips)


@pytest.mark.parametrize("quantity", VARIABLES)
def test_transposed_maps(square: xr.Dataset, quantity: str) -> None:
    right = right_estimate(square, USUAL, seed=3)
    assert named(detect_convention_mismatches(changed(right, quantity, TRANSPOSED), square)) == {
        (quantity, "maps_transposed")
    }


@pytest.mark.parametrize("quantity", VARIABLES)
@pytest.mark.parametrize(("kind", "step"), [("frame_after", 1), ("frame_before", -1)])
def test_maps_of_the_frame_beside(room: xr.Dataset, quantity: str, kind: str, step: int) -> None:
    right = right_estimate(room, Errors(noise=0.002, bias=0.001), seed=4)
    own, other = right.isel(t=slice(1, 4)), right.isel(t=slice(1 + step, 4 + step))
    wrong = changed(own, quantity, lambda _: other[quantity].values)
    assert named(detect_convention_mismatches(wrong, room)) == {(quantity, kind)}
    single = wrong.isel(t=[1])
    assert named(detect_convention_mismatches(single, room)) == {(quantity, kind)}


def test_distance_along_the_ray(room: xr.Dataset) -> None:
    right = right_estimate(room, USUAL, seed=5)
    x, y = (right["x"] - 31.5) / 90, (right["y"] - 23.5) / 90
    wrong = right.assign(depth=(right["depth"] * np.sqrt(1 + x**2 + y**2)).transpose("t", "y", "x"))
    assert named(detect_convention_mismatches(wrong, room)) == {("depth", "range")}


def test_motion_in_pixels_of_a_thinned_image(room: xr.Dataset) -> None:
    right = right_estimate(room, USUAL, seed=6).isel(y=slice(None, None, 2), x=slice(4, None, 2))
    assert detect_convention_mismatches(right, room) == []
    wrong = right.assign(flow=0.5 * right["flow"], disparity=0.5 * right["disparity"])
    assert named(detect_convention_mismatches(wrong, room)) == {
        ("flow", "pixels_of_the_map"),
        ("disparity", "pixels_of_the_map"),
    }


def test_several_slips_at_once(room: xr.Dataset) -> None:
    right = right_estimate(room, USUAL, seed=7)
    wrong = right.assign(
        depth=0.001 * right["depth"],
        velocity=(right["velocity"].dims, times(-1e-3, 1e-3, 1e-3)(UP_DOWN(right["velocity"].values))),
        flow=(right["flow"].dims, times(30, -30)(right["flow"].values)),
        disparity=(right["disparity"].dims, rolled(1, 1)(-right["disparity"].values)),
    )
    assert named(detect_convention_mismatches(wrong, room)) == {
        ("depth", "metres"),
        ("velocity", "metres"),
        ("velocity", "sign_x"),
        ("velocity", "rows_upside_down"),
        ("flow", "per_second"),
        ("flow", "sign_y"),
        ("disparity", "sign"),
        ("disparity", "one_pixel"),
    }


def test_shift_is_told_with_its_direction(room: xr.Dataset) -> None:
    right = right_estimate(room, USUAL, seed=8)
    wrong = right.assign(depth=(right["depth"].dims, rolled(1, -1)(right["depth"].values)))
    (slip,) = detect_convention_mismatches(wrong, room)
    assert "1 px right and 1 px up" in slip.message


def test_part_of_an_image_and_a_truth_of_all_cameras(room: xr.Dataset) -> None:
    part = right_estimate(room, USUAL, seed=9).isel(t=[3], x=slice(10, 60), y=slice(5, 45))
    assert detect_convention_mismatches(part, room) == []
    wrong = part.assign(flow=-part["flow"])
    own = room.drop_dims("s")
    other = own.assign({name: np.nan * own[name] for name in VARIABLES})
    cameras = xr.concat([other, own], dim="s", data_vars="all").assign_coords(s=[-1, 0])
    assert named(detect_convention_mismatches(wrong, cameras)) == {("flow", "sign")}


def test_where_the_estimate_claims_nothing_no_slip_is_seen(room: xr.Dataset) -> None:
    right = right_estimate(room, USUAL, seed=10)
    wrong = right.assign(flow=-right["flow"], status_motion=0 * right["depth"].fillna(0).astype(np.uint8))
    assert detect_convention_mismatches(wrong, room) == []


@pytest.mark.parametrize("scene", range(7))
def test_right_estimates_have_no_slips(scenes: list[xr.Dataset], scene: int) -> None:
    truth = scenes[scene]
    # 203 by night, a twelfth of them by day.
    for seed in range(scene, 203, 7 if NIGHTLY else 84):
        assert detect_convention_mismatches(right_estimate(truth.isel(t=slice(1, 4)), poor(seed), seed), truth) == [], (
            seed
        )


@pytest.mark.parametrize("change", [UP_DOWN, MIRRORED, TURNED, TRANSPOSED, REVERSED, rolled(1, 0), halfway(0, 1)])
def test_on_a_frontal_plane_at_rest_places_say_nothing(still: xr.Dataset, change: Change) -> None:
    for errors in (USUAL, Errors(0, 0, 0, 0)):
        right = right_estimate(still, errors, seed=11)
        wrong = right.assign({name: (right[name].dims, change(right[name].values)) for name in VARIABLES})
        assert detect_convention_mismatches(wrong, still) == []


def test_signs_and_units_of_no_motion_say_nothing(still: xr.Dataset) -> None:
    right = right_estimate(still, USUAL, seed=12)
    for factor in (-1, 30, 1e-3):
        assert (
            detect_convention_mismatches(
                right.assign(flow=factor * right["flow"], velocity=factor * right["velocity"]), still
            )
            == []
        )


def test_shift_on_a_plane_of_constant_slope_may_be_an_offset() -> None:
    # Inverse depth is exactly affine on a plane: a shift of disparity is a constant there.
    truth = truth_of(PLANE)
    right = right_estimate(truth, Errors(0, 0, 0, 0), seed=13)
    wrong = right.assign(disparity=(right["disparity"].dims, rolled(1, 0)(right["disparity"].values)))
    assert detect_convention_mismatches(wrong, truth) == []


def test_nonsense_is_no_slip(room: xr.Dataset) -> None:
    rng = np.random.default_rng(14)
    right = right_estimate(room, USUAL, seed=14)
    for scale in (0.0, 1e-3, 1.0, 30.0):
        noise = {name: (right[name].dims, scale * rng.standard_normal(right[name].shape)) for name in VARIABLES}
        assert detect_convention_mismatches(right.assign(noise), room) == []


def test_scale_that_is_no_unit_is_no_slip(room: xr.Dataset) -> None:
    right = right_estimate(room, USUAL, seed=15)
    for factor in (0.7, 1.3, 2.5, 3.5, 5.5):
        assert (
            detect_convention_mismatches(right.assign({name: factor * right[name] for name in VARIABLES}), room) == []
        )


def test_arrays_that_no_estimate_may_hold(room: xr.Dataset) -> None:
    right = right_estimate(room, USUAL, seed=16)
    slips = detect_convention_mismatches(
        {"depth": -right["depth"].values, "disparity": -right["disparity"].values}, room
    )
    assert named(slips) == {("depth", "sign"), ("disparity", "sign")}
    frame = right.sel(t=0)
    assert named(detect_convention_mismatches({"flow": -frame["flow"].values}, room)) == {("flow", "sign")}
    assert named(detect_convention_mismatches({"depth": 0.001 * right["depth"].values[3:], "t": [1, 2]}, room)) == {
        ("depth", "metres")
    }


def test_arrays_that_do_not_fit_are_all_told(room: xr.Dataset) -> None:
    with pytest.raises(ScoreError) as caught:
        detect_convention_mismatches(
            {"depth": np.ones((3, 3)), "flow": np.ones((3, 5, 48, 64)), "disparity": np.ones((48, 64))}, room
        )
    assert [problem.path for problem in caught.value.problems] == ["depth", "flow"]
    with pytest.raises(ScoreError, match="at least one of"):
        detect_convention_mismatches({}, room)
    with pytest.raises(ScoreError, match="specify as many with t="):
        detect_convention_mismatches({"depth": np.ones((2, 48, 64))}, room)
    with pytest.raises(ScoreError, match=r"must be an xarray\.Dataset"):
        detect_convention_mismatches(None, room)  # type: ignore[arg-type]


def test_slips_show_in_what_make_estimate_derives(room: xr.Dataset) -> None:
    camera = read_intrinsics(room)
    recording = make_recording(
        np.zeros((5, 5, 48, 64)),
        focal_length_px=camera.focal_length_px,
        baseline_mm=camera.baseline_mm,
        frame_interval_s=camera.frame_interval_s,
    )
    right = right_estimate(room, Errors(outliers=0), seed=17)
    assert (
        detect_convention_mismatches(
            make_estimate(recording=recording, depth=right["depth"], velocity=right["velocity"]), room
        )
        == []
    )
    with pytest.warns(EstimateWarning, match="is depth in m"):
        metres = make_estimate(recording=recording, depth=0.001 * right["depth"])
    assert named(detect_convention_mismatches(metres, room)) == {("depth", "metres")}
    with pytest.warns(EstimateWarning, match="depth"):
        exchanged = make_estimate(recording=recording, disparity=right["depth"])
    assert named(detect_convention_mismatches(exchanged, room)) == {("disparity", "depth"), ("depth", "disparity")}


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 3e38, -3e38])
def test_estimates_that_know_nothing_or_diverged_have_no_slips(
    room: xr.Dataset, right: xr.Dataset, value: float
) -> None:
    everywhere = {name: xr.full_like(right[name], value) for name in VARIABLES}
    assert detect_convention_mismatches(right.assign(everywhere), room) == []
    thin = right.isel(y=slice(20, 21), x=slice(None, None, 3))
    assert detect_convention_mismatches(thin.assign(flow=xr.full_like(thin["flow"], value)), room) == []


def small_truth(width: int) -> xr.Dataset:
    """Return the truth of a surface with waves that approaches, of any size: 3 frames."""
    height = 3 * width // 4
    y, x = np.mgrid[:height, :width] / width
    depth = np.tile(500.0 + 40 * x + 9 * np.sin(11 * x + 3 * y) + 7 * np.cos(9 * y - 2 * x), (3, 1, 1))
    velocity = np.stack([0.1 + 0.2 * y + 0 * depth, 0.15 * x - 0.1 + 0 * depth, -0.6 - 0.2 * x * y + 0 * depth])
    x, y = x * width - width / 2, y * width - height / 2
    flow = np.stack([(700 * velocity[k] - place * velocity[2]) / depth for k, place in enumerate((x, y))])
    maps = {"depth": depth, "disparity": 3500 / depth, "velocity": velocity, "flow": flow, "mixed": depth < 0}
    camera = Intrinsics(focal_length_px=700.0, principal_point_px=(width / 2, height / 2), baseline_mm=5.0)
    return label("truth", maps, camera, t=[0, 1, 2])


def smooth(shape: tuple[int, ...], rng: np.random.Generator, sigma_px: float = 5.0) -> Map:
    """Return normal noise that is smooth over windows, the same in all frames."""
    found = ndimage.gaussian_filter(rng.standard_normal(shape[-2:]), sigma_px, mode="wrap")
    return np.broadcast_to(found / found.std(), shape)


@given(
    seed=some.integers(0, 100_000),
    width=some.integers(64, 200),
    factor=some.floats(1.5, 60.0),
    spread=some.floats(0.0, 0.6),
    share=some.floats(0.02, 1.0),
)
@settings(max_examples=400 if NIGHTLY else 3, deadline=None)
def test_velocities_from_wrong_depths_have_no_wrong_unit(
    seed: int, width: int, factor: float, spread: float, share: float
) -> None:
    """Velocities are proportional to depth, which false matches put at a multiple; few windows are valid."""
    rng, truth = np.random.default_rng(seed), small_truth(width)
    gain = factor * np.exp(spread * smooth(truth["depth"].shape, rng))
    arrays = {name: truth[name].values * gain for name in ("depth", "velocity")}
    arrays["velocity"] = arrays["velocity"] * np.exp(0.05 * rng.standard_normal(gain.shape))
    unknown = smooth(gain.shape, rng) < np.quantile(smooth(gain.shape, rng), 1 - share)
    for values in arrays.values():
        values[..., unknown] = np.nan
    assert detect_convention_mismatches(estimate_of(arrays, truth), truth) == []


@given(
    seed=some.integers(0, 100_000),
    width=some.integers(64, 200),
    factor=some.floats(1.0, 60.0),
    quantity=some.sampled_from(["flow", "velocity"]),
)
@settings(max_examples=400 if NIGHTLY else 3, deadline=None)
def test_errors_that_differ_between_windows_are_no_mismatch(
    seed: int, width: int, factor: float, quantity: str
) -> None:
    """A factor that varies by e^0.8 between windows is none of a unit, whatever its mean."""
    rng, truth = np.random.default_rng(seed), small_truth(width)
    gain = factor * np.exp(0.8 * smooth(truth["depth"].shape, rng))
    noise = factor * 0.3 * np.stack([smooth(gain.shape, rng) for _ in truth[quantity]])
    values = truth[quantity].values * gain + noise * np.abs(truth[quantity].values).mean()
    assert detect_convention_mismatches(estimate_of({quantity: values}, truth), truth) == []


PLANTED: list[tuple[str, str, Change]] = [
    ("depth", "sign", times(-1)),
    ("depth", "metres", times(1e-3)),
    ("disparity", "sign", times(-1)),
    ("disparity", "several_steps", times(3)),
    ("disparity", "columns_mirrored", MIRRORED),
    ("flow", "components_exchanged", YX),
    ("flow", "several_frames", times(4)),
    ("velocity", "sign_z", times(1, 1, -1)),
    ("velocity", "components_reversed", ZYX),
    ("velocity", "several_frames", times(9)),
]


@given(seed=some.integers(0, 100_000), width=some.integers(64, 200), planted=some.sampled_from(PLANTED))
@settings(max_examples=300 if NIGHTLY else 3, deadline=None)
def test_mismatches_of_small_images_are_named(seed: int, width: int, planted: tuple[str, str, Change]) -> None:
    """With errors of motion of 2 % that are smooth over windows, of depth of 0.02 %, and half of the pixels missing.

    Smooth errors of depth of 0.1 %, as those by a shift of half a pixel here, may be taken for one in such images.
    """
    rng, truth = np.random.default_rng(seed), small_truth(width)
    quantity, kind, change = planted
    values = truth[quantity].values
    size = np.abs(values).mean() * (0.02 if quantity in ("flow", "velocity") else 2e-4)
    noise = np.stack([smooth(values.shape[-3:], rng) for _ in range(values.size // truth["depth"].size)])
    wrong = change(values + size * noise.reshape(values.shape))
    wrong[..., smooth(values.shape[-3:], rng) < 0] = np.nan
    mismatches = detect_convention_mismatches(estimate_of({quantity: wrong}, truth), truth)
    assert named(mismatches) == {(quantity, kind)}


def test_a_single_window_is_no_evidence() -> None:
    truth = small_truth(96)
    values = -truth["velocity"].values * np.exp(0.02 * smooth(truth["depth"].shape, np.random.default_rng(3)))
    assert named(detect_convention_mismatches(estimate_of({"velocity": values}, truth), truth)) == {
        ("velocity", "sign")
    }
    values[..., :16, :], values[..., 31:, :], values[..., :16], values[..., 31:] = (np.nan,) * 4
    assert detect_convention_mismatches(estimate_of({"velocity": values}, truth), truth) == []


@nightly
@pytest.mark.parametrize("method", ["structure_tensor", "refined", "plane_sweep", "opencv_scene_flow"])
@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("width", [64, 80, 96, 128, 200])
def test_rendered_images_that_are_too_small_have_no_hint(method: str, scaled: bool, width: int) -> None:
    """The bundled cube, and with the camera of the large images a small part of it, whose depths are wrong."""
    overrides = {"camera.width": width, "camera.height": 3 * width // 4, "render.backend": "raycast"}
    if scaled:
        overrides["camera.focal_length_px"] = 5016 * width / 640
    for seed in (1, 2):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            made = st.simulate(SCENES / "cube.yaml", overrides=overrides | {"seed": seed})
            found = st.estimate(made.recording, method)
        assert detect_convention_mismatches(found, made.truth) == []


CAMERA = Intrinsics(focal_length_px=100.0, principal_point_px=(31.5, 23.5), baseline_mm=5.0)


def waves(right: float = 0.0, down: float = 0.0) -> np.ndarray:
    """Return the depth of a surface with waves, its map shifted."""
    y, x = np.mgrid[:48, :64].astype(np.float64)
    y, x = y - down, x - right
    depth = 300 + 9 * np.sin(0.21 * x + 0.05 * y) + 7 * np.cos(0.17 * y - 0.04 * x) + 4 * np.sin(0.005 * x * y)
    return np.asarray(depth[np.newaxis])


def material_of(depth: np.ndarray) -> MismatchSamples:
    true = waves()
    still = np.zeros((3, *true.shape))
    maps = {"depth": true, "disparity": 500 / true, "velocity": still, "flow": still[:2], "mixed": true < 0}
    truth = label("truth", maps, CAMERA, t=[0])
    estimate: xr.Dataset = label("estimate", {"depth": depth}, CAMERA, t=[0])
    (material,) = read_mismatch_samples(estimate, truth)
    return material


@pytest.mark.parametrize("right", [-1.0, -0.5, 0.0, 0.5, 1.0])
@pytest.mark.parametrize("down", [-1.0, -0.5, 0.0, 0.5, 1.0])
def test_half_and_whole_pixels_are_told_with_their_signs(right: float, down: float) -> None:
    rng = np.random.default_rng(1)
    # Besides, what is no shift: an offset, a gain, noise and outliers.
    found = 1.01 * waves(right, down) - 2 + 0.3 * rng.standard_normal((1, 48, 64))
    found[rng.random(found.shape) < 0.05] += 40
    fit = fit_shift(material_of(found), NO_MISMATCH)
    assert fit is not None
    assert fit.is_slip == bool(right or down)
    if fit.is_slip:
        assert (fit.right, fit.down) == (right, down)


@pytest.mark.parametrize("length", [0.2, -0.25, 0.3, 0.7, -0.75, 1.3, 1.5, -2.0])
def test_other_shifts_are_not_called_half_or_whole(length: float) -> None:
    rng = np.random.default_rng(2)
    for right, down in ((length, 0.0), (0.0, length), (0.5, length)):
        found = waves(right, down) + 0.3 * rng.standard_normal((1, 48, 64))
        fit = fit_shift(material_of(found), NO_MISMATCH)
        assert fit is None or not fit.is_slip


def test_noise_that_hides_a_shift_leaves_nothing_to_say() -> None:
    rng = np.random.default_rng(3)
    found = waves(1.0, 0.0) + 60 * rng.standard_normal((1, 48, 64))
    fit = fit_shift(material_of(found), NO_MISMATCH)
    assert fit is None or not fit.is_slip
