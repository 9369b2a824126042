"""Values that indicate another unit: focal length, baseline, distance, depth and disparity that no rig has."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.number_format import format_two_digits
from scenetruth.schema.attributes import read_intrinsics

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "describe_disparities",
    "describe_distance",
    "describe_estimated_depth",
    "describe_positions",
    "describe_rig",
]

_WIDEST_DEG = 120.0  # field of view beyond which a focal length is likely to be in mm
_NARROWEST_DEG = 0.05  # field of view of a focal length of 5 m on a sensor of 4 mm
_LONGEST_MM, _SHORTEST_MM = 5_000.0, 0.1  # baselines outside of which another unit is likely
_NEAREST_BASELINES = 10.0  # smallest likely depth in baselines: neighbouring images then show nearly the same
_NEAREST_MM, _FARTHEST_MM = 10.0, 200_000.0  # depths outside of which another unit is likely
_SMALLEST_PX = 0.02  # disparity between the outer positions below which no depth can be measured
_OTHER_UNIT = 30.0  # ratio of two lengths of one rig beyond which they are likely to have different units
_LEAST_WIDTH = 48  # images of fewer columns are no images of a camera
_AGREEING = 3.0  # factor by which a depth may differ from a distance that was measured with a ruler


def describe_rig(focal_px: float, baseline_mm: float | None, width: int, height: int) -> list[str]:
    """Return why a focal length or a baseline (None: not stated) is likely to be in another unit; empty if plausible.

    >>> describe_rig(1800, 5.0, 640, 480)
    []
    >>> describe_rig(6.2, None, 640, 480)[0][:75]
    'focal_length_px: 6.2 px for images of 640 x 480 px is a field of view of 17'
    """
    found = []
    side = max(width, height)
    angle = math.degrees(2 * math.atan(side / 2 / focal_px))
    stated = f"focal_length_px: {focal_px:g} px for images of {width} x {height} px is a field of view of"
    if angle > _WIDEST_DEG and side > 1:
        found.append(
            f"{stated} {angle:.0f}°; is it in mm? In px, it is the focal length divided by the distance of the pixels "
            "on the sensor"
        )
    if angle < _NARROWEST_DEG and side > 1:
        found.append(
            f"{stated} {format_two_digits(angle)}°; is it in µm, or was the pixel pitch in mm taken for one in µm?"
        )
    if baseline_mm and not _SHORTEST_MM <= abs(baseline_mm) <= _LONGEST_MM:
        unit = "µm" if abs(baseline_mm) > _LONGEST_MM else "m"
        found.append(f"baseline_mm: {baseline_mm:g} mm between two positions of a camera is unusual; is it in {unit}?")
    return found


def describe_positions(positions_mm: NDArray[Any] | None, baseline_mm: float) -> list[str]:
    """Return why listed positions of the camera are likely to be in another unit than the baseline; empty if not.

    >>> describe_positions(np.array([-5.0, 0.0, 5.1]), 5.0)
    []
    >>> describe_positions(np.array([-0.005, 0.0, 0.005]), 5.0)
    ['stage_x_mm: is 0.005 mm from one position to the next, and baseline_mm is 5; is stage_x_mm in m?']
    """
    if positions_mm is None or len(positions_mm) < 2 or not baseline_mm:
        return []
    step = float(np.mean(np.abs(np.diff(positions_mm))))
    ratio = step / abs(baseline_mm)
    if not step > 0 or 1 / _OTHER_UNIT <= ratio <= _OTHER_UNIT:
        return []
    unit = "m" if ratio < 1 else "µm"
    return [
        f"stage_x_mm: is {step:.3g} mm from one position to the next, and baseline_mm is {baseline_mm:g}; is "
        f"stage_x_mm in {unit}?"
    ]


def describe_distance(
    distance_mm: float, focal_px: float | None, baseline_mm: float, width: int, positions: int
) -> list[str]:
    """Return why a stated distance does not fit the rig; empty if it is plausible.

    >>> describe_distance(660, 1800, 5, 640, 5)
    []
    >>> describe_distance(0.66, 1800, 5, 640, 5)[0][:60]
    'distance_mm: 0.66 mm is 0.13 baselines of 5 mm; is it in m, '
    """
    step = abs(baseline_mm)
    if positions < 2 or not step > 0:
        return []
    if distance_mm < _NEAREST_BASELINES * step:
        return [
            f"distance_mm: {distance_mm:g} mm is {format_two_digits(distance_mm / step)} "
            f"baselines of {step:g} mm; is it in m, or the "
            "baseline in µm?"
        ]
    disparity = math.nan if focal_px is None else focal_px * step / distance_mm
    if disparity >= width:
        return [
            f"distance_mm: at {distance_mm:g} mm, neighbouring images are displaced by {disparity:.4g} px, more than "
            f"their width of {width} px; is the distance in m, or the baseline in µm?"
        ]
    if disparity * (positions - 1) < _SMALLEST_PX:
        return [
            f"distance_mm: at {distance_mm:g} mm, the outer images are displaced "
            f"by {format_two_digits(disparity * (positions - 1))} "
            "px, from which no depth follows; is the distance in µm, the baseline in m, or the focal length in mm?"
        ]
    return []


def describe_disparities(low_px: float, high_px: float, recording: xr.Dataset) -> list[str]:
    """Return why a stated range of disparities, in px per step of s, does not fit a recording of real images.

    >>> from scenetruth.schema import make_recording
    >>> recording = make_recording(np.zeros((3, 1, 48, 64)), focal_length_px=500, baseline_mm=5)
    >>> describe_disparities(2, 8, recording)
    []
    >>> describe_disparities(200, 800, recording)[0][:71]
    'disparities of 200 to 800 px between neighbouring images of 64 px width'
    """
    step = _smallest_step(recording)
    if "scene_hash" in recording.attrs or step is None or _full_width(recording) < _LEAST_WIDTH:
        return []
    intrinsics = read_intrinsics(recording)
    width, focal, baseline = _full_width(recording), intrinsics.focal_length_px, abs(intrinsics.baseline_mm)
    low, high = sorted((abs(low_px) * step / baseline, abs(high_px) * step / baseline))
    low = 0.0 if low_px * high_px <= 0 else low
    if high >= width:
        return [
            f"disparities of {low:.4g} to {high:.4g} px between neighbouring images of {width} px width reach beyond "
            "the image; are they in px per step of s?"
        ]
    if low > 0 and focal / low < _NEAREST_BASELINES:
        return [
            f"disparities of {low:.4g} to {high:.4g} px mean a depth below "
            f"{format_two_digits(focal / low)} baselines of {step:g} mm; "
            f"is focal_length_px ({focal:g}) in mm? In px, it is the focal length divided by the distance of the "
            "pixels on the sensor"
        ]
    return []


def describe_estimated_depth(depth_mm: float, recording: xr.Dataset) -> list[str]:
    """Return why the median of estimated depths is implausible for a recording of real images; empty if it is not.

    Depth is compared with the distance that the recording states (attribute ``distance_mm``), else with the baseline,
    and with the width of the images. Simulated recordings have the units of their scene, and are not examined.
    """
    if "scene_hash" in recording.attrs or not (math.isfinite(depth_mm) and depth_mm > 0):
        return []
    intrinsics = read_intrinsics(recording)
    focal, baseline = intrinsics.focal_length_px, abs(intrinsics.baseline_mm)
    stated = _stated_distance(recording.attrs)
    if stated is not None:
        return _compare_distances(depth_mm, stated, focal, baseline)
    step, width = _smallest_step(recording), _full_width(recording)
    if width < _LEAST_WIDTH:
        return []
    found = []
    if step is not None and focal * step >= width * depth_mm:
        found.append(
            f"depth: the median of {depth_mm:.3g} mm is a disparity of {focal * step / depth_mm:.4g} px between "
            f"neighbouring images of {width} px width, which have nothing in common; is depth in m?"
        )
    elif step is not None and depth_mm < _NEAREST_BASELINES * step:
        found.append(
            f"depth: the median of {depth_mm:.3g} mm is "
            f"{format_two_digits(depth_mm / step)} baselines of {step:g} mm; is "
            f"focal_length_px ({focal:g}) in mm? In px, it is the focal length divided by the distance of the pixels "
            "on the sensor"
        )
    elif depth_mm < _NEAREST_MM:
        found.append(f"depth: the median of {depth_mm:.3g} mm is unusual; is baseline_mm ({baseline:g}) in m?")
    elif depth_mm > _FARTHEST_MM:
        found.append(
            f"depth: the median of {depth_mm / 1000:.3g} m is unusual; is baseline_mm ({baseline:g}) in µm, or "
            f"focal_length_px ({focal:g}) in µm?"
        )
    return found


def _compare_distances(depth_mm: float, distance_mm: float, focal: float, baseline: float) -> list[str]:
    """Return how an estimated depth contradicts a stated distance."""
    ratio = depth_mm / distance_mm
    if 1 / _AGREEING <= ratio <= _AGREEING:
        return []
    unit = {-1: "; is the baseline in m?", 1: "; is the baseline in µm?"}.get(round(math.log10(ratio) / 3), "")
    near_thousand = abs(abs(math.log10(ratio)) - 3) < math.log10(_AGREEING)
    return [
        f"depth: the median of {depth_mm:.3g} mm contradicts the stated distance of {distance_mm:g} mm; "
        f"focal_length_px = {focal / ratio:.3g} (stated: {focal:g}) or baseline_mm = {baseline / ratio:.3g} (stated: "
        f"{baseline:g}) would agree{unit if near_thousand else ''}"
    ]


def _stated_distance(attrs: Mapping[str, Any]) -> float | None:
    """Return the stated distance in mm; None if there is none."""
    stated = attrs.get("distance_mm")
    if isinstance(stated, int | float | np.number) and math.isfinite(stated) and stated > 0:
        return float(stated)
    return None


def _smallest_step(recording: xr.Dataset) -> float | None:
    """Return the smallest distance between two positions of the camera in mm; None for a single position."""
    steps = []
    for name in ("stage_x_mm", "stage_y_mm"):
        if name in recording.coords:
            positions = np.unique(np.asarray(recording[name].values, dtype=np.float64))
            steps += np.diff(positions).tolist()
    return min(steps, default=None)


def _full_width(recording: xr.Dataset) -> int:
    """Return the width of the camera's images as far as pixel indices state it, in px."""
    columns = recording["x"].values if "x" in recording.coords else np.arange(recording.sizes["x"])
    return max(int(np.max(columns)) + 1, recording.sizes["x"])
