"""Checks of physics: what holds for any method because it holds for cameras and surfaces."""

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
    """A plane at rest has no flow and no velocity."""
    plane = replace(bench.plane, velocity_mm=(0.0, 0.0, 0.0))
    bench.agrees(
        scalar_maps(bench.estimate(plane.recording())),
        bench.known_of(plane.truth()),
        done="all frames showed the same",
        expectation="no flow, no velocity and the true depth, within three times the method's own error with motion",
        remedy="look for what takes disparity or slope for motion, and for exact zeros that are taken as missing",
    )


_CROP_COLUMNS, _CROP_ROWS = 16, 12
_CROP_MARGIN_PX = 20
"""Closer to the new border, windows of usual size have changed."""


@conformance_check()
def check_crop(bench: ConformanceBench) -> None:
    """Cropping the images changes nothing inside: pixels keep their indices, the principal point stays."""
    recording = bench.recording().isel(x=slice(_CROP_COLUMNS, None), y=slice(_CROP_ROWS, None))
    found = scalar_maps(bench.estimate_if_it_suits(recording))
    inside = {
        name: item.where((item["x"] >= _CROP_COLUMNS + _CROP_MARGIN_PX) & (item["y"] >= _CROP_ROWS + _CROP_MARGIN_PX))
        for name, item in bench.maps.items()
    }
    bench.agrees(
        found,
        inside,
        done=f"the recording was cropped by isel: {_CROP_COLUMNS} columns on the left, {_CROP_ROWS} rows above",
        expectation=f"the same estimate more than {_CROP_MARGIN_PX} px inside, within three times the method's error",
        remedy="take pixel indices from recording['x'] and recording['y'], not from the array: "
        "scenetruth.schema.compute_pixel_grid(recording)",
    )


@conformance_check(any_of=("depth", "disparity"), cameras=2, odd_cameras=True)
def check_reversed_baseline(bench: ConformanceBench) -> None:
    """Cameras numbered from right to left, with a negative baseline, give the same depth and velocity."""
    recording = bench.plane.recording(bench.plane.images()[::-1], baseline_mm=-bench.plane.baseline_mm)
    found = scalar_maps(bench.estimate_if_it_suits(recording))
    bench.agrees(
        change_sign(found, ("disparity",)),
        done="the cameras were numbered from right to left: stage_x_mm falls with s, baseline_mm is negative",
        expectation="the same depth and velocity, disparity with the other sign, within three times the method's own "
        "error",
        remedy="take where cameras stand from stage_x_mm and baseline_mm; x_s = x_0 - disparity s",
    )


_OTHER_INTERVAL_S = 0.04


@conformance_check()
def check_frame_interval(bench: ConformanceBench) -> None:
    """Another time between frames changes nothing: flow and velocity are per frame."""
    recording = bench.plane.recording(frame_interval_s=_OTHER_INTERVAL_S)
    require_equal_to_rounding(
        scalar_maps(bench.estimate(recording)),
        scalar_maps(bench.plain),
        done=f"frame_interval_s was {_OTHER_INTERVAL_S:g} instead of 1, the images the same",
        expectation="the same estimate: px per frame and mm per frame",
        remedy="do not divide by frame_interval_s",
    )


@conformance_check(frames=2)
def check_frame_numbers(bench: ConformanceBench) -> None:
    """Other frame numbers for the same images change the numbers in the estimate, and nothing else."""
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
        remedy="take frame numbers from recording['t'], and give them back by t= of scenetruth.make_estimate",
        factor=1.0,
    )


_INTENSITY_GAIN, _INTENSITY_OFFSET = 0.7, 0.2
_MIN_RETAINED_FRACTION = 0.1
"""Thresholds on contrast may leave fewer pixels; if they leave none, nothing can be compared."""


@conformance_check()
def check_intensity_invariance(bench: ConformanceBench) -> None:
    """Images of less contrast and another brightness give the same estimate."""
    images = _INTENSITY_GAIN * bench.plane.images() + _INTENSITY_OFFSET
    bench.agrees(
        scalar_maps(bench.estimate(bench.plane.recording(images))),
        done=f"all images were made {_INTENSITY_GAIN:g} times as bright, plus {_INTENSITY_OFFSET:g} of full scale",
        expectation="the same estimate within three times the method's own error",
        remedy="depth and motion are ratios of differences of grey values: look for one that is used by itself",
        least_kept=_MIN_RETAINED_FRACTION,
    )


_BASELINE_FACTOR = 10.0
_LENGTH_MAPS = ("depth", "velocity_x", "velocity_y", "velocity_z")


