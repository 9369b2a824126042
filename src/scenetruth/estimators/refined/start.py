"""Where the refined estimator starts: a plane sweep, or the structure tensor's estimate with its holes filled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import EstimateError, Problem

__all__ = ["Rig", "Start", "filled", "swept_fields", "tensor_fields"]

_MEDIAN_PX = 7
# If more of the image is as far away as anything can be, cameras tell no depth.
_FAR_SHARE = 0.9


@dataclass(frozen=True, eq=False)
class Rig:
    """What a start needs to know of the cameras, in columns of the images."""

    positions: NDArray[np.float64]
    """Of the cameras (s, s_y), in steps, shape (cameras, 2)."""
    baseline_mm: float
    """Distance of two positions."""
    focal: float
    """Focal length in columns."""
    centre: tuple[float, float]
    """Column and row of the principal point."""


@dataclass(frozen=True, eq=False)
class Start:
    """Where the fit starts."""

    fields: NDArray[np.float64]
    """Disparity and velocity (X, Y, Z) in baselines per frame, shape (4, y, x), finite. With one camera, disparity is 1
    and velocity is flow in columns per frame."""
    known: NDArray[np.bool_]
    """Where a plane sweep is sure of the disparity, shape (y, x)."""


def swept_fields(images: NDArray[np.float32], estimated: int, times: NDArray[np.float64], rig: Rig) -> Start:
    """Find disparity and velocity of every pixel by trying disparities, then motions.

    Parameters
    ----------
    images
        The estimated frame and those beside it, shape (channel, s, t, y, x).
    estimated
        Place along t of the frame to be estimated.
    times
        Times of the frames after it.
    rig
        The cameras.

    Returns
    -------
    Start
        Disparity in columns per step.

    Raises
    ------
    EstimateError
        If no disparity is found, or almost none that is not zero.
    """
    from scenetruth.estimators.plane_sweep.motion import sweep_motion
    from scenetruth.estimators.plane_sweep.sweep import sweep

    fields = np.zeros((4, *images.shape[3:]))
    fields[0] = 1.0
    known = np.zeros(images.shape[3:], dtype=np.bool_)
    # Rows above and below take part in the fit only.
    row = rig.positions[:, 1] == 0.0
    positions, images = rig.positions[row, 0], images[:, row]
    several = len(positions) > 1
    if several:
        found = sweep(images[:, :, estimated], positions, rig.baseline_mm)
        if not found.ranges:
            raise EstimateError([Problem("image", "shows no texture in which cameras see the same: no depth to start")])
        if found.far.mean() > _FAR_SHARE:
            raise EstimateError([Problem("image", "shows the same from all cameras: no disparity that tells a depth")])
        fields[0], known = found.disparity, found.known
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
        )
        if moved.known.any():
            fields[1:] = filled(moved.velocity, moved.known)
    return Start(fields, known)


def tensor_fields(recording: xr.Dataset, frame: int, baseline_mm: float) -> Start:
    """Find disparity and velocity of every pixel as the structure tensor does.

    Parameters
    ----------
    recording
        The frames that are fitted together.
    frame
        Place along t of the frame to be estimated.
    baseline_mm
        Distance of two positions.

    Returns
    -------
    Start
        Disparity in px per step.

    Raises
    ------
    EstimateError
        If the structure tensor finds nothing in the images.
    """
    from scenetruth.estimators.estimation import estimate

    # In a window at the end of a recording, the estimated frame is none that the structure tensor estimates.
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
    known = (found["kind"].values == 2) & np.isfinite(fields).all(axis=0)
    if not known.any():
        message = "shows no texture in which the structure tensor finds depth and motion to start from"
        raise EstimateError([Problem("image", message)])
    return Start(filled(fields, known, _MEDIAN_PX), np.zeros_like(known))


def filled(fields: NDArray[np.float64], known: NDArray[np.bool_], median_px: int = 1) -> NDArray[np.float64]:
    """Fill what is not known with the nearest that is, and take medians over squares.

    Parameters
    ----------
    fields
        Values, shape (n, y, x).
    known
        Where they are known, shape (y, x); somewhere they must be.
    median_px
        Edge of the squares, 1 for none.
    """
    from scipy import ndimage

    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    whole = fields[:, nearest[0], nearest[1]]
    if median_px == 1:
        return whole
    return np.stack([ndimage.median_filter(values, median_px) for values in whole])
