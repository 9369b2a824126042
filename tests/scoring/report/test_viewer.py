"""The page holds the maps of the data sets, within the rounding that it states."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import STATUS_FALLBACK, STATUS_VALID, label, make_recording, read_intrinsics
from scenetruth.scoring import score, write_report
from scenetruth.scoring.report import (
    RELATIVE_ROUNDING,
    PackedMap,
    Viewer,
    build_viewer,
    pack_viewer_images,
    unpack_map,
)
from tests.helpers.synthetic_case import Case, make_case, make_growing_case, with_error_bars

Map = NDArray[np.float64]


def unpacked(viewer: Viewer, number: int) -> Map:
    one = viewer.plain["maps"][number]
    shape = (one["height"], one["width"])
    data = base64.b64decode(one["data"])
    return unpack_map(PackedMap(shape, one["low"], one["step"], one["predictor"], one["exact"], data))


def group(viewer: Viewer, name: str) -> Any:
    return next(one for one in viewer.plain["groups"] if one["name"] == name)


def shown(viewer: Viewer, name: str, what: str, t: int = 0) -> Map:
    """Return a map as the page's script puts it together."""
    maps = group(viewer, name)["maps"][str(t)]
    if what in maps:
        return unpacked(viewer, maps[what])
    assert what == "estimate"
    values = unpacked(viewer, maps["truth"]) + unpacked(viewer, maps["error"])
    return np.asarray(np.where(np.isnan(values), unpacked(viewer, maps["rest"]), values)) if "rest" in maps else values


@pytest.fixture(scope="module")
def viewer(full_case: Case) -> Viewer:
    case = full_case
    return build_viewer(case.recording, case.estimate, case.truth, score(case.estimate, case.truth))


@pytest.mark.parametrize(("name", "variable", "component"), [("depth", "depth", None), ("velocity_z", "velocity", 2)])
def test_maps_are_those_of_the_data_sets(
    viewer: Viewer, full_case: Case, name: str, variable: str, component: int | None
) -> None:
    def read(dataset: xr.Dataset, key: str) -> Map:
        values = dataset[key] if component is None else dataset[key][component]
        return np.asarray(values.values[0], dtype=np.float64)

    estimate, truth = full_case.estimate, full_case.truth
    known = estimate["status_disparity"].values[0] == STATUS_VALID
    known &= (estimate["status_motion"].values[0] == STATUS_VALID) | (component is None)
    expected = {
        "estimate": np.where(known, read(estimate, variable), np.nan),
        "truth": read(truth, variable),
        "std": np.where(known, read(estimate, f"{variable}_std"), np.nan),
    }
    expected["error"] = expected["estimate"] - expected["truth"]
    limits = group(viewer, name)["limits"]
    for what, values in expected.items():
        low, high = limits[what if what in limits else "value"]
        rounding = RELATIVE_ROUNDING * (high - low)
        if what == "estimate":
            rounding += RELATIVE_ROUNDING * (limits["error"][1] - limits["error"][0])
        # Beside it, only float64 rounds.
        np.testing.assert_allclose(shown(viewer, name, what), values, rtol=1e-14, atol=rounding * (1 + 1e-9))
    assert f"{100 * RELATIVE_ROUNDING:.4f} %" in viewer.notes[0]
    assert RELATIVE_ROUNDING <= 1e-4


def test_all_that_both_data_sets_hold_is_there(viewer: Viewer) -> None:
    names = [one["name"] for one in viewer.plain["groups"]]
    assert names[:7] == ["depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x", "flow_y"]
    assert {"velocity_epe", "flow_endpoint", "estimate.coherence", "estimate.status_motion"} <= {*names}
    assert group(viewer, "velocity_epe")["length_of"] == ("velocity_x", "velocity_y", "velocity_z")
    codes = {"0": "invalid", "1": "normal component only", "2": "valid", "3": "fallback"}
    assert group(viewer, "estimate.status_motion")["codes"] == codes
    assert [one["name"] for one in viewer.plain["regions"]] == ["interior", "edges"]
    json.dumps(viewer.plain, allow_nan=False)


