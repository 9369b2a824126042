"""Checks of inputs that a method must accept, or reject with an error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

from scenetruth.errors import ScenetruthError
from scenetruth.estimators import estimate
from scenetruth.estimators.estimation import output_problems
from scenetruth.testing.conformance.bench import ConformanceBench, conformance_check
from scenetruth.testing.conformance.map_comparison import (
    CheckFailure,
    NotApplicable,
    require_equal_to_rounding,
    require_median_near,
    scalar_maps,
)

__all__ = []


_IMAGE_TYPE_FACTOR = 1.0
"""The quantisation to 16 bits is far below the error of any method."""


@conformance_check()
def check_image_types(bench: ConformanceBench) -> None:
    """The same images as float32, float64 and 16-bit digital numbers give the same estimate."""
    for dtype, full_scale in ((np.float64, 1.0), (np.uint16, 65535.0)):
        found = bench.estimate(bench.plane.recording(dtype=dtype, full_scale=full_scale))
        bench.agrees(
            scalar_maps(found),
            done=f"the images were given as {np.dtype(dtype).name} with full_scale {full_scale:g} instead of float32",
            expectation="the same estimate within the method's own error",
            remedy="convert images first: recording['image'].values.astype(float) / recording.attrs['full_scale']; "
            "differences of unsigned integers overflow",
            factor=_IMAGE_TYPE_FACTOR,
        )


_MASK_SIDE_PX = 4
_MASK_MARGIN_PX = 10
"""At smaller distances, windows of default size contain masked pixels."""


@conformance_check(plain=False)
def check_exclusion_mask(bench: ConformanceBench) -> None:
    """Pixels of the recording's exclusion mask are ignored: their values do not affect the surrounding estimate."""
    if not bench.method.needs.exclusion_mask:
        msg = "the method refuses recordings with a mask: it has no Needs(exclusion_mask=True)"
        raise NotApplicable(msg)
    images = bench.plane.images()
    height, width = bench.plane.size
    row, column = (height - _MASK_SIDE_PX) // 2, (width - _MASK_SIDE_PX) // 2
    square = (slice(row, row + _MASK_SIDE_PX), slice(column, column + _MASK_SIDE_PX))
    mask = np.zeros((height, width), dtype=bool)
    mask[square] = True
    pattern = np.indices((_MASK_SIDE_PX, _MASK_SIDE_PX)).sum(axis=0) % 2
    images[(slice(None), slice(None), *square)] = pattern if images.ndim == 4 else pattern[..., None]
    found = bench.estimate(bench.plane.recording(images, exclusion_mask=mask))
    around = np.zeros((height, width), dtype=bool)
    around[
        row - _MASK_MARGIN_PX : row + _MASK_SIDE_PX + _MASK_MARGIN_PX,
        column - _MASK_MARGIN_PX : column + _MASK_SIDE_PX + _MASK_MARGIN_PX,
    ] = True
    ring = xr.DataArray(around & ~mask, {"y": np.arange(height), "x": np.arange(width)}, ("y", "x"))
    bench.agrees(
        scalar_maps(found),
        {name: item.where(ring) for name, item in bench.maps.items()},
        done=f"a square of {_MASK_SIDE_PX} px in the middle of all images was masked and held a chequerboard",
        expectation=f"the same estimate up to {_MASK_MARGIN_PX} px around it, within three times the method's error",
        remedy="give masked pixels no weight, or remove exclusion_mask=True from `needs` to reject such recordings",
    )


@conformance_check()
def check_memory_layout(bench: ConformanceBench) -> None:
    """The estimate does not depend on the memory layout of the images: column-major, or a view of a larger array."""
    for layout in ("by columns first (Fortran order)", "every second value of a larger array", "backwards"):
        recording = bench.recording()
        values = recording["image"].values
        if "columns" in layout:
            laid = np.asfortranarray(values)
        elif "second" in layout:
            larger = np.full(tuple(2 * size for size in values.shape), np.nan, dtype=values.dtype)
            laid = larger[tuple(slice(None, None, 2) for _ in values.shape)]
            laid[...] = values
        else:
            laid = np.ascontiguousarray(np.flip(values))
            laid = np.flip(laid)
        recording = recording.assign(image=(recording["image"].dims, laid, recording["image"].attrs))
        require_equal_to_rounding(
            scalar_maps(bench.estimate(recording)),
            scalar_maps(bench.plain),
            done=f"the memory layout of the images was: {layout}",
            expectation="the same estimate up to rounding",
            remedy="use np.ascontiguousarray(...) for code that requires it; never reshape by strides",
        )


_NON_FINITE_MARGIN_PX = 24
"""At larger distances, windows of default size do not contain the pixel."""
_NON_FINITE_WORDS = ("finite", "nan", "missing", "exclusion_mask", "not a number")
_NON_FINITE_REMEDY = (
    "raise EstimateError([Problem('image', 'holds values that are not finite')]) for non-finite images, or ignore "
    "such pixels"
)