@conformance_check(any_of=("depth", "disparity"), cameras=2)
def check_baseline_scaling(bench: ConformanceBench) -> None:
    """With ten times the baseline and the same images, depth and velocity are ten times as large, nothing else is."""
    recording = bench.plane.recording(baseline_mm=_BASELINE_FACTOR * bench.plane.baseline_mm)
    before = scalar_maps(bench.plain)
    require_equal_to_rounding(
        scalar_maps(bench.estimate(recording)),
        {name: item * _BASELINE_FACTOR if name in _LENGTH_MAPS else item for name, item in before.items()},
        done=f"baseline_mm and stage_x_mm were {_BASELINE_FACTOR:g} times as large, the images the same",
        expectation=f"depth and velocity {_BASELINE_FACTOR:g} times as large, disparity and flow equal to rounding",
        remedy="images know pixels only: lengths enter at the end, by f V_X / disparity; take no thresholds in mm",
    )


@conformance_check(odd_cameras=True)
def check_mirror_x(bench: ConformanceBench) -> None:
    """In a mirror, left and right exchanged, depth is mirrored and U_X changes its sign."""
    images = bench.plane.images()[::-1, :, :, ::-1]
    found = flip_maps(scalar_maps(bench.estimate(bench.plane.recording(images))), "x")
    bench.agrees(
        change_sign(found, ("flow_x", "velocity_x")),
        done="the images were mirrored along x, and the cameras taken in the opposite order",
        expectation="the mirrored estimate, the sign of U_X and of the flow along x changed, within three times the "
        "method's own error",
        remedy="look for signs and offsets that are right for one direction only",
    )


@conformance_check()
def check_mirror_y(bench: ConformanceBench) -> None:
    """In a mirror, above and below exchanged, depth is mirrored and U_Y changes its sign."""
    images = bench.plane.images()[:, :, ::-1]
    found = flip_maps(scalar_maps(bench.estimate(bench.plane.recording(images))), "y")
    bench.agrees(
        change_sign(found, ("flow_y", "velocity_y")),
        done="the images were mirrored along y",
        expectation="the mirrored estimate, the sign of U_Y and of the flow along y changed, within three times the "
        "method's own error",
        remedy="look for signs and offsets that are right for one direction only",
    )


_PRINCIPAL_POINT_SHIFT_PX = (16.0, -14.0)


@conformance_check(any_of=("depth", "disparity", "flow_x", "velocity_x"))
def check_principal_point(bench: ConformanceBench) -> None:
    """A principal point beside the image's centre changes flow and velocity as it must."""
    c_x, c_y = bench.plane.centre_px
    plane = replace(
        bench.plane, principal_point_px=(c_x + _PRINCIPAL_POINT_SHIFT_PX[0], c_y + _PRINCIPAL_POINT_SHIFT_PX[1])
    )
    found = scalar_maps(bench.estimate(plane.recording()))
    bench.agrees(
        found,
        bench.known_of(plane.truth()),
        done=f"the plane was seen with the principal point {_PRINCIPAL_POINT_SHIFT_PX} px beside the image's centre",
        expectation="the truth, within three times the method's own error on the plain recording",
        remedy="count x and y from recording.attrs['principal_point_px'], not from the image's centre",
    )


@conformance_check()
def check_consistency(bench: ConformanceBench) -> None:
    """Depth and disparity say the same, and so do flow, depth and velocity."""
    maps, plane = bench.maps, bench.plane
    done = "one map of the plain recording's estimate was computed from the others"
    remedy = "scenetruth.make_estimate derives what follows: give it disparity and flow, or depth and velocity, only"
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
    """Played backwards, depth stays and flow and velocity change their sign."""
    found = scalar_maps(bench.estimate(bench.plane.recording(bench.plane.images()[:, ::-1])))
    back = {name: item.assign_coords(t=-item["t"]).sortby("t") for name, item in found.items()}
    motion = ("flow_x", "flow_y", "velocity_x", "velocity_y", "velocity_z")
    bench.agrees(
        change_sign(back, motion),
        done="the frames were taken in the opposite order",
        expectation="the same depth, and the opposite flow and velocity, within three times the method's own error",
        remedy="look for what is one-sided in time: flow belongs to the frame itself, forward, px per frame",
    )


@conformance_check()
def check_median_accuracy(bench: ConformanceBench) -> None:
    """Depth, disparity, flow and velocity of the plain recording have the right sign and size."""
    plane = bench.plane
    require_median_near(
        bench.maps,
        plane.truth(),
        bench.maps,
        done=f"a plane at {plane.depth_mm:g} mm was estimated that moves by {plane.velocity_mm} mm per frame",
        remedy="docs/reference/conventions.md: x_s = x_0 - disparity s, depth Z in mm along the optical axis, flow and "
        "velocity forward in time per frame, Y down, U_Z < 0 comes nearer",
    )
