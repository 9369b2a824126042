"""What may be compared, and what is said about the rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

from scenetruth.errors import ScoreError
from scenetruth.scoring.alignment import align, check_recording
from scenetruth.scoring.regions import edge_distance
from tests.scoring.synthetic import Case, make_case


def with_attrs(dataset: xr.Dataset, **attrs: object) -> xr.Dataset:
    return dataset.assign_attrs(attrs)


def with_cameras(truth: xr.Dataset, *cameras: int) -> xr.Dataset:
    """Return a truth of several cameras; that of s has depths larger by s."""
    return xr.concat([truth.assign(depth=truth["depth"] + s) for s in cameras], dim="s").assign_coords(s=list(cameras))


def test_truth_of_more_frames_is_cut_to_the_estimate() -> None:
    long = make_case(40, 30, 320.0, frames=(-2, -1, 0, 1, 2))
    short = long.estimate.sel(t=[1, -1])
    _, truth = align(short, long.truth)
    assert truth["t"].values.tolist() == [1, -1]
    np.testing.assert_array_equal(truth["depth"], long.truth["depth"].values[[3, 1]])


def test_reference_camera_is_taken_from_a_truth_of_all(case: Case) -> None:
    truth = with_cameras(case.truth, -1, 0, 1).transpose("component", "image_component", "s", ...)
    _, reference = align(case.estimate, truth)
    np.testing.assert_array_equal(reference["depth"], case.truth["depth"])


@pytest.mark.parametrize(
    ("break_it", "message"),
    [
        (
            lambda c: (c.estimate, c.truth.assign_coords(t=[3])),
            r"t: the truth lacks frames of the estimate \(got \[0\]\)",
        ),
        (
            lambda c: (c.estimate.isel(x=slice(50)), c.truth.drop_vars("x")),
            "truth.x: has the size 160, the estimate 50; to compare a part of the image, both must have the coordinate",
        ),
        (
            lambda c: (c.estimate, c.truth.isel(y=slice(9))),
            r"truth\.y: lacks pixel rows of the estimate; both must be counted .* \(got \[9, 10,",
        ),
        (
            lambda c: (c.estimate.assign_coords(x=c.estimate.x + 1), c.truth),
            r"truth\.x: lacks pixel columns of the estimate; .* \(got \[160\]\)",
        ),
        (
            lambda c: (c.estimate, c.truth.assign_coords(x=c.truth.x // 2)),
            r"truth\.x: must be unique; pixel columns are duplicated",
        ),
        (
            lambda c: (with_attrs(c.estimate, focal_length_px=1251.0), c.truth),
            "focal_length_px: the estimate's 1251.0 differs from the truth's 1250.0",
        ),
        (
            lambda c: (c.estimate, with_attrs(c.truth, baseline_mm=-5.0)),
            "attrs.baseline_mm: the estimate's 5.0 differs",
        ),
        (lambda c: (with_attrs(c.estimate, principal_point_px=[79.5, 60.0]), c.truth), "attrs.principal_point_px"),
        (lambda c: (with_attrs(c.estimate, frame_interval_s=2.0), c.truth), "attrs.frame_interval_s"),
        (
            lambda c: (c.estimate[["status", "coherence"]], c.truth),
            "estimate.variables: hold neither depth, velocity, disparity nor flow; at least one is required",
        ),
        (lambda c: (c.estimate, c.truth.drop_vars("mixed")), "truth.mixed: is missing"),
        (lambda c: (c.estimate.drop_vars("t"), c.truth), "estimate.t: must be a coordinate"),
        (
            lambda c: (c.estimate, with_cameras(c.truth, 1, 2)),
            "truth.s: must hold the reference camera s = 0 exactly once",
        ),
        (lambda c: (with_cameras(c.estimate, 0, 1), c.truth), "estimate.s: must not be a dimension"),
    ],
)
def test_what_does_not_belong_together_is_named(
    case: Case, break_it: Callable[[Case], tuple[xr.Dataset, xr.Dataset]], message: str
) -> None:
    with pytest.raises(ScoreError, match=message):
        align(*break_it(case))


def test_all_problems_are_listed_at_once(case: Case) -> None:
    other = with_attrs(case.estimate.assign_coords(t=[7]), focal_length_px=1.0)
    with pytest.raises(ScoreError) as caught:
        align(other, case.truth.isel(x=slice(50)))
    assert [problem.path for problem in caught.value.problems] == ["t", "truth.x", "attrs.focal_length_px"]
    with pytest.raises(ScoreError, match="2 problems") as caught:
        align(case.estimate[["status"]], case.truth.drop_vars("flow"))
    assert [problem.path for problem in caught.value.problems] == ["estimate.variables", "truth.flow"]


def test_rounding_of_intrinsics_is_forgiven(case: Case) -> None:
    align(with_attrs(case.estimate, focal_length_px=float(np.float32(1250.0) * np.float32(1 + 1e-7))), case.truth)


def test_recording_must_have_the_form_and_the_pixels_of_the_estimate(case: Case) -> None:
    check_recording(case.recording, case.estimate)
    check_recording(case.recording, case.estimate.isel(x=slice(9, 12)))
    with pytest.raises(ScoreError, match=r"recording\.x: lacks pixel columns of the estimate"):
        check_recording(case.recording.isel(x=slice(9)), case.estimate)
    with pytest.raises(ScoreError, match=r"recording\.x: has the size 9, the estimate 160"):
        check_recording(case.recording.isel(x=slice(9)).drop_vars("x"), case.estimate)
    with pytest.raises(ScoreError, match=r"recording\.image: is missing"):
        check_recording(case.truth, case.estimate)
    with pytest.raises(ScoreError, match=r"recording\.s: must hold the reference camera s = 0 exactly once"):
        check_recording(case.recording.drop_vars("s"), case.estimate)


def test_pixels_are_matched_by_their_coordinates(case: Case) -> None:
    part = case.estimate.isel(y=slice(100, 20, -2), x=[7, 90, 91])
    _, truth = align(part, case.truth)
    np.testing.assert_array_equal(truth["depth"], case.truth["depth"].values[:, 100:20:-2][..., [7, 90, 91]])
    assert truth["x"].values.tolist() == [7, 90, 91]


def test_distances_to_edges_are_those_of_the_whole_image(case: Case) -> None:
    distance = edge_distance(case.truth["mixed"].values)
    part = case.estimate.isel(x=slice(20, 40), y=slice(30, 60, 3))
    expected = distance[:, 30:60:3, 20:40]
    assert not case.truth["mixed"].values[:, 30:60:3, 20:40].any()
    np.testing.assert_array_equal(align(part, case.truth)[1]["boundary_distance"], expected)
    # Of a part of a truth, the distances that came with it are right.
    told = case.truth.assign(boundary_distance=(case.truth["mixed"].dims, distance)).isel(x=slice(10, 50))
    np.testing.assert_array_equal(align(part, told)[1]["boundary_distance"], expected)


def test_without_coordinates_pixels_are_matched_by_their_place(case: Case) -> None:
    bare = case.estimate.drop_vars(["x", "y"])
    np.testing.assert_array_equal(align(bare, case.truth)[1]["depth"], case.truth["depth"])