@conformance_check()
def check_non_finite(bench: ConformanceBench) -> None:
    """A NaN pixel is rejected with an explicit error, or leaves the rest of the estimate unchanged."""
    images = bench.plane.images()
    height, width = bench.plane.size
    row, column = height // 8, width // 8
    images[(images.shape[0] - 1) // 2, (images.shape[1] - 1) // 2, row, column] = np.nan
    done = f"the pixel (x, y) = ({column}, {row}) of the reference image was NaN"
    try:
        found = bench.estimate(bench.plane.recording(images))
    except ScenetruthError as error:
        if any(word in str(error).lower() for word in _NON_FINITE_WORDS):
            return
        text = " ".join(str(error).split())
        raise CheckFailure(
            done, "an explicit error, or an estimate", f"another error: {text}", _NON_FINITE_REMEDY
        ) from error
    away = {
        name: item.where(
            (abs(item["x"] - column) > _NON_FINITE_MARGIN_PX) | (abs(item["y"] - row) > _NON_FINITE_MARGIN_PX)
        )
        for name, item in bench.maps.items()
    }
    bench.agrees(
        scalar_maps(found),
        away,
        done=done,
        expectation=f"the same estimate more than {_NON_FINITE_MARGIN_PX} px away, or an explicit error",
        remedy=_NON_FINITE_REMEDY,
    )


@conformance_check(any_of=("depth", "disparity", "flow_x"), cameras=2)
def check_camera_subset(bench: ConformanceBench) -> None:
    """Cameras on one side of the reference only, identified by `s` and `stage_x_mm`, give the correct depth."""
    count = max(2, bench.method.needs.cameras)
    plane = replace(bench.plane, cameras=2 * count - 1)
    recording = plane.recording()
    for side, part in (("right", slice(0, None)), ("left", slice(None, 0))):
        found = bench.estimate_if_it_suits(recording.sel(s=part))
        steps = recording["s"].sel(s=part).values.tolist()
        require_median_near(
            scalar_maps(found),
            plane.truth(),
            ("depth", "disparity", "flow_x", "flow_y"),
            done=f"only the reference and cameras to its {side} were given, s = {steps}",
            remedy="select the reference with recording.sel(s=0), and read camera positions from stage_x_mm, not from "
            "array indices",
        )


@conformance_check()
def check_frame_subset(bench: ConformanceBench) -> None:
    """Frames from the reference on, identified by `t`, are estimated correctly, and only these."""
    count = max(2, bench.method.needs.frames)
    plane = replace(bench.plane, frames=2 * count - 1)
    recording = plane.recording().sel(t=slice(0, None))
    found = bench.estimate_if_it_suits(recording)
    done = f"only the frames t = {recording['t'].values.tolist()} were given"
    remedy = "read frame numbers from recording['t'], and pass the estimated frames as t= to scenetruth.make_estimate"
    others = sorted(set(found["t"].values.tolist()) - set(recording["t"].values.tolist()))
    if others:
        raise CheckFailure(done, "estimates of these frames", f"estimates of the frames {others} in addition", remedy)
    require_median_near(
        scalar_maps(found),
        plane.truth(),
        ("depth", "disparity", "flow_x", "flow_y"),
        done=done,
        remedy=remedy,
    )


@conformance_check()
def check_read_only_input(bench: ConformanceBench) -> None:
    """Read-only images, as passed by `scenetruth.estimate`, give the same estimate."""
    if output_problems(bench.plain, bench.recording(), bench.method.gives):
        msg = "scenetruth.estimate rejects the result of the method: see 'output_schema' and 'declared_outputs'"
        raise NotApplicable(msg)
    found = estimate(bench.recording(), bench.method, bench.settings)
    require_equal_to_rounding(
        scalar_maps(found),
        scalar_maps(bench.plain),
        done="scenetruth.estimate was called, which makes the recording's arrays read-only",
        expectation="the same estimate as with writable arrays",
        remedy="work on copies, even if arrays are writable",
    )


@conformance_check()
def check_single_camera(bench: ConformanceBench) -> None:
    """A single camera is rejected with a scenetruth error, or gives the correct motion."""
    plane = replace(bench.plane, cameras=1)
    recording = plane.recording()
    found = bench.estimate_if_it_suits(recording)
    done = "only the reference camera of the plain recording was estimated"
    remedy = "declare Needs(cameras=2) if depth requires two; otherwise return motion only, with depth NaN"
    wrong = [str(problem) for problem in output_problems(found, recording, bench.method.gives)]
    if wrong:
        raise CheckFailure(done, "an error of scenetruth.errors, or a valid estimate", "; ".join(wrong), remedy)
    require_median_near(scalar_maps(found), plane.truth(), ("flow_x", "flow_y"), done=done, remedy=remedy)


@conformance_check()
def check_single_frame(bench: ConformanceBench) -> None:
    """A single frame is rejected with a scenetruth error, or gives the correct depth."""
    plane = replace(bench.plane, frames=1)
    recording = plane.recording()
    found = bench.estimate_if_it_suits(recording)
    done = "only the reference frame of the plain recording was estimated"
    remedy = "declare Needs(frames=2) if the method requires two; otherwise return depth only, with motion NaN"
    wrong = [str(problem) for problem in output_problems(found, recording, bench.method.gives)]
    if wrong:
        raise CheckFailure(done, "an error of scenetruth.errors, or a valid estimate", "; ".join(wrong), remedy)
    require_median_near(scalar_maps(found), plane.truth(), ("depth", "disparity"), done=done, remedy=remedy)