def test_images_of_other_cameras_and_frames_are_there(viewer: Viewer, full_case: Case) -> None:
    images = viewer.plain["images"]
    assert images["cameras"] == [(0, -1), (0, 0), (0, 1)]
    assert images["frames"] == [-1, 0, 1]
    places = {(one["camera"], one["frame"]) for one in images["shown"]}
    assert places == {(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)}
    for one in images["shown"]:
        whole = full_case.recording["image"].sel(s=one["camera"], t=one["frame"]).values
        np.testing.assert_array_equal(unpacked(viewer, one["map"]), whole[:: one["step"], :: one["step"]])


def test_images_are_thinned_and_left_out_where_there_is_no_room(full_case: Case) -> None:
    recording, estimate = full_case.recording, full_case.estimate
    every = pack_viewer_images(recording, estimate, 0, 1, 1_000_000)
    assert [one.step for one in every.shown] == [1] * 5
    size = every.shown[0].packed.size
    some = pack_viewer_images(recording, estimate, 0, 1, int(1.3 * size))
    assert [one.step for one in some.shown] == [1, 2, 2, 2, 2]
    few = pack_viewer_images(recording, estimate, 0, 1, size // 8)
    assert few.shown[0].step == 1
    assert few.left_out == 4 - (len(few.shown) - 1)
    assert few.left_out > 0
    assert sum(one.packed.size for one in few.shown[1:]) <= 1.2 * (size // 8) + size


def test_large_images_and_many_maps_are_thinned_and_the_page_says_so(full_case: Case) -> None:
    case = full_case
    result = score(case.estimate, case.truth)
    whole = build_viewer(case.recording, case.estimate, case.truth, result)
    sizes = sum(len(one["data"]) for one in whole.plain["maps"])
    less = build_viewer(case.recording, case.estimate, case.truth, result, most_characters=sizes // 3)
    assert sum(len(one["data"]) for one in less.plain["maps"]) < 0.7 * sizes
    assert group(less, "depth")["maps"]["0"]["step"] > 1
    assert any("every second row and column is shown of: Depth" in note for note in less.notes)
    step = group(less, "depth")["maps"]["0"]["step"]
    truth = case.truth["depth"].values[0, ::step, ::step]
    atol = RELATIVE_ROUNDING * np.diff(group(less, "depth")["limits"]["value"])[0]
    np.testing.assert_allclose(shown(less, "depth", "truth"), truth, rtol=1e-14, atol=atol)
    pixels = case.estimate.sizes["x"] * case.estimate.sizes["y"]
    thin = build_viewer(
        case.recording, case.estimate, case.truth, result, most_pixels=pixels // 4, most_characters=sizes // 3
    )
    assert (thin.plain["width"], thin.plain["height"]) == (80, 60)
    assert thin.plain["x"][:3] == [0, 2, 4]
    assert any("every second row and column of the images" in note for note in thin.notes)


def test_frames_beside_the_reference_frame_are_there() -> None:
    case = with_error_bars(make_case(48, 36, 380.0, frames=(-1, 0, 1)))
    viewer = build_viewer(case.recording, case.estimate, case.truth, score(case.estimate, case.truth))
    assert viewer.frame == 0
    for n, t in enumerate((-1, 0, 1)):
        truth = case.truth["depth"].values[n]
        np.testing.assert_allclose(shown(viewer, "depth", "truth", t), truth, atol=5e-3)
    # Nothing is shown where no frame is left.
    assert set(group(viewer, "depth")["maps"]) == {"-1", "0", "1"}


def test_the_worst_place_is_where_errors_were_put(full_case: Case) -> None:
    wrong = full_case.estimate.copy(deep=True)
    wrong["depth"][0, 70:90, 40:60] += 5.0
    viewer = build_viewer(full_case.recording, wrong, full_case.truth, score(wrong, full_case.truth))
    place = viewer.worst["depth"]
    errors = wrong["depth"].values[0] - full_case.truth["depth"].values[0]
    errors[wrong["status_disparity"].values[0] != STATUS_VALID] = np.nan
    # The squares of 32 px begin at the corner; most of what was put in is in one of them.
    square = errors[64:96, 32:64]
    assert place.rmse == pytest.approx(np.sqrt(np.nanmean(square**2)), rel=1e-12)
    assert place.side_px == 32
    row, column = np.unravel_index(np.nanargmax(np.abs(square)), square.shape)
    assert (place.x, place.y) == (float(32 + column), float(64 + row))


def test_growth_of_windows_is_shown_where_something_grows() -> None:
    case = make_growing_case(48, 36, 380.0, velocity_noise=1e-4)
    result = score(case.estimate, case.truth, case.recording, settings={"growth_window_px": 6, "interior_margin_px": 3})
    viewer = build_viewer(case.recording, case.estimate, case.truth, result)
    windowed = group(viewer, "growth_rate_windowed")
    assert set(windowed["maps"]["0"]) >= {"truth", "error"}
    assert windowed["units"] == "%/h"
    assert "truth" in group(viewer, "growth_rate")["maps"]["0"]
    # The scale lets the truth be seen.
    assert windowed["limits"]["value"][1] <= 2 * 3.01


def test_without_truth_there_are_estimates_alone(full_case: Case) -> None:
    viewer = build_viewer(full_case.recording, full_case.estimate, None, None)
    kinds = {what for one in viewer.plain["groups"] for maps in one["maps"].values() for what in maps}
    assert kinds == {"step", "estimate", "std", "value"}
    assert viewer.plain["regions"] == []
    assert not viewer.worst


def test_a_part_of_the_image_keeps_its_coordinates(full_case: Case) -> None:
    x, y = slice(20, 120, 2), slice(10, 90, 2)
    estimate = full_case.estimate.isel(x=x, y=y)
    viewer = build_viewer(full_case.recording, estimate, full_case.truth, score(estimate, full_case.truth))
    assert viewer.plain["x"][:2] == [20, 22]
    assert viewer.plain["y"][-1] == 88
    np.testing.assert_allclose(
        shown(viewer, "depth", "truth"), full_case.truth["depth"].isel(t=0, x=x, y=y).values, atol=5e-3
    )


def test_estimates_that_know_nothing_have_a_page(tmp_path: Path) -> None:
    images = np.random.default_rng(1).random((3, 1, 12, 16))
    recording = make_recording(images, focal_length_px=100.0, baseline_mm=5.0)
    disparity = np.full((1, 12, 16), np.nan)
    estimate = label("estimate", {"disparity": disparity}, read_intrinsics(recording), t=[0])
    page = write_report(estimate, recording=recording, output=tmp_path, figures=("image",))
    assert "viewer-data" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("include", [False, True])
def test_fallback_values_are_maps_of_their_own(full_case: Case, include: bool) -> None:
    """They can be shown on request; display ranges and the largest errors are those of valid pixels."""
    status = full_case.estimate["status_disparity"].values.copy()
    coarse = status == STATUS_VALID
    coarse[..., 40:] = False
    status[coarse] = STATUS_FALLBACK
    depth = full_case.estimate["depth"].where(~coarse, full_case.estimate["depth"] + 50.0)
    velocity = full_case.estimate["velocity"].where(xr.DataArray(~coarse, dims=("t", "y", "x")))
    estimate = full_case.estimate.assign(status_disparity=(("t", "y", "x"), status), depth=depth, velocity=velocity)
    chosen = score(estimate, full_case.truth, settings={"include_fallback": include})
    viewer = build_viewer(full_case.recording, estimate, full_case.truth, chosen)
    maps = group(viewer, "depth")["maps"]["0"]
    assert ("fallback_estimate" in maps) == (not include)
    assert not any(name.startswith("fallback") for name in group(viewer, "velocity_z")["maps"]["0"])
    where = coarse[0]
    if include:
        assert np.isfinite(shown(viewer, "depth", "estimate")[where]).all()
        assert viewer.worst["depth"].rmse > 40
        return
    assert np.isnan(shown(viewer, "depth", "estimate")[where]).all()
    assert viewer.worst["depth"].rmse < 10
    limits = group(viewer, "depth")["limits"]
    assert limits["error"][1] < 10
    exact = full_case.truth["depth"].values[0]
    for what, values in (
        ("estimate", depth.values[0]),
        ("error", depth.values[0] - exact),
        ("std", estimate["depth_std"].values[0]),
    ):
        found = unpacked(viewer, maps[f"fallback_{what}"])
        assert (np.isfinite(found) == where).all()
        low, high = limits[what if what in limits else "value"]
        assert np.abs(found - values)[where].max() <= RELATIVE_ROUNDING * (high - low) + 1e-9
