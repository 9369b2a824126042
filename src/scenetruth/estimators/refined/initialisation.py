"""Initial estimate by plane sweep, from the reference or another image, or by the structure tensor with filled gaps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.refined.image_consistency import compute_agreement
from scenetruth.estimators.refined.image_stack import FramesNeeded, ImageStack
from scenetruth.estimators.refined.pixel_defects import DefectFilteredFrames

__all__ = [
    "CameraLayout",
    "InitialEstimate",
    "fill_gaps",
    "initialise_by_structure_tensor",
    "initialise_robustly",
    "map_to_reference",
]


_MEDIAN_PX = 7
_FAR_SHARE = 0.9  # largest fraction of pixels at infinity above which the cameras determine no depth


@dataclass(frozen=True, eq=False)
class CameraLayout:
    """Positions and intrinsics of the cameras, in columns of the images."""

    positions: NDArray[np.float64]
    """Positions (s, s_y) of the cameras in steps, shape (cameras, 2)."""
    baseline_mm: float
    focal: float
    """Focal length in columns."""
    centre: tuple[float, float]
    """Column and row of the principal point."""


@dataclass(frozen=True, eq=False)
class InitialEstimate:
    """Initial estimate of the fit."""

    fields: NDArray[np.float64]
    """Disparity and velocity (X, Y, Z) in baselines per frame, shape (4, y, x), finite. With one camera, disparity is 1
    and velocity is flow in columns per frame."""
    known: NDArray[np.bool_]
    """Where the disparity of a plane sweep is valid, shape (y, x)."""


def initialise_by_plane_sweep(
    images: NDArray[np.float32],
    estimated: int,
    times: NDArray[np.float64],
    rig: CameraLayout,
    max_motion: float | None = None,
) -> InitialEstimate:
    """Estimate disparity (columns per step) and velocity by plane sweep from frames of shape (channel, s, t, y, x).

    ``max_motion``: Largest motion searched, in columns per frame; None for that of the motion search.
    """
    from scenetruth.estimators.plane_sweep.disparity_sweep import sweep_disparity
    from scenetruth.estimators.plane_sweep.motion_search import sweep_motion

    fields = np.zeros((4, *images.shape[3:]))
    fields[0] = 1.0
    known = np.zeros(images.shape[3:], dtype=np.bool_)
    # Camera rows above and below are used in the fit only.
    row = rig.positions[:, 1] == 0.0
    positions, images = rig.positions[row, 0], images if row.all() else images[:, row]
    several = len(positions) > 1
    if several:
        found = sweep_disparity(images[:, :, estimated], positions, rig.baseline_mm)
        if not found.ranges:
            raise EstimateError([Problem("image", "has no texture common to the cameras: no initial depth")])
        if found.far.mean() > _FAR_SHARE:
            raise EstimateError([Problem("image", "is the same for all cameras: no disparity, hence no depth")])
        fields[0], known = found.disparity, found.known
        del found
    beside = [n for n in (estimated - 1, estimated + 1) if 0 <= n < images.shape[2]]
    if beside:
        reference = images[:, int(np.argmin(np.abs(positions))), estimated]
        moved = sweep_motion(
            reference,
            [images[:, :, n] for n in beside],
            times[beside],
            positions,
            fields[0] if several else None,
            rig.focal,
            rig.centre,
            **({} if max_motion is None else {"farthest": max_motion}),
        )
        if moved.known.any():
            fields[1:] = fill_gaps(moved.velocity, moved.known)
    return InitialEstimate(fields, known)


def initialise_by_structure_tensor(recording: xr.Dataset, frame: int, baseline_mm: float) -> InitialEstimate:
    """Estimate disparity (px per step) and velocity of every pixel by the structure tensor."""
    from scenetruth.estimators.estimation import estimate

    # In a window at the end of a recording, the structure tensor does not estimate the frame itself.
    t = recording["t"].values
    found = estimate(recording.assign_coords(t=t - t[frame]), "structure_tensor", tau="auto")
    found = found.isel(t=int(np.argmin(np.abs(found["t"].values))))
    cameras, frames = recording.sizes["s"], recording.sizes["t"]
    shape = (4, recording.sizes["y"], recording.sizes["x"])
    fields = np.zeros(shape)
    fields[0] = 1.0
    if cameras > 1:
        fields[0] = found["disparity"].values
        fields[0][~(fields[0] * np.sign(baseline_mm) > 0)] = np.nan
    if frames > 1 and cameras > 1:
        fields[1:] = found["velocity"].values / baseline_mm
    elif frames > 1:
        fields[1:3] = found["flow"].values
    known = (found["status"].values == 2) & np.isfinite(fields).all(axis=0)
    if not known.any():
        message = "has no texture from which the structure tensor estimates an initial depth and motion"
        raise EstimateError([Problem("image", message)])
    return InitialEstimate(fill_gaps(fields, known, _MEDIAN_PX), np.zeros_like(known))


def fill_gaps(fields: NDArray[np.float64], known: NDArray[np.bool_], median_px: int = 1) -> NDArray[np.float64]:
    """Replace invalid values of maps (n, y, x) by the nearest valid values, and take medians over squares."""
    from scipy import ndimage

    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    whole = fields[:, nearest[0], nearest[1]]
    if median_px == 1:
        return whole
    return np.stack([ndimage.median_filter(values, median_px) for values in whole])


# Fraction of the textured blocks that must agree, otherwise other images are tried; and ratio by which this fraction
# must increase for their estimate to be used.
_ENOUGH, _BETTER = 0.5, 1.25
_ROBUST_MEDIAN_PX = 5

Map = NDArray[np.float64]


def initialise_robustly(
    frames: DefectFilteredFrames,
    needed: FramesNeeded,
    images: ImageStack,
    rig: CameraLayout,
    sigma_px: float,
    max_motion: float | None = None,
    agreement: Callable[[Map], float] | None = None,
) -> InitialEstimate:
    """Estimate disparity and velocity of every pixel of the reference, as `initialise_by_plane_sweep`.

    ``agreement``: Fraction of the textured blocks that agree for fields of shape (4, y, x); default: of all blocks.
    """
    near = images.within(1.0)
    agreeing = agreement or (lambda fields: compute_agreement(near, fields, sigma_px, even=True).blocks)
    reference, middle = int(np.argmin(np.hypot(*rig.positions.T))), needed.output - needed.first
    row = np.flatnonzero(rig.positions[:, 1] == rig.positions[reference, 1]).tolist()
    others = sorted(row, key=lambda n: abs(rig.positions[n, 0]))[1:3]
    # Initial frames and cameras, with the adjacent frames before and after, one of both, and adjacent images.
    anchors = [(middle, reference, 1, 1), (middle, reference, 0, 1), (middle, reference, 1, 0)]
    anchors += [(n, reference, 1, 1) for n in (middle + 1, middle - 1)] + [(middle, n, 1, 1) for n in others]
    best: InitialEstimate | None = None
    most, reason = 0.0, ""
    tried = set()
    for frame, camera, before, behind in anchors:
        first, last = max(frame - before, 0), min(frame + behind + 1, len(images.times))
        # At the ends of a window there is no frame before, or after.
        if not 0 <= frame < len(images.times) or (frame, camera, first, last) in tried:
            continue
        tried.add((frame, camera, first, last))
        values = frames.frames(needed.first + first, needed.first + last).astype(np.float32, copy=False)
        values = values if images.lens is None else images.lens.straighten(values)
        own = CameraLayout(rig.positions - rig.positions[camera], rig.baseline_mm, rig.focal, rig.centre)
        try:
            found = initialise_by_plane_sweep(
                values, frame - first, images.times[first:last] - images.times[frame], own, max_motion
            )
        except EstimateError as error:
            reason = reason or error.problems[0].message
            continue
        if (frame, camera) != (middle, reference):
            fields = map_to_reference(found.fields, float(rig.positions[camera, 0]), float(images.times[frame]), rig)
            found = InitialEstimate(fields, np.zeros_like(found.known))
        share = agreeing(found.fields)
        if best is None or share > _BETTER * most:
            best, most = found, share
        if most >= _ENOUGH or len(near.times) * len(rig.positions) < 3:
            break
    if best is None:
        raise EstimateError([Problem("image", reason)])
    return best


def map_to_reference(fields: Map, s: float, t: float, rig: CameraLayout) -> Map:
    """Return fields d and q, shape (4, y, x), at the pixels of the reference, from those of another image.

    The point at p = (x, y, f) / d relative to the camera at s steps at time t is at p + (s, 0, 0) - t q relative to the
    reference at time 0. If several points map to one pixel, the nearest is used; gaps are filled from adjacent pixels.
    """
    _, height, width = fields.shape
    d, q_x, q_y, q_z = fields
    y, x = np.mgrid[:height, :width].astype(np.float64)
    x, y = x - rig.centre[0], y - rig.centre[1]
    scale = 1.0 / (1.0 - t * d * q_z / rig.focal)
    to_x = np.rint((x + d * (s - t * q_x)) * scale + rig.centre[0])
    to_y = np.rint((y - d * t * q_y) * scale + rig.centre[1])
    own = d * scale
    inside = (to_x >= 0) & (to_x < width) & (to_y >= 0) & (to_y < height) & (own * d > 0)
    order = np.argsort(np.abs(own[inside]), kind="stable")
    rows, columns = (at[inside][order].astype(np.intp) for at in (to_y, to_x))
    out, known = np.zeros_like(fields), np.zeros((height, width), dtype=np.bool_)
    # Of several values for one pixel, the last remains.
    for n, values in enumerate((own, q_x, q_y, q_z)):
        out[n, rows, columns] = values[inside][order]
    known[rows, columns] = True
    return fill_gaps(out, known, _ROBUST_MEDIAN_PX) if known.any() else fields.copy()
