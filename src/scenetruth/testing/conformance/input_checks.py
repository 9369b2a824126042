"""Checks of inputs that a method must accept, or refuse with an error."""

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
"""Quantisation to 16 bits is far below any method's own error."""


@conformance_check()
def check_image_types(bench: ConformanceBench) -> None:
    """The same images as float32, float64 and digital numbers of 16 bits give the same estimate."""
    for dtype, full_scale in ((np.float64, 1.0), (np.uint16, 65535.0)):
        found = bench.estimate(bench.plane.recording(dtype=dtype, full_scale=full_scale))
        bench.agrees(
            scalar_maps(found),
            done=f"the images were given as {np.dtype(dtype).name} with full_scale {full_scale:g} instead of float32",
            expectation="the same estimate within the method's own error",
            remedy="convert images first: recording['image'].values.astype(float) / recording.attrs['full_scale']; "
            "differences of unsigned integers wrap around",
            factor=_IMAGE_TYPE_FACTOR,
        )


_MASK_SIDE_PX = 4
_MASK_MARGIN_PX = 10
"""Closer than this, windows of usual size hold marked pixels."""


@conformance_check(plain=False)
def check_exclusion_mask(bench: ConformanceBench) -> None:
    """Pixels that the recording's mask marks are left out: what they hold does not spoil those around them."""
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
    found = bench.estimate(bench.plane.recording(images, mask=mask))
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
        remedy="give masked pixels no weight, or take exclusion_mask=True from `needs`, which refuses such recordings",
    )


@conformance_check()
def check_memory_layout(bench: ConformanceBench) -> None:
    """Images give the same estimate however they lie in memory: by columns first, or as part of a larger array."""
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
            done=f"the images lay in memory {layout}",
            expectation="the same estimate but for rounding",
            remedy="take np.ascontiguousarray(...) of images before code that needs them so; never reshape by strides",
        )


_NON_FINITE_MARGIN_PX = 24
"""Further away, windows of usual size do not hold the pixel."""
_NON_FINITE_WORDS = ("finite", "nan", "missing", "exclusion_mask", "not a number")
_NON_FINITE_REMEDY = (
    "raise EstimateError([Problem('image', 'holds values that are not finite')]) where images are not finite, or leave "
    "such pixels out"
)


@conformance_check()
def check_non_finite(bench: ConformanceBench) -> None:
    """One NaN pixel is refused by an error that says so, or leaves the rest of the estimate as it was."""
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
        told = " ".join(str(error).split())
        raise CheckFailure(
            done, "an error that says so, or an estimate", f"another error: {told}", _NON_FINITE_REMEDY
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
        expectation=f"the same estimate more than {_NON_FINITE_MARGIN_PX} px away, or an error that says so",
        remedy=_NON_FINITE_REMEDY,
    )


@conformance_check(any_of=("depth", "disparity", "flow_x"), cameras=2)
def check_camera_subset(bench: ConformanceBench) -> None:
    """Cameras on one side of the reference only, told apart by `s` and `stage_x_mm`, give depth that is right."""
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
            done=f"only the reference and cameras to its {side} were there, s = {steps}",
            remedy="find the reference by recording.sel(s=0), and where cameras stand in stage_x_mm, not by their "
            "place in the array",
        )


@conformance_check()
def check_frame_subset(bench: ConformanceBench) -> None:
    """Frames from the reference on, told by `t`, are estimated as such: no others are told, and they are right."""
    count = max(2, bench.method.needs.frames)
    plane = replace(bench.plane, frames=2 * count - 1)
    recording = plane.recording().sel(t=slice(0, None))
    found = bench.estimate_if_it_suits(recording)
    done = f"only the frames t = {recording['t'].values.tolist()} were there"
    remedy = "take frame numbers from recording['t'], and say by t= of scenetruth.make_estimate which are estimated"
    others = sorted(set(found["t"].values.tolist()) - set(recording["t"].values.tolist()))
    if others:
        raise CheckFailure(done, "estimates of these frames", f"estimates of the frames {others} too", remedy)
    require_median_near(
        scalar_maps(found),
        plane.truth(),
        ("depth", "disparity", "flow_x", "flow_y"),
        done=done,
        remedy=remedy,
    )


@conformance_check()
def check_read_only_input(bench: ConformanceBench) -> None:
    """Images that cannot be written to, as `scenetruth.estimate` hands them over, give the same estimate."""
    if output_problems(bench.plain, bench.recording(), bench.method.gives):
        msg = "scenetruth.estimate refuses what the method returns: see 'output_schema' and 'declared_outputs'"
        raise NotApplicable(msg)
    found = estimate(bench.recording(), bench.method, bench.settings)
    require_equal_to_rounding(
        scalar_maps(found),
        scalar_maps(bench.plain),
        done="scenetruth.estimate was called, which makes the recording's arrays read-only",
        expectation="the same estimate as with arrays that can be written to",
        remedy="work on copies, whether or not arrays can be written to",
    )


@conformance_check()
def check_single_camera(bench: ConformanceBench) -> None:
    """A single camera is refused as methods refuse, or gives motion that is right."""
    plane = replace(bench.plane, cameras=1)
    recording = plane.recording()
    found = bench.estimate_if_it_suits(recording)
    done = "the plain recording's reference camera was estimated without the others"
    remedy = "say Needs(cameras=2) if depth needs two; else give motion alone, depth NaN"
    wrong = [str(problem) for problem in output_problems(found, recording, bench.method.gives)]
    if wrong:
        raise CheckFailure(done, "an error of scenetruth.errors, or an estimate of the form", "; ".join(wrong), remedy)
    require_median_near(scalar_maps(found), plane.truth(), ("flow_x", "flow_y"), done=done, remedy=remedy)


@conformance_check()
def check_single_frame(bench: ConformanceBench) -> None:
    """A single frame is refused as methods refuse, or gives depth that is right."""
    plane = replace(bench.plane, frames=1)
    recording = plane.recording()
    found = bench.estimate_if_it_suits(recording)
    done = "the plain recording's reference frame was estimated without the others"
    remedy = "say Needs(frames=2) if the method needs two; else give depth alone, motion NaN"
    wrong = [str(problem) for problem in output_problems(found, recording, bench.method.gives)]
    if wrong:
        raise CheckFailure(done, "an error of scenetruth.errors, or an estimate of the form", "; ".join(wrong), remedy)
    require_median_near(scalar_maps(found), plane.truth(), ("depth", "disparity"), done=done, remedy=remedy)
