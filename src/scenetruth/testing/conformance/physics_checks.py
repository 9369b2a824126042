"""Checks of physics: symmetries and relations of cameras and surfaces that any method must respect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scenetruth.testing.conformance.bench import ConformanceBench, conformance_check
from scenetruth.testing.conformance.map_comparison import (
    change_sign,
    flip_maps,
    require_agreement,
    require_equal_to_rounding,
    require_median_near,
    scalar_maps,
)

__all__ = []


@conformance_check(any_of=("flow_x", "velocity_x", "velocity_z"), frames=2)
def check_static_scene(bench: ConformanceBench) -> None:
    """A static plane has no flow and no velocity."""
    plane = replace(bench.plane, velocity_mm=(0.0, 0.0, 0.0))
    bench.agrees(
        scalar_maps(bench.estimate(plane.recording())),
        bench.restrict_truth(plane.truth()),
        done="all frames were identical",
        expectation="no flow, no velocity and the true depth, within three times the method's own error with motion",
        remedy="search for disparity or slope that is mistaken for motion, and for exact zeros that count as missing",
    )


_CROP_COLUMNS, _CROP_ROWS = 16, 12
_CROP_MARGIN_PX = 20
"""At smaller distances from the new border, windows of default size change."""


@conformance_check()
def check_crop(bench: ConformanceBench) -> None:
    """Cropping the images does not change the interior: pixel indices and principal point are unchanged."""
    recording = bench.recording().isel(x=slice(_CROP_COLUMNS, None), y=slice(_CROP_ROWS, None))
    found = scalar_maps(bench.estimate_if_it_suits(recording))
    inside = {
        name: item.where((item["x"] >= _CROP_COLUMNS + _CROP_MARGIN_PX) & (item["y"] >= _CROP_ROWS + _CROP_MARGIN_PX))
        for name, item in bench.maps.items()
    }
    bench.agrees(
        found,
        inside,
        done=f"the recording was cropped by isel: {_CROP_COLUMNS} columns at the left, {_CROP_ROWS} rows at the top",
        expectation=f"the same estimate more than {_CROP_MARGIN_PX} px inside, within three times the method's error",
        remedy="read pixel indices from recording['x'] and recording['y'], not from the array: "
        "scenetruth.schema.compute_pixel_grid(recording)",
    )


@conformance_check(any_of=("depth", "disparity"), cameras=2, odd_cameras=True)
def check_reversed_baseline(bench: ConformanceBench) -> None:
    """Cameras numbered from right to left, with a negative baseline, give the same depth and velocity."""
    recording = bench.plane.recording(bench.plane.images()[::-1], baseline_mm=-bench.plane.baseline_mm)
    found = scalar_maps(bench.estimate_if_it_suits(recording))
    bench.agrees(
        change_sign(found, ("disparity",)),
        done="the cameras were numbered from right to left: stage_x_mm decreases with s, baseline_mm is negative",
        expectation="the same depth and velocity, disparity with the opposite sign, within three times the method's "
        "error",
        remedy="read camera positions from stage_x_mm and baseline_mm; x_s = x_0 - disparity s",
    )


_OTHER_INTERVAL_S = 0.04


@conformance_check()
def check_frame_interval(bench: ConformanceBench) -> None:
    """The frame interval has no effect: flow and velocity are per frame."""
    recording = bench.plane.recording(frame_interval_s=_OTHER_INTERVAL_S)
    require_equal_to_rounding(
        scalar_maps(bench.estimate(recording)),
        scalar_maps(bench.plain),
        done=f"frame_interval_s was {_OTHER_INTERVAL_S:g} instead of 1, with the same images",
        expectation="the same estimate: px per frame and mm per frame",
        remedy="do not divide by frame_interval_s",
    )


@conformance_check(frames=2)
def check_frame_numbers(bench: ConformanceBench) -> None:
    """Other frame numbers of the same images change only the frame numbers of the estimate."""
    recording = bench.recording()
    later = -int(recording["t"].values[0]) or -int(np.ptp(recording["t"].values))
    interval = float(recording.attrs["frame_interval_s"])
    numbers = recording["t"].values + later
    found = scalar_maps(
        bench.estimate_if_it_suits(recording.assign_coords(t=numbers, time_s=("t", interval * numbers)))
    )
    bench.agrees(
        {name: item.assign_coords(t=item["t"] - later) for name, item in found.items()},
        done=f"the frames were numbered {numbers.tolist()} instead of {recording['t'].values.tolist()}",
        expectation="the same estimate of the same images, within the method's own error",
        remedy="read frame numbers from recording['t'], and pass them as t= to scenetruth.make_estimate",
        factor=1.0,
    )


_INTENSITY_GAIN, _INTENSITY_OFFSET = 0.7, 0.2
_MIN_RETAINED_FRACTION = 0.1
"""Contrast thresholds may reduce the number of valid pixels, but a comparison requires some."""


@conformance_check()
def check_intensity_invariance(bench: ConformanceBench) -> None:
    """A change of contrast and brightness of all images does not change the estimate."""
    images = _INTENSITY_GAIN * bench.plane.images() + _INTENSITY_OFFSET
    bench.agrees(
        scalar_maps(bench.estimate(bench.plane.recording(images))),
        done=f"grey values were multiplied by {_INTENSITY_GAIN:g} and increased by {_INTENSITY_OFFSET:g} of full scale",
        expectation="the same estimate within three times the method's own error",
        remedy="depth and motion are ratios of grey-value differences: search for a grey value that is used directly",
        least_kept=_MIN_RETAINED_FRACTION,
    )


_BASELINE_FACTOR = 10.0
_LENGTH_MAPS = ("depth", "velocity_x", "velocity_y", "velocity_z")


@conformance_check(any_of=("depth", "disparity"), cameras=2)
def check_baseline_scaling(bench: ConformanceBench) -> None:
    """Ten times the baseline with the same images multiplies depth and velocity by ten and changes nothing else."""
    recording = bench.plane.recording(baseline_mm=_BASELINE_FACTOR * bench.plane.baseline_mm)
    before = scalar_maps(bench.plain)
    require_equal_to_rounding(
        scalar_maps(bench.estimate(recording)),
        {name: item * _BASELINE_FACTOR if name in _LENGTH_MAPS else item for name, item in before.items()},
        done=f"baseline_mm and stage_x_mm were {_BASELINE_FACTOR:g} times as large, with the same images",
        expectation=f"depth and velocity {_BASELINE_FACTOR:g} times as large, disparity and flow equal up to rounding",
        remedy="images are in pixels: apply lengths last, by f V_X / disparity, and use no thresholds in mm",
    )


@conformance_check(odd_cameras=True)
def check_mirror_x(bench: ConformanceBench) -> None:
    """Mirroring left and right mirrors the depth and changes the sign of U_X."""
    images = bench.plane.images()[::-1, :, :, ::-1]
    found = flip_maps(scalar_maps(bench.estimate(bench.plane.recording(images))), "x")
    bench.agrees(
        change_sign(found, ("flow_x", "velocity_x")),
        done="the images were mirrored along x, and the order of the cameras was reversed",
        expectation="the mirrored estimate, with opposite signs of U_X and of the flow along x, within three times the "
        "method's own error",
        remedy="search for signs and offsets that are correct for one direction only",
    )


@conformance_check()
def check_mirror_y(bench: ConformanceBench) -> None:
    """Mirroring top and bottom mirrors the depth and changes the sign of U_Y."""
    images = bench.plane.images()[:, :, ::-1]
    found = flip_maps(scalar_maps(bench.estimate(bench.plane.recording(images))), "y")
    bench.agrees(
        change_sign(found, ("flow_y", "velocity_y")),
        done="the images were mirrored along y",
        expectation="the mirrored estimate, with opposite signs of U_Y and of the flow along y, within three times the "
        "method's own error",
        remedy="search for signs and offsets that are correct for one direction only",
    )


_PRINCIPAL_POINT_SHIFT_PX = (16.0, -14.0)


@conformance_check(any_of=("depth", "disparity", "flow_x", "velocity_x"))
def check_principal_point(bench: ConformanceBench) -> None:
    """A principal point away from the image centre changes flow and velocity as in the camera model."""
    c_x, c_y = bench.plane.centre_px
    plane = replace(
        bench.plane, principal_point_px=(c_x + _PRINCIPAL_POINT_SHIFT_PX[0], c_y + _PRINCIPAL_POINT_SHIFT_PX[1])
    )
    found = scalar_maps(bench.estimate(plane.recording()))
    bench.agrees(
        found,
        bench.restrict_truth(plane.truth()),
        done=f"the principal point was {_PRINCIPAL_POINT_SHIFT_PX} px from the image centre",
        expectation="the truth, within three times the method's own error on the plain recording",
        remedy="measure x and y from recording.attrs['principal_point_px'], not from the image centre",
    )


@conformance_check()
def check_consistency(bench: ConformanceBench) -> None:
    """Depth and disparity are consistent, and so are flow, depth and velocity."""
    maps, plane = bench.maps, bench.plane
    done = "one map of the plain recording's estimate was computed from the others"
    remedy = "scenetruth.make_estimate derives the others: pass only disparity and flow, or depth and velocity"
    if "depth" in maps and "disparity" in maps:
        follows = plane.focal_length_px * plane.baseline_mm / maps["disparity"]
        require_equal_to_rounding(
            {"depth": follows},
            {"depth": maps["depth"]},
            done=done,
            expectation="depth = f V_X / disparity",
            remedy=remedy,
        )
    moving = ("depth", "velocity_x", "velocity_y", "velocity_z", "flow_x", "flow_y")
    if all(name in maps for name in moving):
        c_x, c_y = plane.centre_px
        f, depth = plane.focal_length_px, maps["depth"]
        found = {
            f"flow_{axis}": (f * maps[f"velocity_{axis}"] - (depth[axis] - centre) * maps["velocity_z"]) / depth
            for axis, centre in (("x", c_x), ("y", c_y))
        }
        both = {name: maps[name].where(np.isfinite(found[name])) for name in found}
        limits = bench.tolerances()
        require_agreement(
            found,
            both,
            {name: limits[name] for name in found},
            done=done,
            expectation="flow = (f U_X - x' U_Z, f U_Y - y' U_Z) / Z within the method's own error, x' from the "
            "principal point",
            remedy=remedy,
        )


@conformance_check(odd_frames=True, frames=3)
def check_time_reversal(bench: ConformanceBench) -> None:
    """Reversing time does not change depth, and changes the signs of flow and velocity."""
    found = scalar_maps(bench.estimate(bench.plane.recording(bench.plane.images()[:, ::-1])))
    back = {name: item.assign_coords(t=-item["t"]).sortby("t") for name, item in found.items()}
    motion = ("flow_x", "flow_y", "velocity_x", "velocity_y", "velocity_z")
    bench.agrees(
        change_sign(back, motion),
        done="the order of the frames was reversed",
        expectation="the same depth, and the opposite flow and velocity, within three times the method's own error",
        remedy="search for asymmetry in time: flow is that of the frame itself, forward, px per frame",
    )


@conformance_check()
def check_median_accuracy(bench: ConformanceBench) -> None:
    """Depth, disparity, flow and velocity of the plain recording have the correct sign and magnitude."""
    plane = bench.plane
    require_median_near(
        bench.maps,
        plane.truth(),
        bench.maps,
        done=f"a plane at {plane.depth_mm:g} mm that moves by {plane.velocity_mm} mm per frame was estimated",
        remedy="docs/reference/conventions.md: x_s = x_0 - disparity s, depth Z in mm along the optical axis, flow and "
        "velocity forward in time per frame, Y down, U_Z < 0 approaches the camera",
    )
